"""Sections 8.1 (the serialised layout) and 9 of FORMAT.md: from records to a file's bytes."""

import struct
from fractions import Fraction
from math import inf, isfinite, isnan

from container import Reader
from errors import Refused
from models import f32

PLAIN, PCD_COMPRESSED, TEXT, BIG_ENDIAN = range(4)
HAS_POSITION, HAS_INTENSITY = 0x10, 0x20
SCALARS = "bBhHiIqQfd"
INTEGER, FIXED, SCIENTIFIC, SIGNIFICANT, SHORTEST = range(5)
# Hash bits, multiplier, inserts of each dialect of LZF.
DIALECTS = ((13, 1, 1), (16, 1, 1), (16, 5, 2))


class Layout:
    def __init__(self, data):
        reader = Reader(data)
        flags = reader.unsigned(1)
        self.wrapping = flags & 15
        if self.wrapping > BIG_ENDIAN or flags & 0xC0:
            raise Refused("unknown flags of a layout")
        self.stride = reader.varint()
        if self.stride > 65536:
            raise Refused("records are too long")
        self.position = [reader.varint() for _ in range(3)] if flags & HAS_POSITION else None
        self.intensity = reader.varint() if flags & HAS_INTENSITY else None
        taken = set()
        for offset in (self.position or []) + ([self.intensity] if flags & HAS_INTENSITY else []):
            place = set(range(offset, offset + 4))
            if offset + 4 > self.stride or taken & place:
                raise Refused("values lie outside their record, or overlap")
            taken |= place
        self.extra_places = [k for k in range(self.stride) if k not in taken]
        self.widths = []
        self.columns = []
        if self.wrapping == PCD_COMPRESSED:
            dialect = reader.unsigned(1)
            if dialect >= len(DIALECTS):
                raise Refused("unknown dialect of LZF")
            self.dialect = DIALECTS[dialect]
        if self.wrapping in (PCD_COMPRESSED, BIG_ENDIAN):
            while sum(self.widths) < self.stride:
                self.widths.append(reader.varint())
                if self.widths[-1] == 0:
                    raise Refused("a field without bytes")
            whole = sum(self.widths)
        if self.wrapping == TEXT:
            self.flags = reader.unsigned(1)
            if self.flags > 7:
                raise Refused("unknown flags of a text")
            whole = 0
            while whole < self.stride:
                first, parameter = reader.take(2)
                scalar, rule = first & 15, first >> 4
                if scalar > 9 or rule > SHORTEST or (rule == INTEGER) != (scalar < 8):
                    raise Refused("unknown column of a text")
                most = (0, 40, 40, 40, 3)[rule]
                if parameter > most or rule == SIGNIFICANT and parameter == 0:
                    raise Refused("unknown rule of a text")
                self.columns.append((SCALARS[scalar], rule, parameter))
                whole += struct.calcsize("<" + SCALARS[scalar])
        if self.wrapping != PLAIN and (whole != self.stride or whole == 0):
            raise Refused("fields do not fill their record")
        reader.end()

    @property
    def extra_stride(self):
        return len(self.extra_places)


def records_of(layout, n, positions, intensities, extra):
    """The records, one after the other."""
    stride = layout.stride
    data = bytearray(n * stride)
    if layout.position:
        for axis, offset in enumerate(layout.position):
            values = struct.pack(f"<{n}I", *[p[axis] for p in positions])
            for k in range(4):
                data[offset + k :: stride] = values[k::4]
    if layout.intensity is not None:
        values = struct.pack(f"<{n}I", *intensities)
        for k in range(4):
            data[layout.intensity + k :: stride] = values[k::4]
    for k, place in enumerate(layout.extra_places):
        data[place::stride] = extra[k :: layout.extra_stride]
    return bytes(data)


def wrapped(layout, records):
    if layout.wrapping == PCD_COMPRESSED:
        return pcd_compressed(layout, records)
    if layout.wrapping == BIG_ENDIAN:
        return big_endian(layout, records)
    if layout.wrapping == TEXT:
        return text(layout, records)
    return records


def big_endian(layout, records):
    out = bytearray(len(records))
    start = 0
    for width in layout.widths:
        for k in range(width):
            out[start + k :: layout.stride] = records[start + width - 1 - k :: layout.stride]
        start += width
    return bytes(out)


