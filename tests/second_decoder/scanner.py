"""Sections 3.2, 3.4, and 8.2 for its columns, of FORMAT.md: scanners of family `hdl64`, coordinate grids."""

import struct
from fractions import Fraction
from math import copysign, inf, isfinite, isnan, nan, nextafter, sqrt

from entropy import adaptive
from errors import Refused
from models import TAU, clamp, f32
from trigonometry import cos, sin, sin_cos_f32

MILLIMETRE, FLOAT32, LATTICE, DIGITS, HALF = range(5)
SINGLE_PRECISION = 2


def small_atan(t):
    s = t * t
    return t * (1 - s * (1 / 3 - s * (1 / 5 - s / 7)))


def float_of_bits(bits):
    return struct.unpack("<f", struct.pack("<I", bits))[0]


def bits_of_float(v):
    return struct.unpack("<I", struct.pack("<f", v))[0]


def exponent(v):
    """The exponent bits of a float64, less 1023."""
    return (struct.unpack("<Q", struct.pack("<d", v))[0] >> 52 & 0x7FF) - 1023


def rank(v):
    """Of a float32, as its bits."""
    key = v ^ 0xFFFFFFFF if v >> 31 else v | 0x80000000
    return key - 0x80000000


def of_rank(unit):
    """The bits of a float32."""
    key = unit + 0x80000000 & 0xFFFFFFFF
    return key - 0x80000000 if key >> 31 else key ^ 0xFFFFFFFF


def single_of(number, exponent):
    """The float32 nearest to number * 10^exponent."""
    exact = Fraction(number) * Fraction(10) ** exponent
    if exact >= 1 << 129:
        return inf
    # Of the two float64s around it, the odd one: it rounds to float32 as the number itself does.
    near = float(exact)
    if near != exact and not struct.pack("<d", near)[0] & 1:
        near = nextafter(near, inf if near < exact else 0)
    return f32(near)


