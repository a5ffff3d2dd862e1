"""Section 8.9 of FORMAT.md: values of any type as integers, on a scale. A value is its bytes as an unsigned integer."""

import struct
from math import isfinite, isnan, pi, sqrt

from entropy import M64, wrap
from errors import Refused
from layout import F32, F64, SIZES, TYPES, U64
from models import f32, to_int
from scanner import bits_of_float, float_of_bits
from trigonometry import atan2

LEVELS = (255, 256, 65535, 65536)
QUOTIENT, PRODUCT, SINGLE, SINGLE_5, SINGLE_25, DEGREES = range(6)
FACTORS = {SINGLE: 1, SINGLE_5: 5, SINGLE_25: 25}


def bits_of_double(v):
    return int.from_bytes(struct.pack("<d", v), "little")


def double_of_bits(v):
    return struct.unpack("<d", v.to_bytes(8, "little"))[0]


def rank(kind, value):
    """The rank of a value among all of its type."""
    bits = 8 * SIZES[kind]
    if kind in (F32, F64):
        signed = wrap(value, bits)
        return ~(signed & (1 << bits - 1) - 1) if signed < 0 else signed
    if TYPES[kind].islower() or kind == U64:
        return wrap(value, bits)
    return value


def at_rank(kind, n):
    bits = 8 * SIZES[kind]
    if kind in (F32, F64):
        signed = wrap(n, bits)
        return ~signed & (1 << bits) - 1 | 1 << bits - 1 if signed < 0 else signed
    return n & (1 << bits) - 1


def converted(kind, value, to):
    """`same`: a value in another type."""
    if kind == to:
        return value
    if kind == F32:
        v = float_of_bits(value)
        if isnan(v) and to == F64:
            return 0x7FF8 << 48
    elif kind == F64:
        v = double_of_bits(value)
        if isnan(v) and to == F32:
            return 0x7FC00000
    else:
        v = float(value if kind == U64 else rank(kind, value))
    if to == F32:
        return bits_of_float(f32(v))
    if to == F64:
        return bits_of_double(v)
    if to == U64:
        return to_int(v, 0, M64)
    return at_rank(to, to_int(v))


class Scale:
    def __init__(self, code, kind):
        if code > 64 or code and kind not in (F32, F64):
            raise Refused("an unknown scale, or one of whole numbers")
        self.kind = kind
        self.form = None
        self.step = 1.0
        if code > 60:
            self.form, self.divisor = QUOTIENT, float(LEVELS[code - 61])
            self.step = 1 / self.divisor
        elif code:
            self.form, exponent = divmod(code - 1, 10)
            self.divisor = 10.0**exponent
            self.step = FACTORS.get(self.form, 1) / self.divisor
            if self.form == DEGREES:
                self.step *= pi / 180

    def value(self, n):
        """The value of an integer."""
        if self.form is None:
            return at_rank(self.kind, n)
        n = float(n)
        if self.form == QUOTIENT:
            v = n / self.divisor
        elif self.form == PRODUCT:
            v = n * (1 / self.divisor)
        elif self.form == DEGREES:
            v = n * (1 / self.divisor) * pi / 180
        else:
            v = f32(f32(n) * f32(self.step))
        return bits_of_float(f32(v)) if self.kind == F32 else bits_of_double(v)

    def nearest(self, v):
        """The integer of a number that a position tells."""
        if isnan(v):
            return 0
        if self.form is None and self.kind == F32:
            return rank(F32, bits_of_float(f32(v)))
        if self.form is None and self.kind == F64:
            return rank(F64, bits_of_double(v))
        v /= self.step
        return to_int(float(round(v)) if isfinite(v) else v)


def geometry_of_place(which, steps, tick, range_step_m, tick_degrees):
    """What a place in the range image tells; `which` is 12 to 19."""
    if which == 12:
        return steps * range_step_m
    if which == 19:
        return steps * range_step_m * 1000.0
    degrees = tick * tick_degrees
    unit = (which - 13) % 3
    angle = degrees * (pi / 180) if unit == 0 else degrees if unit == 1 else degrees * 100.0
    return angle if which < 16 else -angle


def geometry(which, position):
    """What a position tells; `which` is 1 to 11, or 20."""
    x, y, z = position
    flat = x * x + y * y
    if which == 1:
        return sqrt(flat + z * z)
    if which == 20:
        return sqrt(flat + z * z) * 1000.0
    if which == 2:
        return sqrt(flat)
    kind, unit = divmod(which - 3, 3)
    angle = (lambda: atan2(y, x), lambda: atan2(x, y), lambda: atan2(z, sqrt(flat)))[kind]()
    return angle * (1.0, 180 / pi, 18000 / pi)[unit] if unit else angle
