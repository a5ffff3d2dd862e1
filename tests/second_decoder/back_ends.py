"""General-purpose back-ends, by their numbers: the table of section 8.13 of FORMAT.md."""

import bz2
import lzma
import zlib

import zstandard
from errors import NotHere, Refused

NAMES = "store bzip2 brotli lzma ppmd lz4 zstd lz5 lizard deflate".split()


def unpacked(backend, data, size):
    """What the back-end of this number makes of its payload, which must be so many bytes."""
    if backend >= len(NAMES):
        raise Refused("an unknown back-end")
    name = NAMES[backend]
    try:
        if name == "store":
            found = data
        elif name == "bzip2":
            found = bz2.decompress(data)
        elif name == "lz4":
            found = lz4_block(data)
        elif name == "deflate":
            found = zlib.decompress(data, -15)
        elif name == "zstd":
            found = zstandard.decompress(data)
        elif name == "lzma":
            properties = data[0]
            header = bytes([properties]) + max(size, 4096).to_bytes(4, "little") + size.to_bytes(8, "little")
            found = lzma.decompress(header + data[1:], lzma.FORMAT_ALONE)
        else:
            raise NotHere(f"the back-end {name}")
    except (OSError, zlib.error, lzma.LZMAError, EOFError, IndexError) as error:
        raise Refused(f"{name}: {error}") from error
    if len(found) != size:
        raise Refused("a back-end gives more or fewer bytes than it should")
    return found


def lz4_block(data):
    out = bytearray()
    at = 0

    def length(n):
        nonlocal at
        if n == 15:
            while True:
                at += 1
                n += data[at - 1]
                if data[at - 1] < 255:
                    break
        return n

    while True:
        token = data[at]
        at += 1
        literals = length(token >> 4)
        out += data[at : at + literals]
        at += literals
        if at >= len(data):
            return bytes(out)
        offset = data[at] | data[at + 1] << 8
        at += 2
        if not 1 <= offset <= len(out):
            raise IndexError("an offset beyond the start")
        for _ in range(length(token & 15) + 4):
            out.append(out[-offset])
