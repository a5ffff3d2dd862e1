"""The program: ``lidarpc ...`` or ``python -m lidarpc ...``."""

import sys

from lidarpc import _native


def main() -> int:
    """Does what the command line says. Returns the exit code; wrong usage ends the process with 2."""
    return _native.main(["lidarpc", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
