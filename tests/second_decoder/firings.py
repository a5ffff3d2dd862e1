"""Sections 3.3, and 8.2 for its columns, of FORMAT.md: scanners of family `firings`."""

from math import inf, nextafter, pi
from struct import pack, unpack

from entropy import AdaptiveBit, IntegerModel, adaptive, integers, unzigzag, wrap
from errors import Refused
from models import clamp, f32, to_int
from scanner import Grid
from trigonometry import cos, glibc_cosf, glibc_sinf, old_cosf, old_sinf, sin

TOGETHER, VLP_16, ONE_FIRING, TWO_FIRINGS = range(4)
WHOLE = 1 << 24

# How the recipes' ranges are rounded, and which of them compute in double precision.
SINGLE_PRODUCT = 0, 3, 4, 8, 9, 13, 15, 16, 18, 20, 25, 27, 28
ROUNDED_PRODUCT = 6, 7, 10, 19, 21, 24, 26
DOUBLE = 1, 2, 3, 5, 11, 12, 14, 17, 22, 23, 25
GLIBC = 6, 7, 8, 9, 15, 16, 19, 20, 21, 22, 23
SUM_OF_RADIANS = 6, 19, 20
SUM_OF_DEGREES = 7, 14, 21, 22
DOUBLE_PRODUCTS = 14, 21, 22
FOCAL_POINT = 15, 16
OUSTER = 11, 12, 17
UNROUNDED = 1, 2, 3, 5, 25
PANDAR_64 = 10, 26
ROBOSENSE, LSLIDAR, APOLLO, ONCE, OUSTER_EARLY, ROBOSENSE_EARLY = 4, 5, 13, 14, 17, 18
HESAI_GENERAL_SDK, HESAI_SDK_2, ROS_RSLIDAR, ROBOSENSE_FUSED, ROBOSENSE_EARLY_FUSED = 23, 24, 25, 27, 28
LAST = 28

SLOT, FIRING, BLOCK = map(f32, (2.304, 55.296, 110.592))
LS_DEGREE = 0.017453293
DEGREE = pi / 180
FINE_TICKS = 36000 * 256


def radians(degrees):
    return degrees * pi / 180


def cos_single(v):
    return f32(cos(v))


def sin_single(v):
    return f32(sin(v))


def fine_angle(part):
    return part * 2 * pi / FINE_TICKS


def fma(a, b, c):
    """a * b + c for numbers that are f32, rounded to f32 once."""
    product = a * b  # exact
    total = product + c
    rest = total - product
    error = (product - (total - rest)) + (c - rest)
    # What is lost must not make it a tie.
    if error and not unpack("<Q", pack("<d", total))[0] & 1:
        total = nextafter(total, inf if error > 0 else -inf)
    return f32(total)


class Column:
    """A firing: the tick of its block, the ticks to the next block, and which firing of the block it is."""

    def __init__(self, tick, block):
        self.tick = tick
        self.block = block
        self.span = self.firing = 0


class Laser:
    pass


def permutation(reader, rows):
    found = [reader.varint() for _ in range(rows)]
    if sorted(found) != list(range(rows)):
        raise Refused("an order is no permutation of the rows")
    return found


