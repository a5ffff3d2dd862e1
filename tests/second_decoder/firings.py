"""Sections 3.3, and 8.2 for its columns, of FORMAT.md: scanners of family `firings`."""

from math import pi

from entropy import IntegerModel, adaptive, integers, unzigzag, wrap
from errors import Refused
from models import clamp, f32, to_int
from scanner import FLOAT32, Grid
from trigonometry import cos, sin

VELODYNE_ROS, DOUBLE_Y_AHEAD, DOUBLE_X_AHEAD, SINGLE_RANGE_X_AHEAD = range(4)


def radians(degrees):
    return degrees * pi / 180


def microseconds(nanoseconds):
    return f32(nanoseconds * 1e-3)


class Column:
    """A firing: the tick of its block, the ticks to the next block, and which firing of the block it is."""

    def __init__(self, tick, block):
        self.tick = tick
        self.block = block
        self.span = self.firing = 0


class Scanner:
    """Family `firings`."""

    # Nothing is predicted from regions or from a frame before.
    has_references = False
    is_of_firings = True

    def __init__(self, reader):
        self.recipe = reader.varint()
        if self.recipe > SINGLE_RANGE_X_AHEAD:
            raise Refused("an unknown recipe")
        self.ticks = reader.varint()
        self.range_step_um = reader.varint()
        times = [reader.varint() for _ in range(3)]
        rows = reader.varint()
        if not 1 <= self.ticks <= 360000 or not 1 <= self.range_step_um <= 1000000 or not 1 <= rows <= 1024:
            raise Refused("a scanner with impossible numbers")
        if max(times) > 1 << 31:
            raise Refused("a scanner with impossible times")
        self.is_interpolated = times[2] > 0
        self.slot_time, self.firing_time, self.block_time = map(microseconds, times)
        self.range_step = self.range_step_um * 1e-6
        lasers = [(reader.svarint(), reader.svarint()) for _ in range(rows)]
        if max(abs(angle) for laser in lasers for angle in laser) > 360 * 10**9:
            raise Refused("a laser with impossible angles")
        self.rows_of_slots = [reader.varint() for _ in range(rows)]
        reader.end()
        if sorted(self.rows_of_slots) != list(range(rows)):
            raise Refused("the slots are no permutation of the rows")
        self.slots = {row: slot for slot, row in enumerate(self.rows_of_slots)}
        self.grid = Grid(FLOAT32)
        self.tick_degrees = 360 / self.ticks
        make = self.single if self.recipe == VELODYNE_ROS else self.double
        self.lasers = [make(elevation * 1e-9, azimuth * 1e-9) for elevation, azimuth in lasers]

    @property
    def rows(self):
        return len(self.lasers)

    def new_columns(self):
        return Columns()

    def tick_of_cell(self, row, column):
        """The tick of a row in a column."""
        if not self.is_interpolated:
            return column.tick
        passed = f32(f32(self.slots[row] * self.slot_time) + f32(column.firing * self.firing_time))
        after = f32(f32(column.span * passed) / self.block_time)
        return to_int(f32(f32(column.tick + after) + 0.5), 0, (1 << 32) - 1) % self.ticks

    def in_canonical_order(self, ranges, columns):
        """(row, column, tick, steps) of each return."""
        return [
            (row, n, self.tick_of_cell(row, column), ranges[row][n])
            for n, column in enumerate(columns)
            for row in self.rows_of_slots
            if ranges[row][n]
        ]

    def expected_position(self, row, tick, steps, between):
        """The formula of the correction section (8.7)."""
        d = steps * self.range_step
        if between:
            d += -0.5 * self.range_step
        elif self.recipe in (VELODYNE_ROS, SINGLE_RANGE_X_AHEAD):
            d = f32(f32(steps) * f32(self.range_step))
        if self.recipe == VELODYNE_ROS:
            return self.single_position(self.lasers[row], tick, f32(d))
        position = self.double_position(self.lasers[row], tick, d)
        return position if between else tuple(map(f32, position))

    # Recipe 0

    @staticmethod
    def single(elevation, azimuth):
        v, o = f32(radians(elevation)), f32(radians(-azimuth))
        return f32(cos(v)), f32(sin(v)), (f32(cos(o)), f32(sin(o))) if azimuth else None

    def single_position(self, laser, tick, d):
        cos_v, sin_v, offset = laser
        angle = f32(radians(f32(f32(self.tick_degrees) * f32(tick))))
        c, s = f32(cos(angle)), f32(sin(angle))
        if offset:
            cos_o, sin_o = offset
            c, s = f32(f32(c * cos_o) + f32(s * sin_o)), f32(f32(s * cos_o) - f32(c * sin_o))
        along = f32(d * cos_v)
        return f32(along * c), -f32(along * s), f32(d * sin_v)

    # Recipes 1 to 3

    @staticmethod
    def double(elevation, azimuth):
        v = radians(elevation)
        return cos(v), sin(v), azimuth

    def double_position(self, laser, tick, d):
        cos_v, sin_v, offset = laser
        angle = radians(tick * self.tick_degrees + offset)
        along = d * cos_v
        if self.recipe == DOUBLE_Y_AHEAD:
            return along * sin(angle), along * cos(angle), d * sin_v
        return along * cos(angle), -(along * sin(angle)), d * sin_v


def context(difference):
    return clamp(difference, -2, 2) + 2


class Columns:
    """8.2."""

    def __init__(self):
        self.count = IntegerModel()
        self.same_block = adaptive(2)
        self.steps = integers(5)
        self.spans = integers(5)
        self.firing = adaptive(2)

    def code(self, bits, scanner):
        columns = []
        turn = scanner.ticks
        n = self.count.code(bits)
        if n * scanner.rows > 1 << 24:
            raise Refused("a range image of too many columns")
        tick = step = difference = same = block = 0
        for _ in range(n):
            if scanner.is_interpolated:
                same = self.same_block[same].code(bits)
            if not same:
                difference = unzigzag(self.steps[context(difference)].code(bits))
                step = wrap(step + difference, 64)
                tick = wrap(tick + step, 64) % turn
                if columns:
                    block += 1
            columns.append(Column(tick, block))
        if scanner.is_interpolated:
            self.code_spans(bits, columns, turn)
        return columns

    def code_spans(self, bits, columns, turn):
        first_of_block = {}
        for column in reversed(columns):
            first_of_block[column.block] = column
        difference = span = 0
        before = None
        for column in columns:
            follows = column.block == before
            column.firing = self.firing[follows].code(bits)
            if not follows:
                after = first_of_block.get(column.block + 1)
                expected = span if after is None else (after.tick - column.tick) % turn
                difference = unzigzag(self.spans[context(difference)].code(bits))
                span = wrap(expected + difference, 64)
            if not 0 <= span <= turn:
                raise Refused("a span of more than a turn")
            column.span = span
            before = column.block
