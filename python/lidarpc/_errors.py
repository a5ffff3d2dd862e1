"""What can go wrong. The extension module raises these."""

from __future__ import annotations


class Error(ValueError):
    """A stream is damaged or no stream, an argument is out of range, or a scan cannot be stored.

    ``file``: what the stream is called (a path, as a rule), or None. ``frame``: the number of the frame that it is about,
    counted from 0, or None. The message names both.
    """

    def __init__(self, message: str, file: str | None = None, frame: int | None = None) -> None:
        super().__init__(message)
        self.file = file
        self.frame = frame

    def __reduce__(self):
        # Errors come back from worker processes.
        return type(self), (str(self), self.file, self.frame)


class InputError(Error, OSError):
    """Reading or writing failed; ``__cause__`` says how."""

    def __init__(self, message: str, file: str | None = None, frame: int | None = None) -> None:
        super().__init__(message, file, frame)

    def __str__(self) -> str:
        return self.args[0]


class LidarpcWarning(UserWarning):
    """``encode`` left something out, or ``decode`` with ``keep_going`` lost frames of a damaged file."""