class Grid:
    """3.4: a grid of coordinates; `step` is that of a lattice, in metres, or the number of digits.

    Values are the bits of float32s."""

    def __init__(self, kind, step=None):
        self.kind = kind
        self.step = step

    @classmethod
    def of_numbers(cls, kind, step):
        """The grid with these numbers, or None if they do not fit together."""
        if kind in (0, 1, 4) and step == 0:
            return cls({0: FLOAT32, 1: MILLIMETRE, 4: HALF}[kind])
        if kind == 2 and 1 <= step <= 10**9:
            return cls(LATTICE, step * 1e-9)
        if kind == 3 and 1 <= step <= 9:
            return cls(DIGITS, step)
        if kind == 5 and 1 <= step <= 30:
            return cls(LATTICE, 2.0**-step)
        return None

    def unit_of(self, metres):
        if isnan(metres):
            return 0
        if self.kind == FLOAT32:
            return rank(bits_of_float(f32(metres)))
        if self.kind == DIGITS:
            return self.decimal_unit(metres)
        if self.kind == HALF:
            bits = bits_of_float(f32(metres))
            unit = ((bits & 0x7FFFFFFF) + (1 << 12)) >> 13
            return -unit if bits >> 31 else unit
        scaled = metres / self.step if self.kind == LATTICE else metres * 1000
        return round(clamp(scaled, -1e12, 1e12))

    def decimal_unit(self, metres):
        if metres == 0 or not isfinite(metres):
            return 0
        mantissa, exponent = f"{abs(metres):.{self.step - 1}e}".split("e")
        number, exponent = int(mantissa.replace(".", "")), int(exponent) + 46
        if exponent < 0:
            return 0
        least = 10 ** (self.step - 1)
        unit = exponent * 9 * least + number - least + 1
        return -unit if metres < 0 else unit

    def step_exponent(self, v):
        if self.kind == MILLIMETRE:
            return -10
        if self.kind == LATTICE:
            return exponent(self.step)
        return clamp(exponent(v), -126, 127) - {FLOAT32: 23, HALF: 10}.get(self.kind, (self.step or 0) * 10 // 3)

    def value(self, unit, formula):
        if self.kind == FLOAT32:
            return of_rank(unit)
        if unit == 0:
            if isnan(formula):
                return 0
            return bits_of_float(f32(formula)) & 0x80000000
        if self.kind == LATTICE:
            return bits_of_float(f32(float(unit) * self.step))
        if self.kind == HALF:
            return min(abs(unit), 0x7F7FFFFF >> 13) << 13 | (0x80000000 if unit < 0 else 0)
        if self.kind == DIGITS:
            least = 10 ** (self.step - 1)
            place, number = divmod(abs(unit) - 1, 9 * least)
            v = single_of(number + least, min(place, 100) - 45 - self.step)
            return bits_of_float(-v if unit < 0 else v)
        return bits_of_float(f32(float(unit) / 1000))


class Beam:
    pass


class Scanner:
    """Family `hdl64`."""

    has_surfaces = True
    is_of_firings = False

    def __init__(self, reader):
        self.coordinates = reader.varint()
        if self.coordinates > SINGLE_PRECISION:
            raise Refused("unknown grid of coordinates")
        self.ticks = reader.varint()
        range_step_um = reader.varint()
        rows = reader.varint()
        if not 1 <= self.ticks <= 360000 or range_step_um > 1000000 or not 1 <= rows <= 1024:
            raise Refused("a scanner with impossible numbers")
        self.range_step_um = range_step_um
        self.range_step = range_step_um * 1e-6
        self.beams = []
        for _ in range(rows):
            beam = Beam()
            values = [reader.svarint() for _ in range(6)]
            if max(map(abs, values)) > 1 << 34:
                raise Refused("a beam with impossible constants")
            beam.elevation = values[0] * 2.0**-32
            beam.b, beam.c, beam.h = (v * 2.0**-24 for v in values[1:4])
            beam.rot = values[4] * 2.0**-32
            beam.column_shift = values[5]
            beam.cos_v, beam.sin_v = cos(beam.elevation), sin(beam.elevation)
            beam.cos_rot, beam.sin_rot = cos(beam.rot), sin(beam.rot)
            self.beams.append(beam)
        if self.coordinates == SINGLE_PRECISION:
            for beam in self.beams:
                values = [reader.svarint() for _ in range(7)]
                if max(map(abs, values)) > 1 << 36:
                    raise Refused("a beam with impossible constants")
                self.single(beam, values)
        reader.end()
        self.grid = Grid(MILLIMETRE if self.coordinates == MILLIMETRE else FLOAT32)
        self.directions = {}

    @property
    def rows(self):
        return len(self.beams)

    def direction(self, tick):
        """(cos, sin) of a tick."""
        found = self.directions.get(tick)
        if found is None:
            angle = (tick / self.ticks) * TAU
            found = self.directions[tick] = cos(angle), sin(angle)
        return found

    def new_columns(self):
        return Columns()

    def in_canonical_order(self, ranges, columns, is_full):
        """(row, column, tick, steps) of each return (4.2). No image of this family is full."""
        found = []
        for row, cells in enumerate(ranges):
            of_row = []
            for column, steps in enumerate(cells):
                if steps:
                    tick = self.tick_of_column(row, columns[column])
                    of_row.append((self.azimuth(row, tick, steps), row, column, tick, steps))
            of_row.sort(key=lambda e: e[0])
            found += [e[1:] for e in of_row]
        return found

    def tick_of_column(self, row, column_tick):
        return (column_tick - self.beams[row].column_shift) % self.ticks

    def metres(self, steps):
        return steps * self.range_step if self.range_step_um else float_of_bits(steps)

    def turned(self, beam, tick):
        cos_t, sin_t = self.direction(tick)
        return cos_t * beam.cos_rot - sin_t * beam.sin_rot, sin_t * beam.cos_rot + cos_t * beam.sin_rot

    def point_at(self, row, tick, d):
        beam = self.beams[row]
        rho = d * beam.cos_v + beam.b
        cos_a, sin_a = self.turned(beam, tick)
        h = beam.h
        length = sqrt(rho * rho + h * h)
        z = d * beam.sin_v + beam.c
        if length == 0:
            return nan, nan, z
        along = rho / length
        return along * (cos_a * rho - sin_a * h), along * (sin_a * rho + cos_a * h), z

    def point(self, row, tick, steps):
        return self.point_at(row, tick, self.metres(steps))

    def azimuth(self, row, tick, steps):
        beam = self.beams[row]
        rho = self.metres(steps) * beam.cos_v + beam.b
        side = beam.h / rho if rho else nan if beam.h == 0 else copysign(inf, beam.h)
        azimuth = (tick / self.ticks) * TAU + beam.rot + small_atan(side)
        if azimuth < 0:
            return azimuth + TAU
        if azimuth >= TAU:
            return azimuth - TAU
        return azimuth

    # Single-precision arithmetic

    def single(self, beam, values):
        sine, cosine, offset, height, side, azimuth, first_tick = values
        tick_degrees = 360 / self.ticks
        degrees = 180 / (TAU / 2)
        e = beam.b / beam.cos_v
        beam.sine = float_of_bits(of_rank(rank(bits_of_float(f32(beam.sin_v))) + sine))
        beam.cosine = float_of_bits(of_rank(rank(bits_of_float(f32(beam.cos_v))) + cosine))
        beam.offset = e + offset * 2.0**-40
        beam.height = (beam.c - e * beam.sin_v) + height * 2.0**-40
        beam.side = beam.h + side * 2.0**-40
        beam.added = (beam.rot * degrees + first_tick * tick_degrees) + azimuth * 2.0**-40
        beam.first_tick = first_tick

    def position(self, row, tick, d):
        beam = self.beams[row]
        degrees_of = 180 / (TAU / 2)
        tick_degrees = 360 / self.ticks
        distance = f32(d + beam.offset)
        aside = small_atan(beam.side / (distance * beam.cosine)) * degrees_of
        counted = within(tick - beam.first_tick, self.ticks)
        turned = f32(f32(float(counted) * tick_degrees) + beam.added)
        degrees = f32(within(f32(turned + aside), 360))
        phi = f32(degrees * ((TAU / 2) / 180))
        s, c = sin_cos_f32(phi)
        x = f32(distance * f32(beam.cosine * c))
        y = f32(distance * f32(beam.cosine * s))
        return x, y, f32(f32(distance * beam.sine) + beam.height)

    def expected_position(self, row, tick, steps, between):
        """The formula of the correction section (8.7)."""
        d = self.metres(steps)
        if between:
            d += -0.5 * self.range_step
        if self.coordinates == SINGLE_PRECISION:
            return self.position(row, tick, d)
        return self.point_at(row, tick, d)


def within(v, turn):
    return v + turn if v < 0 else v - turn if v >= turn else v


class Columns:
    """8.2: the ticks of the columns."""

    def __init__(self):
        self.bits = adaptive(4 * 32 * 4)

    def code(self, bits, scanner):
        """The columns, and whether the image is full."""
        columns = []
        gap = run = last_gap = 0
        for tick in range(scanner.ticks):
            if self.bits[(min(gap, 3) * 32 + run) * 4 + min(last_gap, 3)].code(bits):
                columns.append(tick)
                run = min(run + 1, 31) if gap else 0
                last_gap = gap
                gap = 0
            else:
                gap += 1
        return columns, False
