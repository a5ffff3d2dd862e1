"""Sections 8.9 and 8.17 of FORMAT.md: channels and compressed bytes."""

from array import array
from math import isfinite, isnan, sqrt

from back_ends import unpacked
from entropy import M64, AdaptiveBit, IntegerModel, unzigzag, wrap
from errors import Refused
from layout import F32, SIZES, U16
from models import LeastSquares, MixedBits, f32, floats, ilog2, to_int
from scanner import bits_of_float, float_of_bits
from sections import ByteModel, Intensity, Near
from values import Scale, at_rank, converted, geometry, geometry_of_place, rank

CONSTANT, COLUMNS, BYTES, PACKED, PALETTE = range(5)
SAME, INTEGERS, LEVELS, IMAGE = 1, 2, 3, 4
MOST_LEVELS = 512
MOST_ENTRIES = 0xFFFF
BEAM, COLUMN, AFTER, TICK = 1, 2, 3, 4
CANDIDATES, TRIES = 13, 4
TABLE = 1 << 14
MASK = TABLE - 1


def palette(bits, most):
    count = bits.plain(16)
    if not 1 <= count <= most:
        raise Refused("a palette of too many integers, or of none")
    entries = [wrap(bits.plain(64), 64)]
    step = IntegerModel()
    for _ in range(1, count):
        entries.append(wrap(entries[-1] + step.code(bits), 64))
    return entries


class Beside:
    """What is known of the records, in the order of the file; each list may be empty. Positions and intensities are
    bits of float32s. Steps and ticks are those of a scanner of firings, in `range_step_m` and `tick_degrees`."""

    def __init__(self, rows=(), columns=(), positions=(), intensities=()):
        self.rows = rows
        self.columns = columns
        self.steps = ()
        self.ticks = ()
        self.range_step_m = 0.0
        self.tick_degrees = 0.0
        self.positions = positions
        self.intensities = intensities


class Channels:
    def __init__(self):
        self.columns = []
        self.bytes = ByteModel(12)

    def code(self, bits, fields, records, beside):
        """The bytes of each of these fields."""
        sources = Sources(beside)
        first = 0
        found = [None] * len(fields)
        for n in sorted(range(len(fields)), key=lambda n: fields[n].size):
            field = fields[n]
            count = field.count
            if count > 8 or first + count > 64:
                count = 0
            self.columns += [Column(n) for n in range(len(self.columns), first + count)]
            models = self.columns[first : first + count]
            first += count
            found[n] = self.channel(bits, field, records, sources, models)
            if field.count == 1:
                sources.channels[n] = field.kind, found[n]
        return found

    def channel(self, bits, field, records, sources, models):
        shape = bits.plain(8)
        if shape == CONSTANT:
            return bytes(bits.plain(8) for _ in range(field.width)) * records
        if shape == BYTES:
            return self.bytes.code(bits, records * field.width, field.width)
        if shape == PACKED:
            return decompressed(bits, field.kind, field.width, records)
        size = field.size
        if shape == PALETTE and len(models) == 1:
            entries = palette(bits, MOST_ENTRIES)
            numbers = models[0].code(bits, U16, records, sources)
            scale = Scale(0, field.kind)
            values = [scale.value(entries[min(number, len(entries) - 1)]) for number in numbers]
            return b"".join(value.to_bytes(size, "little") for value in values)
        if shape != COLUMNS or not models:
            raise Refused("a channel of unknown shape, or of too many columns")
        out = bytearray(records * field.width)
        for k, model in enumerate(models):
            values = b"".join(v.to_bytes(size, "little") for v in model.code(bits, field.kind, records, sources))
            for byte in range(size):
                out[k * size + byte :: field.width] = values[byte::size]
        return bytes(out)


class Sources:
    """What a column can be told by: `channels` by number, type and bytes of each."""

    def __init__(self, beside):
        self.beside = beside
        self.channels = {}

    def values(self, n):
        """Type and values."""
        if n < 3 and self.beside.positions:
            return F32, [position[n] for position in self.beside.positions]
        if n == 3 and self.beside.intensities:
            return F32, self.beside.intensities
        if n - 4 not in self.channels:
            raise Refused("a column is told by one that is not there")
        kind, data = self.channels[n - 4]
        size = SIZES[kind]
        return kind, [int.from_bytes(data[at : at + size], "little") for at in range(0, len(data), size)]

    def keys(self, key, records):
        if key == 0:
            return self.beside.rows or [0] * records
        kind, values = self.values(key + 3)
        if SIZES[kind] > 2:
            raise Refused("keys that are too large")
        return values