def pcd_compressed(layout, records):
    fields = bytearray()
    start = 0
    for width in layout.widths:
        field = bytearray(len(records) // layout.stride * width)
        for k in range(width):
            field[k::width] = records[start + k :: layout.stride]
        fields += field
        start += width
    packed = lzf(bytes(fields), *layout.dialect)
    return struct.pack("<II", len(packed), len(fields)) + packed


def lzf(data, hash_bits, multiplier, inserts):
    out = bytearray()
    table = [0] * (1 << hash_bits)
    mask = (1 << hash_bits) - 1
    size = len(data)

    def enter(at):
        v = data[at] << 16 | data[at + 1] << 8 | data[at + 2]
        slot = (v >> (24 - hash_bits)) - v * multiplier & mask
        before = table[slot]
        table[slot] = at
        return before

    def literals_to(end):
        for at in range(literals, end, 32):
            run = data[at : min(at + 32, end)]
            out.append(len(run) - 1)
            out.extend(run)

    literals = at = 0
    while at + 2 < size:
        c = enter(at)
        if not (0 < c < at and at - c <= 8192 and data[c : c + 3] == data[at : at + 3]):
            at += 1
            continue
        literals_to(at)
        m = min(size - at - 2, 264)
        limit = max(m, 3 if m <= 16 else 19)
        length = 3
        while length < limit and data[c + length] == data[at + length]:
            length += 1
        offset = at - c - 1
        coded = length - 2
        if coded <= 6:
            out += bytes((coded << 5 | offset >> 8, offset & 255))
        else:
            out += bytes((7 << 5 | offset >> 8, coded - 7, offset & 255))
        at += length
        literals = at
        if at + 2 >= size:
            break
        for k in range(inserts, 0, -1):
            enter(at - k)
    literals_to(size)
    return bytes(out)


# Text


def text(layout, records):
    separator = "\t" if layout.flags & 2 else " "
    end = (separator if layout.flags & 4 else "") + ("\r\n" if layout.flags & 1 else "\n")
    lines = []
    for values in struct.iter_unpack("<" + "".join(c[0] for c in layout.columns), records):
        lines.append(separator.join(number(v, *c) for v, c in zip(values, layout.columns)) + end)
    return "".join(lines).encode()


def number(v, scalar, rule, parameter):
    if rule == INTEGER:
        return str(v)
    sign = "-" if struct.pack("<d", v)[7] >> 7 else ""
    v = abs(v)
    if not isfinite(v):
        return sign + ("nan" if isnan(v) else "inf")
    if rule == FIXED:
        return sign + f"{v:.{parameter}f}"
    if rule == SCIENTIFIC:
        return sign + f"{v:.{parameter}e}"
    if rule == SIGNIFICANT:
        return sign + f"{v:.{parameter}g}"
    is_single = scalar == "f" and not parameter & 1
    digits, exponent = shortest(v, is_single)
    if v and not -4 <= exponent < 16:
        fraction = "." + digits[1:] if len(digits) > 1 else ""
        return sign + f"{digits[0]}{fraction}e{'-' if exponent < 0 else '+'}{abs(exponent):02}"
    if exponent < 0:
        return sign + "0." + "0" * (-exponent - 1) + digits
    digits += "0" * (exponent + 1 - len(digits))
    whole, fraction = digits[: exponent + 1], digits[exponent + 1 :]
    if fraction:
        return sign + whole + "." + fraction
    return sign + whole + (".0" if parameter & 2 else "")


def shortest(v, is_single):
    """The fewest digits that read back, and the exponent of ten of the first."""
    if v == 0:
        return "0", 0
    if not is_single:
        mantissa, exponent = f"{v!r}", None
        for n in range(17):
            mantissa, exponent = f"{v:.{n}e}".split("e")
            if float(f"{mantissa}e{exponent}") == v:
                break
        # Where the interval is uneven, repr knows a shorter text or one as short.
        short = Fraction(repr(v))
        if len(digits_of(short)) < len(mantissa.replace(".", "")):
            return digits_of(short), int(exponent)
        return mantissa.replace(".", ""), int(exponent)
    bits = struct.unpack("<I", struct.pack("<f", v))[0]

    def value(b):
        if b == 0x7F800000:
            return Fraction(2) ** 128
        return Fraction(struct.unpack("<f", struct.pack("<I", b))[0])

    exact = value(bits)
    least = (value(bits - 1) + exact) / 2
    most = (value(bits + 1) + exact) / 2
    is_even = bits % 2 == 0
    for n in range(10):
        mantissa, exponent = f"{v:.{n}e}".split("e")
        unit = Fraction(10) ** (int(exponent) - n)
        nearest = int(mantissa.replace(".", ""))
        for candidate in (nearest, nearest + 1):
            t = candidate * unit
            if least < t < most or is_even and t in (least, most):
                digits = str(candidate)
                return digits[: n + 1].rstrip("0") or "0", int(exponent) + len(digits) - n - 1
    raise AssertionError("nine digits are enough")


def digits_of(v):
    while v.denominator > 1:
        v *= 10
    return str(v.numerator).rstrip("0")
