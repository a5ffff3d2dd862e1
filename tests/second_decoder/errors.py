"""What this decoder says of a stream that it does not decode."""


class Refused(Exception):
    """The stream breaks a rule of FORMAT.md."""


class NotHere(Exception):
    """The stream is valid, but this decoder lacks what it needs."""
