"""A decoder of lidarpc streams, written from FORMAT.md and for its sake: slow, and independent of the Rust program.

    python3 tests/second_decoder STREAM OUTDIR     writes the files
    python3 tests/second_decoder --list STREAM     prints name, size, CRC-32C and points of each

It needs nothing but Python 3.11. It does not know the back-ends brotli, ppmd, lz5 and lizard, nor JPEG 2000.
Exit codes: 0 done, 1 the stream breaks a rule, 3 it needs what this decoder does not know.
"""

import argparse
import os
import struct
import sys

# The source tree stays as it is.
sys.dont_write_bytecode = True

from container import crc32c, groups  # noqa: E402
from errors import NotHere, Refused  # noqa: E402
from frame import Decoder  # noqa: E402


def frames(data):
    """(frame, bytes of the file) of each frame of a stream."""
    for group in groups(data):
        decoders = [Decoder(scanner) for scanner in group.scanners]
        for frame in group.frames:
            yield frame, decoders[frame.track].frame(frame)


def main():
    parser = argparse.ArgumentParser(prog="second_decoder", description="Decodes a lidarpc stream.")
    parser.add_argument("--list", action="store_true", help="print name, size, CRC-32C and points of each file")
    parser.add_argument("--first", type=int, help="stop after so many frames")
    parser.add_argument("stream")
    parser.add_argument("folder", nargs="?")
    arguments = parser.parse_args()
    if arguments.list == (arguments.folder is not None):
        parser.error("either --list or a folder")
    with open(arguments.stream, "rb") as file:
        data = file.read()
    if arguments.folder:
        os.makedirs(arguments.folder, exist_ok=True)
    left = arguments.first
    try:
        for frame, file in frames(data):
            if arguments.list:
                print(f"{frame.name} {len(file)} {crc32c(file):08x} {frame.point_count}", flush=True)
            else:
                parts = frame.name.removesuffix("/").split("/")
                if any(part in ("", ".", "..") or "\\" in part for part in parts):
                    raise Refused("a name that leaves the folder")
                path = os.path.join(arguments.folder, *parts)
                if frame.name.endswith("/"):
                    os.makedirs(path, exist_ok=True)
                    continue
                os.makedirs(os.path.dirname(path), exist_ok=True)
                with open(path, "wb") as out:
                    out.write(file)
            if left is not None:
                left -= 1
                if left == 0:
                    break
    except NotHere as error:
        print(f"{arguments.stream}: this decoder does not decode {error}", file=sys.stderr)
        sys.exit(3)
    except (Refused, ArithmeticError, LookupError, ValueError, struct.error) as error:
        sys.exit(f"{arguments.stream}: refused: {error}")


if __name__ == "__main__":
    main()
