"""Section 9 of FORMAT.md: from records to a file's bytes."""

import struct
from fractions import Fraction
from math import isfinite, isnan

import arrow
from layout import ARROW, BIG_ENDIAN, BY_FIELD, CHARACTER, CRLF, F32, FIXED, HALF, INTEGER, OPEN_END, PCD_COMPRESSED, SCALED
from layout import SCIENTIFIC, Axis
from layout import SEPARATOR_FLAGS, SEPARATORS, SIGNIFICANT, SPACE_AFTER, TEXT, TRAILING_SEPARATOR, TYPES, WIDENED
from models import clamp, f32, to_int
from scanner import float_of_bits


def records_of(layout, n, positions, intensities, channels):
    """The records, one after the other."""
    stride = layout.stride
    data = bytearray(n * stride)

    def fill(field, values):
        width = field.width
        for k in range(width):
            data[field.offset + k :: stride] = values[k::width]

    if layout.position:
        for axis, field in enumerate(layout.position):
            fill(field, struct.pack(f"<{n}I", *[p[axis] for p in positions]))
    if layout.intensity:
        if layout.intensity.kind != F32:
            most = (1 << 8 * layout.intensity.size) - 1
            intensities = [to_int(f32(float_of_bits(v) + 0.5), 0, most) for v in intensities]
        letter = "I" if layout.intensity.kind == F32 else TYPES[layout.intensity.kind]
        fill(layout.intensity, struct.pack(f"<{n}{letter}", *intensities))
    for field, values in zip(layout.channels, channels):
        fill(field, values)
    return bytes(data)


def file_of(layout, prefix, records, suffix):
    """The bytes of a file."""
    if layout.wrapping == ARROW:
        columns = [stored(values_of(field, layout, records), w) for field, w in zip(layout.fields, layout.widened)]
        return arrow.file_of(prefix, columns, len(records) // layout.stride, layout.is_wide) + suffix
    return prefix + wrapped(layout, records) + suffix


def wrapped(layout, records):
    if layout.wrapping == PCD_COMPRESSED:
        return pcd_compressed(layout, records)
    if layout.wrapping == BIG_ENDIAN:
        return big_endian(layout, records)
    if layout.wrapping == TEXT:
        return text(layout, records)
    if layout.wrapping == SCALED:
        return scaled(layout, records)
    if layout.wrapping == WIDENED:
        return widened(layout, records)
    if layout.wrapping == BY_FIELD:
        return by_field(layout, records)
    return records


def big_endian(layout, records):
    out = bytearray(len(records))
    for field in layout.fields:
        size = field.size
        for start in range(field.offset, field.offset + field.width, size):
            for k in range(size):
                out[start + k :: layout.stride] = records[start + size - 1 - k :: layout.stride]
    return bytes(out)


def scaled(layout, records):
    out = bytearray(records)
    for field, axis in zip(layout.position, layout.axes):
        for at in range(field.offset, len(out), layout.stride):
            steps = steps_of(struct.unpack_from("<f", out, at)[0], axis, -(2.0**31), 2.0**31 - 1)
            struct.pack_into("<i", out, at, steps)
    return bytes(out)


def steps_of(metres, axis, least, most):
    steps = (metres - axis.offset) * axis.per_metre
    return 0 if isnan(steps) else round(clamp(steps, least, most))


def shorts(values, axis):
    """The bytes of 16-bit integers in place of those of float32."""
    values = struct.unpack(f"<{len(values) // 4}f", values)
    return b"".join(struct.pack("<H", steps_of(v, axis, 0.0, 65535.0)) for v in values)


def widened(layout, records):
    out = bytearray()
    for start in range(0, len(records), layout.stride):
        for field, widening in zip(layout.fields, layout.widened):
            out += stored(records[start + field.offset :][: field.width], widening)
    return bytes(out)


def stored(values, widening):
    """The bytes of a field as the file has them."""
    if isinstance(widening, Axis):
        return shorts(values, widening)
    if widening == HALF:
        return b"".join(map(half, struct.unpack(f"<{len(values) // 4}I", values)))
    return doubles(values, *widening) if widening else values


def half(bits):
    """The bytes of the half-precision number nearest to this float32."""
    value = float_of_bits(bits)
    if isnan(value):
        return struct.pack("<H", bits >> 31 << 15 | 0x7C00 | (bits >> 13 & 0x3FF or 0x200))
    if abs(value) >= 65520.0:
        return struct.pack("<H", bits >> 31 << 15 | 0x7C00)
    return struct.pack("<e", value)


def by_field(layout, records):
    out = bytearray()
    for field, widening in zip(layout.fields, layout.widened):
        out += stored(values_of(field, layout, records), widening)
    return bytes(out)


def values_of(field, layout, records):
    """The bytes of a field of all records."""
    values = bytearray(len(records) // layout.stride * field.width)
    for k in range(field.width):
        values[k :: field.width] = records[field.offset + k :: layout.stride]
    return bytes(values)


def doubles(values, rule, parameter):
    """The bytes of doubles in place of those of float32: the same numbers, or those of their texts."""
    if rule is None:
        return b"".join(map(double, struct.unpack(f"<{len(values) // 4}I", values)))
    return b"".join(of_text(number(v, "f", rule, parameter)) for v in struct.unpack(f"<{len(values) // 4}f", values))


def of_text(text):
    """The bytes of the double that a text stands for."""
    if text.endswith("nan"):
        return struct.pack("<Q", 0x7FF8 << 48 | text.startswith("-") << 63)
    return struct.pack("<d", float(text))


def double(bits):
    """The bytes of the double that this float32 is."""
    value = float_of_bits(bits)
    if isnan(value):
        bits = (bits >> 31) << 63 | 0x7FF << 52 | (bits & 0x7FFFFF) << 29
        return struct.pack("<Q", bits)
    return struct.pack("<d", value)


def pcd_compressed(layout, records):
    fields = b"".join(values_of(field, layout, records) for field in layout.fields)
    packed = lzf(fields, *layout.dialect)
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
    separator = SEPARATORS[layout.flags & SEPARATOR_FLAGS]
    line_end = "\r\n" if layout.flags & CRLF else "\n"
    end = (separator if layout.flags & TRAILING_SEPARATOR else "") + line_end
    if layout.flags & SPACE_AFTER:
        separator += " "
    lines = []
    for values in struct.iter_unpack("<" + "".join(c[0] for c in layout.columns), records):
        texts = (number(v, *c).rjust(width) for v, c, width in zip(values, layout.columns, layout.widths))
        lines.append(separator.join(texts) + end)
    if layout.flags & OPEN_END and lines:
        lines[-1] = lines[-1].removesuffix(line_end)
    return "".join(lines).encode("latin-1")


def number(v, scalar, rule, parameter):
    if rule == INTEGER:
        return str(v)
    if rule == CHARACTER:
        return chr(v & 255)
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