class Scanner:
    """Family `firings`."""

    # Nothing is predicted from regions, nor from surfaces that moved.
    has_surfaces = False
    is_of_firings = True

    def __init__(self, reader):
        self.recipe = reader.varint()
        if self.recipe > LAST:
            raise Refused("an unknown recipe")
        self.ticks = reader.varint()
        self.range_step_um = reader.varint()
        grid, step = reader.varint(), reader.varint()
        origin = reader.svarint(), reader.svarint()
        rows = reader.varint()
        if not 1 <= self.ticks <= 360000 or not 1 <= self.range_step_um <= 1000000 or not 1 <= rows <= 1024:
            raise Refused("a scanner with impossible numbers")
        if max(map(abs, origin)) > 10**6:
            raise Refused("beams that start too far away")
        self.grid = Grid.of_numbers(grid, step)
        if self.grid is None:
            raise Refused("an impossible grid of coordinates")
        self.along_um, self.up_um = origin
        self.along, self.up = (um * 1e-6 for um in origin)
        self.range_step = self.range_step_um * 1e-6
        self.tick_degrees = 360 / self.ticks
        angles = [(reader.svarint(), reader.svarint()) for _ in range(rows)]
        if max(abs(angle) for laser in angles for angle in laser) > 360 * 10**9:
            raise Refused("a laser with impossible angles")
        self.rows_of_slots = permutation(reader, rows)
        by_line = reader.varint()
        if by_line > 1:
            raise Refused("an unknown order")
        self.rows_of_lines = permutation(reader, rows) if by_line else None
        lagging = reader.varint()
        if lagging > 1:
            raise Refused("an unknown kind of columns")
        self.lags = [reader.varint() for _ in range(rows)] if lagging else [0] * rows
        if max(self.lags) >= self.ticks:
            raise Refused("a row more than a turn behind")
        self.timing = reader.varint()
        if self.timing > TWO_FIRINGS:
            raise Refused("an unknown timing")
        self.parts = [reader.varint() for _ in range(max(self.timing - 1, 0) * rows)]
        if any(part > 2 * WHOLE for part in self.parts):
            raise Refused("more than two blocks")
        self.mounting = reader.varint()
        if self.mounting > 7:
            raise Refused("an unknown mounting")
        numbers = [unpack("<d", reader.take(8))[0] for _ in range(12 if self.mounting else 0)]
        if not all(abs(number) <= 1e6 for number in numbers):
            raise Refused("an impossible mounting")
        self.mounting_rows = [numbers[i : i + 4] for i in range(0, len(numbers), 4)]
        reader.end()
        self.slots = {row: slot for slot, row in enumerate(self.rows_of_slots)}
        self.cosine, self.sine = (glibc_cosf, glibc_sinf) if self.recipe in GLIBC else (cos_single, sin_single)
        if self.recipe in (APOLLO, ONCE):
            self.cosine, self.sine = old_cosf, old_sinf
        self.position = {
            1: self.double,
            2: self.double,
            3: self.double,
            4: self.robosense,
            5: self.lslidar,
            11: self.ouster,
            12: self.ouster,
            OUSTER_EARLY: self.ouster,
            ROBOSENSE_EARLY: self.robosense,
            ROBOSENSE_FUSED: self.robosense,
            ROBOSENSE_EARLY_FUSED: self.robosense,
            HESAI_GENERAL_SDK: self.hesai_general_sdk,
            HESAI_SDK_2: self.hesai_sdk_2,
            ROS_RSLIDAR: self.ros_rslidar,
            **dict.fromkeys(SUM_OF_RADIANS + SUM_OF_DEGREES, self.sum),
        }.get(self.recipe, self.single)
        self.lasers = [self.laser(elevation * 1e-9, azimuth * 1e-9) for elevation, azimuth in angles]
        self.of_ticks = {}

    @property
    def rows(self):
        return len(self.lasers)

    def new_columns(self):
        return Columns()

    def tick_of_cell(self, row, column):
        """The tick of a row in a column."""
        return (self.passed(row, column) + self.ticks - self.lags[row]) % self.ticks

    def passed(self, row, column):
        """The tick of a row in a column, were it not behind."""
        if self.timing == TOGETHER:
            return column.tick
        slot = self.slots[row]
        if self.timing == VLP_16:
            time = f32(f32(slot * SLOT) + f32(column.firing * FIRING))
            after = f32(f32(column.span * time) / BLOCK)
            return to_int(f32(f32(column.tick + after) + 0.5), 0, (1 << 32) - 1)
        place = column.firing * self.rows + slot
        part = self.parts[place] if place < len(self.parts) else 0
        return column.tick + column.span * part // WHOLE

    def in_canonical_order(self, ranges, columns, is_full):
        """(row, column, tick, steps) of each return and blank."""
        if self.rows_of_lines:
            cells = ((row, n) for row in self.rows_of_lines for n in range(len(columns)))
        else:
            cells = ((row, n) for n in range(len(columns)) for row in self.rows_of_slots)
        return [
            (row, n, self.tick_of_cell(row, columns[n]), ranges[row][n])
            for row, n in cells
            if is_full or ranges[row][n]
        ]

    def expected_position(self, row, tick, steps, between):
        """The formula of the correction section (8.7)."""
        measured = self.measured_position(row, tick, steps, between)
        if not self.mounting:
            return measured
        x, y, z = measured if self.mounting == 6 else map(f32, measured)
        return tuple(self.moved(x, y, z, *row) for row in self.mounting_rows)

    def moved(self, x, y, z, a, b, c, t):
        """A coordinate in the frame of a vehicle."""
        if self.mounting in (1, 6):
            return a * x + b * y + c * z + t
        if self.mounting == 2:
            return f32(a * x + b * y + c * z) + t
        a, b, c, t = map(f32, (a, b, c, t))
        if self.mounting == 3:
            return f32(f32(x * a) + f32(f32(y * b) + f32(f32(z * c) + t)))
        if self.mounting == 4:
            return f32(f32(f32(f32(x * a) + f32(y * b)) + f32(z * c)) + t)
        if self.mounting == 7:
            return f32(f32(f32(x * a) + f32(f32(y * b) + f32(z * c))) + t)
        return f32(fma(z, c, fma(y, b, f32(x * a))) + t)

    def measured_position(self, row, tick, steps, between):
        """The same in the frame of the scanner."""
        if self.recipe in OUSTER:
            m = (steps * self.range_step - 0.5 * self.range_step) * 1e3 if between else steps * (self.range_step_um * 1e-3)
            direction, start = self.ouster(self.lasers[row], tick)
            if self.recipe == 12 and not between:
                return tuple(f32(f32(f32(m) * f32(d)) + f32(s)) for d, s in zip(direction, start))
            position = tuple(m * d + s for d, s in zip(direction, start))
            return position if between else tuple(map(f32, position))
        d = steps * self.range_step
        if between:
            d += -0.5 * self.range_step
            if self.recipe not in DOUBLE:
                d = f32(d)
        elif self.recipe in SINGLE_PRODUCT:
            d = f32(f32(steps) * f32(self.range_step))
        elif self.recipe in ROUNDED_PRODUCT:
            d = f32(d)
        position = self.position(self.lasers[row], tick, d)
        is_rounded = not between and not (self.mounting == 6 and self.recipe in UNROUNDED)
        return tuple(map(f32, position)) if is_rounded else position

    def laser(self, e, o):
        laser = Laser()
        laser.offset = o
        laser.turned = round(o / 360 * self.ticks) % self.ticks
        if self.position == self.single:
            v, offset = f32(radians(e)), f32(radians(-o))
            if self.recipe in FOCAL_POINT:
                v, offset = f32(radians(f32(e))), f32(radians(f32(-o)))
                tangent = -sin(v) / cos(v)
                laser.height = f32(f32(self.along) * f32(tangent)) if self.recipe == 15 else f32(round(self.along * tangent * 1e5) / 1e5)
            laser.cos_v, laser.sin_v = self.cosine(v), self.sine(v)
            laser.direction = (self.cosine(offset), self.sine(offset)) if o else None
        elif self.recipe in (ROBOSENSE_EARLY, ROBOSENSE_EARLY_FUSED):
            laser.cos_v, laser.sin_v = self.direction_of_tick(round(e / 360 * self.ticks) % self.ticks)
        elif self.position == self.robosense:
            laser.cos_v, laser.sin_v = cos_single(radians(e)), sin_single(radians(e))
        elif self.recipe == HESAI_GENERAL_SDK:
            laser.cos_v, laser.sin_v = self.cosine(f32(radians(e))), self.sine(f32(radians(e)))
        elif self.recipe == HESAI_SDK_2:
            laser.turned = round(o / 360 * FINE_TICKS) % FINE_TICKS
            v = fine_angle(round(e / 360 * FINE_TICKS) % FINE_TICKS)
            laser.cos_v, laser.sin_v = cos_single(v), sin_single(v)
        elif self.recipe == ROS_RSLIDAR:
            laser.cos_v, laser.sin_v = cos(f32(radians(e))), sin(f32(radians(e)))
        elif self.position == self.lslidar:
            laser.cos_v, laser.sin_v = cos(e * LS_DEGREE), sin(e * LS_DEGREE)
        elif self.position == self.sum:
            v, laser.offset = f32(radians(f32(e))), f32(o)
            if self.recipe == 6:
                v, laser.offset = f32(f32(e) * f32(DEGREE)), f32(f32(o) * f32(DEGREE))
            elif self.recipe in SUM_OF_RADIANS:
                laser.offset = f32(radians(f32(o)))
            laser.cos_v, laser.sin_v = self.cosine(v), self.sine(v)
        else:
            laser.cos_v, laser.sin_v = cos(radians(e)), sin(radians(e))
        return laser

    def of_tick(self, make, tick):
        """What a recipe has of a tick, made once."""
        found = self.of_ticks.get(tick)
        if found is None:
            found = self.of_ticks[tick] = make(tick)
        return found

    # Recipes 0, 8, 9, 10, 13, 15, 16 and 26

    def direction_single(self, tick):
        if self.recipe == 10:
            a = f32(f32((tick + self.ticks // 4) % self.ticks) * f32(self.tick_degrees * pi / 180))
        elif self.recipe == 26:
            a = f32(radians(f32(f32(self.tick_degrees) * f32((tick + self.ticks // 4) % self.ticks))))
        elif self.recipe == 9:
            a = f32(radians(self.tick_degrees * tick))
        elif self.recipe == APOLLO:
            a = f32(f32(f32(self.tick_degrees) * f32(tick * pi)) / 180)
        elif self.recipe in FOCAL_POINT:
            a = f32(f32(f32(self.tick_degrees) * f32(tick)) * f32(DEGREE))
        else:
            a = f32(radians(f32(f32(self.tick_degrees) * f32(tick))))
        return self.cosine(a), self.sine(a)

    def single(self, laser, tick, d):
        c, s = self.of_tick(self.direction_single, tick)
        if laser.direction:
            cos_o, sin_o = laser.direction
            c, s = f32(f32(c * cos_o) + f32(s * sin_o)), f32(f32(s * cos_o) - f32(c * sin_o))
        flat = d * laser.cos_v if self.recipe == APOLLO else f32(d * laser.cos_v)
        x, y, z = f32(flat * c), f32(flat * s), f32(d * laser.sin_v)
        if self.recipe in FOCAL_POINT:
            z = f32(z + laser.height)
        return (-x, y, z) if self.recipe in PANDAR_64 else (x, -y, z)

    # Recipes 1 to 3

    def double(self, laser, tick, d):
        a = radians(tick * self.tick_degrees + laser.offset)
        flat = d * laser.cos_v
        if self.recipe == 1:
            return flat * sin(a), flat * cos(a), d * laser.sin_v
        return flat * cos(a), -(flat * sin(a)), d * laser.sin_v

    # Recipes 4, 18, 27 and 28

    def direction_of_tick(self, tick):
        is_early = self.recipe in (ROBOSENSE_EARLY, ROBOSENSE_EARLY_FUSED)
        a = radians(tick * (f32(self.tick_degrees) if is_early else self.tick_degrees))
        return cos_single(a), sin_single(a)

    def robosense(self, laser, tick, d):
        c, s = self.of_tick(self.direction_of_tick, (tick + laser.turned) % self.ticks)
        c0, s0 = self.of_tick(self.direction_of_tick, tick)
        flat = f32(d * laser.cos_v)
        along = f32(self.along)
        if self.recipe in (ROBOSENSE_FUSED, ROBOSENSE_EARLY_FUSED):
            x = fma(along, c0, f32(flat * c)) if self.recipe == ROBOSENSE_FUSED else fma(flat, c, f32(along * c0))
            return x, fma(-flat, s, -f32(along * s0)), fma(d, laser.sin_v, f32(self.up))
        x = f32(f32(flat * c) + f32(along * c0))
        y = f32(f32(-flat * s) - f32(along * s0))
        return x, y, f32(f32(d * laser.sin_v) + f32(self.up))

    # Recipe 5

    def lslidar(self, laser, tick, d):
        t = (tick + laser.turned) % self.ticks * self.tick_degrees
        p, q = t * LS_DEGREE, (t - laser.offset) * LS_DEGREE
        flat = d * laser.cos_v
        x = flat * sin(p) + self.along * sin(q)
        y = flat * cos(p) + self.along * cos(q)
        return x, y, d * laser.sin_v + self.up

    # Recipes 23 to 25

    def angle_of_tick(self, tick):
        if self.recipe == HESAI_GENERAL_SDK:
            a = f32(tick * pi / (0.5 * self.ticks))
            return self.cosine(a), self.sine(a)
        a = f32(f32(f32(tick) / f32(0.5 * self.ticks)) * pi)
        return cos(a), sin(a)

    def hesai_general_sdk(self, laser, tick, d):
        c, s = self.of_tick(self.angle_of_tick, (tick + laser.turned) % self.ticks)
        flat = f32(d * laser.cos_v)
        return f32(flat * s), f32(flat * c), f32(d * laser.sin_v)

    def hesai_sdk_2(self, laser, tick, d):
        a = fine_angle((tick * FINE_TICKS // self.ticks + laser.turned) % FINE_TICKS)
        flat = f32(d * laser.cos_v)
        return f32(flat * sin_single(a)), f32(flat * cos_single(a)), f32(d * laser.sin_v)

    def ros_rslidar(self, laser, tick, d):
        c, s = self.of_tick(self.angle_of_tick, (tick + laser.turned) % self.ticks)
        flat = d * laser.cos_v
        return flat * c, -(flat * s), d * laser.sin_v

    # Recipes 11, 12 and 17

    def ouster(self, laser, tick):
        """What a millimetre adds, and where ranges start."""
        a = tick * self.tick_degrees
        p, q = radians(a), radians(a + laser.offset)
        beam = cos(q) * laser.cos_v, -sin(q) * laser.cos_v, laser.sin_v
        ahead, above = (cos(p), -sin(p), 0.0), (0.0, 0.0, self.up_um * 1e-3)
        along = self.along_um * 1e-3
        farther = along, along, -along if self.recipe == OUSTER_EARLY else along
        direction = tuple(b * 1e-3 for b in beam)
        start = tuple((along * a - f * b + n) * 1e-3 for a, f, b, n in zip(ahead, farther, beam, above))
        return direction, start

    # Recipes 6, 7, 14 and 19 to 22

    def sum(self, laser, tick, d):
        if self.recipe == 6:
            a = f32(f32(tick / (self.ticks / 360) * DEGREE) + laser.offset)
        elif self.recipe in SUM_OF_RADIANS:
            a = f32(f32(radians(tick / (self.ticks / 360))) + laser.offset)
        else:
            a = f32(radians(laser.offset + tick / (1 / self.tick_degrees)))
        flat = d * laser.cos_v if self.recipe in DOUBLE_PRODUCTS else f32(d * laser.cos_v)
        return f32(flat * self.sine(a)), f32(flat * self.cosine(a)), f32(d * laser.sin_v)


def context(difference):
    return clamp(difference, -2, 2) + 2


class Columns:
    """8.2."""

    def __init__(self):
        self.full = AdaptiveBit()
        self.count = IntegerModel()
        self.same_block = adaptive(2)
        self.steps = integers(5)
        self.spans = integers(5)
        self.has_own_span = AdaptiveBit()
        self.own_span = IntegerModel()
        self.firing = adaptive(2)

    def code(self, bits, scanner):
        """The columns, and whether the image is full."""
        columns = []
        turn = scanner.ticks
        is_full = self.full.code(bits)
        n = self.count.code(bits)
        if n * scanner.rows > 1 << 24:
            raise Refused("a range image of too many columns")
        tick = step = difference = same = block = 0
        for _ in range(n):
            if scanner.timing:
                same = self.same_block[same].code(bits)
            if not same:
                difference = unzigzag(self.steps[context(difference)].code(bits))
                step = wrap(step + difference, 64)
                tick = wrap(tick + step, 64) % turn
                if columns:
                    block += 1
            columns.append(Column(tick, block))
        if scanner.timing:
            self.code_spans(bits, columns, turn)
        return columns, is_full

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
            elif self.has_own_span.code(bits):
                span = wrap(span + unzigzag(self.own_span.code(bits)), 64)
            if not 0 <= span <= turn:
                raise Refused("a span of more than a turn")
            column.span = span
            before = column.block