class Column:
    def __init__(self, number):
        self.number = number
        self.integers = None
        self.rules = Rules()
        self.is_off = AdaptiveBit()
        self.off = IntegerModel()
        self.last_off = 0
        self.levels = None
        self.image = None

    def code(self, bits, kind, records, sources):
        """The values."""
        method = bits.plain(8)
        if method == CONSTANT:
            return [bits.plain(8 * SIZES[kind])] * records
        if method == SAME:
            source, values = sources.values(bits.plain(16))
            return [converted(source, value, kind) for value in values]
        if method not in (INTEGERS, LEVELS, IMAGE):
            raise Refused("a column of unknown method")
        scale = Scale(bits.plain(8), kind)
        if method == LEVELS:
            return self.code_levels(bits, scale, kind, records, sources.beside)
        if method == IMAGE:
            return self.code_image(bits, scale, kind, records, sources.beside)
        has_exceptions = bits.plain(1)
        keys = sources.keys(bits.plain(16), records)
        lag = bits.plain(24)
        told_by = bits.plain(8)
        if told_by > 20:
            raise Refused("unknown geometry")
        rule = bits.plain(8)
        beside = sources.beside
        columns = (beside.ticks if rule == TICK else beside.columns) or [0] * records
        expected = [None] * records
        if 0 < told_by < 12 or told_by == 20:
            for n, position in enumerate(beside.positions):
                expected[n] = scale.nearest(geometry(told_by, list(map(float_of_bits, position))))
        elif told_by:
            for n, (steps, tick) in enumerate(zip(beside.steps, beside.ticks)):
                told = geometry_of_place(told_by, steps, tick, beside.range_step_m, beside.tick_degrees)
                expected[n] = scale.nearest(told)
        if self.integers is None and not rule:
            self.integers = Integers()
        first = bits.plain(8) if rule > TICK + 1 else 0
        is_rounded = rule > TICK and scale.form is None and kind == F32
        doubts = self.rules.doubts(bits) if rule else None
        found = []
        past = []
        for n in range(records):
            if has_exceptions and self.is_off.code(bits):
                found.append(at_rank(kind, self.off_scale(bits)))
                past.append(past[-1] if past else 0)
                continue
            if rule:
                past.append(self.rules.code(bits, (rule, first, is_rounded, doubts), n, keys[n], columns[n], expected[n] or 0))
            else:
                lagged = (past[n - lag], past[n - lag - 1]) if 0 < lag < n else None
                past.append(self.integers.code(bits, keys[n], columns[n], expected[n], lagged))
            found.append(scale.value(past[-1]))
        return found

    def code_levels(self, bits, scale, kind, records, beside):
        if self.number > 15:
            raise Refused("levels in a column with too high a number")
        has_exceptions = bits.plain(1)
        entries = palette(bits, MOST_LEVELS)
        rows = beside.rows or [0] * records
        columns = beside.columns or [0] * records
        if self.levels is None:
            self.levels = Levels()
        self.levels.start(len(entries), max(rows, default=0) + 1, records)
        found = []
        for row, column in zip(rows, columns):
            if has_exceptions and self.is_off.code(bits):
                found.append(at_rank(kind, self.off_scale(bits)))
            else:
                level = self.levels.code(bits, row, column)
                found.append(scale.value(entries[min(level, len(entries) - 1)]))
        return found

    def code_image(self, bits, scale, kind, records, beside):
        has_exceptions = bits.plain(1)
        divisor = max(bits.plain(16), 1)
        rows = beside.rows or [0] * records
        columns = beside.columns or [0] * records
        steps = beside.steps or [0] * records
        if self.image is None:
            self.image = Image()
        self.image.start(max(rows, default=0), max(columns, default=0))
        found = []
        for row, column, own in zip(rows, columns, steps):
            if has_exceptions and self.is_off.code(bits):
                found.append(at_rank(kind, self.off_scale(bits)))
            else:
                found.append(scale.value(self.image.code(bits, row, column, own) * divisor))
        return found

    def off_scale(self, bits):
        if bits.plain(1):
            self.last_off = wrap(bits.plain(64), 64)
        else:
            self.last_off = wrap(self.last_off + unzigzag(self.off.code(bits)), 64)
        return self.last_off


class Levels:
    """Few values, as intensities are coded."""

    def __init__(self):
        self.intensity = Intensity(None)

    def start(self, count, rows, records):
        self.bits = ilog2(max(count - 1, 1)) + 1
        self.intensity.start(self.bits, rows, records)
        self.known = {}
        self.of_row = {}

    def code(self, bits, row, column):
        def at(down, right):
            return self.known.get((row + down, column + right), 0)

        up = -1 if at(-1, 0) or not at(1, 0) else 1
        near = Near()
        near.row, near.column = row, column
        near.left = self.of_row.get(row, [0] * 4)
        near.nww, near.nw, near.n, near.ne, near.nee = (at(up, right) for right in range(-2, 3))
        near.nnw, near.nn, near.nne = (at(2 * up, right) for right in range(-1, 2))
        near.s = near.m = near.sl = near.sr = 0
        level = self.intensity.level(bits, self.bits, near)
        context = min(level >> max(self.bits - 7, 0), 127) + 1
        if row > 0:
            self.known[row, column] = context
        self.of_row[row] = [context] + near.left[:3]
        return level


class Image:
    """Numbers of an image."""

    NONE = 0.0, 0.0, 0

    def __init__(self):
        self.fit = LeastSquares(8, 0.9995)
        self.bits = MixedBits([1 << n for n in (12, 16, 16, 18, 18, 18)], 64, 0.3, 0.0, 0.004)
        self.size = None
        self.known = {}

    def start(self, rows, columns):
        self.before = self.known if self.size == (rows, columns) else {}
        self.size = rows, columns
        self.known = {}
        self.of_row = {}

    def code(self, bits, row, column, steps):
        def at(down, right):
            return self.known.get((row + down, column + right))

        last = self.of_row.get(row, [])
        up = -1 if at(-1, 0) or not at(1, 0) else 1
        left = -1 if at(0, -1) or not at(0, 1) else 1
        n, nw, ne = at(up, 0), at(up, left), at(up, -left)
        w = last[0] if last else n or nw or ne or self.NONE
        ww = last[1] if len(last) > 1 else w
        n = n or nw or ne or w
        nw, ne, nn = nw or n, ne or n, at(2 * up, 0) or n
        back = self.before.get((row, column)) or w
        features = floats([near[0] for near in (w, n, nw, ne, ww, nn, back)] + [1.0])
        predicted = min(max(f32(self.fit.predict(features)), 0.0), 256.0)
        expected = min(to_int(f32(f32(predicted * predicted) + 0.5)), 65535)

        def half_bits(e):
            off = f32(f32(f32(e * f32(f32(2 * predicted) + e)) * 4) + 1)
            return min(ilog2(int(max(f32(off * off), 1.0))), 39)

        errors = f32(f32(w[1] + n[1]) + f32(0.5 * f32(nw[1] + ne[1])))
        spread = f32(abs(f32(w[0] - n[0])) + abs(f32(n[0] - nw[0])))
        es, ss = half_bits(f32(errors / 3)), half_bits(f32(spread / 2))
        octave = ilog2(max(expected, 1))
        size = expected if expected < 8 else (octave - 1) * 4 + (expected >> octave - 2 & 3)
        contexts = [
            es,
            self.slot(10, row, es // 4),
            self.slot(10, expected, 0),
            self.slot(12, w[2], n[2]),
            self.slot(12, size * 64 + es // 2, ilog2(steps) + 1 if steps else 0),
            self.slot(12, es * 64 + ss, size),
        ]
        v = min(max(expected + self.difference(bits, contexts), 0), 65535)
        root = f32(sqrt(v))
        self.fit.learn(features, root, 1.0)
        own = root, abs(f32(root - predicted)), v + 1
        if row and column:
            self.known[row, column] = own
        self.of_row[row] = [own] + last[:1]
        return v

    def difference(self, bits, contexts):
        def bit(node):
            return self.bits.code(bits, node, [c * 64 + node for c in contexts])

        if bit(0):
            return 0
        is_negative = bit(1)
        count = 0
        while count < 16 and bit(2 + count):
            count += 1
        m = 1
        for k in range(count):
            m = 2 * m + bit(20 + count if k == 0 else 37 + count if k == 1 else 55 + min(k, 8))
        return -m if is_negative else m

    @staticmethod
    def slot(n, a, c):
        c = c * 0x85EBCA6B & 0xFFFFFFFF
        c = (c << 13 | c >> 19) & 0xFFFFFFFF
        return ((a * 0x9E3779B1 & 0xFFFFFFFF ^ c) * 0x9E3779B1 & 0xFFFFFFFF) >> 32 - n


def slot(a, b):
    b &= M64
    m = ((a * 0x9E3779B97F4A7C15 ^ (b << 29 | b >> 35)) & M64) * 0xD6E8FEB86659FD93 & M64
    return (m ^ m >> 31) * 0x9E3779B97F4A7C15 >> 50 & MASK


class Rules:
    """Integers of a column that nearly all follow from a rule."""

    def __init__(self):
        self.offsets, self.after, self.bases = {}, {}, {}
        self.base = self.last = self.last_column = self.history = 0
        self.missed = None
        self.rounded = RoundedSums()
        self.is_right = [AdaptiveBit() for _ in range(256)]
        self.misses = None
        self.doubted = IntegerModel()
        self.doubts_new_columns = AdaptiveBit()

    def doubts(self, bits):
        return self.doubted.code(bits), self.doubts_new_columns.code(bits)

    def code(self, bits, settings, record, key, column, told):
        rule, first, is_rounded, (doubted, of_new_columns) = settings
        turn = rule - TICK if rule > TICK else 1
        phase = (column + first) % turn
        o = key * turn + phase
        if o >= TABLE:
            o = slot(key, phase)
        a = slot(key, self.last)
        base = {BEAM: 0, COLUMN: self.bases.get(column, 0), TICK: self.bases.get(column, 0)}.get(rule, self.base)
        expected = wrap(base + self.offsets.get(o, 0), 64)
        if rule == AFTER:
            expected = self.after.get(a, expected)
        if is_rounded:
            expected = self.rounded.expected(o)
        context = self.history & 3 | (column != self.last_column) << 2 | phase % 32 << 3
        is_doubted = record < doubted or of_new_columns and column != self.last_column
        is_right = self.is_right[context].code(bits) if is_doubted else 1
        v = expected
        if not is_right:
            if self.misses is None:
                self.misses = Integers()
            v = wrap(expected + self.misses.code(bits, key, 0, None, None), 64)
        self.history = self.history << 1 & 3 | is_right
        self.last_column = column
        if is_rounded:
            self.rounded.learn(o, v)
        elif rule == BEAM:
            self.offsets[o] = v
        elif rule in (COLUMN, TICK):
            if column in self.bases and o not in self.offsets:
                self.offsets[o] = wrap(v - self.bases[column], 64)
            else:
                self.bases[column] = wrap(v - self.offsets.setdefault(o, 0), 64)
        else:
            self.learn_base(o, v)
            if rule == AFTER:
                self.after[a] = v
                self.last = v
        return wrap(v + told, 64)

    def learn_base(self, o, v):
        missed, self.missed = self.missed, None
        if o not in self.offsets:
            self.offsets[o] = wrap(v - self.base, 64)
            return
        base = wrap(v - self.offsets[o], 64)
        if base == self.base:
            return
        if missed and missed[0] == base:
            self.offsets[missed[1]] = wrap(missed[2] - base, 64)
        else:
            self.missed = self.base, o, v
        self.base = base


class RoundedSums:
    """Sums of a base and a constant that were rounded to single precision."""

    def __init__(self):
        self.sums = {}
        self.bounds = 0.0, 0.0
        self.missed = None

    def expected(self, o):
        value = f32(middle(self.bounds) + self.sums.get(o, (0.0, 0.0))[0])
        return 0 if isnan(value) else rank(F32, bits_of_float(value))

    def learn(self, o, v):
        before, self.missed = self.missed, None
        t = float_of_bits(at_rank(F32, v))
        if not isfinite(t):
            return
        above = float_of_bits(bits_of_float(abs(t)) + 1)
        if not isfinite(above):
            return
        half = 0.5 * (above - abs(t))
        if o not in self.sums:
            self.sums[o] = self.new(t, half)
            return
        constant, error = self.sums[o]
        possible = t - constant - (half + error), t - constant + (half + error)
        bounds = shared(self.bounds, possible)
        if bounds:
            self.bounds = bounds
        elif before and shared(before[0], possible):
            self.bounds = shared(before[0], possible)
            self.sums[before[1]] = self.new(before[2], half)
        else:
            self.missed = self.bounds, o, t
            self.bounds = possible
        again = self.new(t, half)
        if again[1] < error:
            self.sums[o] = again

    def new(self, t, half):
        return t - middle(self.bounds), half + 0.5 * (self.bounds[1] - self.bounds[0])


def middle(bounds):
    return 0.5 * (bounds[0] + bounds[1])


def shared(a, b):
    least, largest = max(a[0], b[0]), min(a[1], b[1])
    return (least, largest) if least <= largest else None


def level(v):
    return min(int(v * 32), 31)


class Integers:
    """Integers of a column, each predicted in several ways."""

    def __init__(self):
        self.last = [0, 0, 0]
        self.key = 0
        self.of_key = {}
        self.of_keys, self.after, self.after_steps = (array("q", bytes(8 * TABLE)) for _ in range(3))
        self.of_column = {}
        self.scores = floats([0.5] * CANDIDATES)
        self.errors = floats([16.0] * CANDIDATES)
        self.history = 0
        self.hits = MixedBits([TABLE] * 5, TRIES, 0.3, 0.0, 0.004)
        self.is_long = AdaptiveBit()
        self.differences = [None] * 64

    def code(self, bits, key, column, geometry, lagged):
        a, b, c = self.last
        at_key = slot(key, 0)
        at_keys = slot(key, self.key + 1)
        at_after = slot(a, b)
        at_steps = slot(wrap(a - b, 64), wrap(b - c, 64))
        k, k2, off = self.of_key.get(at_key, (0, 0, 0))
        change = a - self.of_key.get(slot(self.key, 0), (0, 0, 0))[1]
        g, g2 = lagged or (a, a)
        p = a if geometry is None else geometry
        candidates = [
            a,
            a + a - b,
            a + self.of_keys[at_keys],
            k,
            k + k - k2,
            k + change,
            self.of_column.get(column, 0) if column else a,
            g,
            g + a - g2,
            self.after[at_after],
            a + self.after_steps[at_steps],
            p,
            a if geometry is None else p + off,
        ]
        candidates = [v if -(1 << 63) <= v < 1 << 63 else wrap(v, 64) for v in candidates]
        v = self.coded(bits, candidates, key, at_keys)
        self.learn(candidates, v)
        step = wrap(v - a, 64)
        self.after[at_after] = v
        self.after_steps[at_steps] = step
        self.of_keys[at_keys] = step
        self.of_column[column] = v
        self.of_key[at_key] = v, k, 0 if geometry is None else wrap(v - p, 64)
        self.last = [v, a, b]
        self.key = key
        return v

    def coded(self, bits, candidates, key, at_keys):
        scores = self.scores.tolist()
        left = list(range(CANDIDATES))
        for t in range(TRIES):
            if not left:
                break
            best = max(left, key=scores.__getitem__)
            expected = candidates[best]
            alike = [n for n in range(CANDIDATES) if candidates[n] == expected]
            left = [n for n in left if candidates[n] != expected]
            trust = 0.0
            for n in alike:
                trust = f32(trust + scores[n])
            places = (
                t | (self.history & 255) << 2,
                t | best << 2 | level(scores[best]) << 6 | (self.history & 7) << 11,
                (t | sum(1 << n for n in alike) << 2) & MASK,
                slot(key, t << 32 | 1 << 40),
                t | level(trust / 4) << 2 | (at_keys & 127) << 7,
            )
            if self.hits.code(bits, t, [place & MASK for place in places]):
                self.history = (self.history << 2 | min(t, 2) + 1) & 255
                return expected
        self.history = self.history << 2 & 255
        errors = self.errors.tolist()
        nearest = errors.index(min(errors))
        if self.is_long.code(bits):
            return wrap(bits.plain(64), 64)
        n = min(int(errors[nearest]), 63)
        if self.differences[n] is None:
            self.differences[n] = IntegerModel()
        return wrap(candidates[nearest] + unzigzag(self.differences[n].code(bits)), 64)

    def learn(self, candidates, v):
        scores, errors = self.scores, self.errors
        for n, c in enumerate(candidates):
            s = scores[n]
            scores[n] = s + f32(f32((1.0 if c == v else 0.0) - s) / 32)
        if self.history & 3 != 0:
            return
        for n, c in enumerate(candidates):
            distance = abs(wrap(c - v, 64)) if c != v else 0
            e = errors[n]
            errors[n] = e + f32(2 * distance.bit_length() - e) / 4


def decompressed(bits, kind, width, records):
    """8.17: records of values of one type by a general-purpose back-end."""
    backend, arrangement = bits.plain(8), bits.plain(8)
    if arrangement > 2:
        raise Refused("bytes in an unknown arrangement")
    payload = bytes(bits.plain(8) for _ in range(IntegerModel().code(bits)))
    data = unpacked(backend, payload, records * width)
    if arrangement == 0:
        return data
    out = bytearray(len(data))
    for k in range(width):
        out[k::width] = data[k * records : (k + 1) * records]
    if arrangement == 2:
        size = SIZES[kind]
        mask = (1 << 8 * size) - 1
        for at in range(width, len(out), size):
            before = int.from_bytes(out[at - width : at - width + size], "little")
            value = int.from_bytes(out[at : at + size], "little") + before & mask
            out[at : at + size] = value.to_bytes(size, "little")
    return bytes(out)
