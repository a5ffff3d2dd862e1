"""Section 8 of FORMAT.md, but for ranges and tokens: what the arithmetic coder codes."""

from array import array
from math import isfinite

from entropy import M64, adaptive, integers, unzigzag, AdaptiveBit, IntegerModel, wrap
from errors import Refused
from models import (
    BELIEF,
    STRETCH,
    ErrorShape,
    HashedCounters,
    LayeredMixer,
    LeastSquares,
    Levels,
    MixedBits,
    Network,
    clamp,
    f32,
    floats,
    hash_below,
    hash_of,
    ilog2,
    learnt,
    learnt_small,
    odds_of,
    new_counters,
    signed_level,
    squash,
)
from layout import F32
from scanner import MILLIMETRE, bits_of_float, float_of_bits, of_rank, rank
from values import Scale as RoughScale


class ByteModel:
    """8.1."""

    def __init__(self, most_slot_bits=14):
        self.slot_bits = 0
        self.row_slot_bits = 0
        self.most_slot_bits = most_slot_bits

    def code(self, bits, n, stride=1):
        if n == 0:
            return b""
        wanted = clamp(ilog2(n) + 2, 6, self.most_slot_bits)
        if wanted > self.slot_bits:
            self.slot_bits = wanted
            self.mixed = MixedBits([1 << (8 + wanted)] * 5, 256, 0.3, 0.0, 0.004)
        out = bytearray()
        shift = 64 - self.slot_bits
        code = self.mixed.code

        def back(d):
            return out[index - d] if index >= d else 0

        for index in range(n):
            place = index % stride + 1 if stride > 1 else 0
            b1, b2, b3, s1, s2 = back(1), back(2), back(3), back(stride), back(2 * stride)
            contexts = (
                place,
                place << 8 | s1,
                place << 16 | s1 << 8 | s2,
                place << 16 | b1 << 8 | (s1 if stride > 1 else b2),
                (b1 << 16 | b2 << 8 | b3) ^ (place << 24),
            )
            slots = [((c * 0x9E3779B97F4A7C15 & M64) >> shift) * 256 for c in contexts]
            node = 1
            for _ in range(8):
                node = node * 2 + code(bits, node, [s + node for s in slots])
            out.append(node - 256)
        return bytes(out)


class Occupancy:
    """8.3."""

    SURE = 2.5

    def __init__(self):
        self.mixed = MixedBits([1024, 2048, 4096, 1024], 320, 0.4, 0.0, 0.003)
        self.has_reference = False

    def code(self, bits, rows, columns, is_light, reference=None):
        if reference and not self.has_reference:
            self.has_reference = True
            self.first, self.second = new_counters(4096), new_counters(512)
            self.mixed.spread(64)
        outside = [1] * (columns + 8)
        # Rows with four more cells to the left and to the right.
        before = [outside, outside, outside]
        empty_above = [0] * columns
        image = []
        mixed = self.mixed
        if reference:
            same = reference.same.ranges
            none = [0] * (columns + 4)
            seen = [none] + [[0, 0] + [1 if s else 0 for s in row] + [0, 0] for row in same] + [none]
        for row in range(rows):
            n3, n2, n = before
            cells = outside[:]
            run = 0
            low_row = min(row, 127) * 16
            if reference:
                s_above, s_here, s_below = seen[row : row + 3]
            for column in range(columns):
                at = column + 4
                w0, w1, w2 = cells[at - 1], cells[at - 2], cells[at - 3]
                na, nb, nc, nd, ne, nf, ng = n[at - 2 : at + 5]
                near = w0 | nc << 1 | nb << 2 | nd << 3
                level = min(ilog2(min(run, 255)) + 1, 7) if run else 0
                up0, up1, up2 = n2[at], n2[at + 1], n2[at + 2]
                places = (
                    near | w1 << 4 | w2 << 5 | up0 << 6 | ne << 7 | na << 8 | up1 << 9,
                    low_row + near,
                    (level * 8 + (nc | nd << 1 | ne << 2)) * 64
                    + (nf | ng << 1 | up0 << 2 | up2 << 3 | w0 << 4 | n3[at] << 5),
                    (empty_above[column] >> 2) * 16 + near,
                )
                s = near | up0 << 4 | w1 << 5
                extra = ()
                if reference:
                    c = column + 2
                    here = s_here[c]
                    around = here | s_here[c - 1] << 1 | s_here[c + 1] << 2 | s_above[c] << 3 | s_below[c] << 4
                    wide = s_here[c - 2] | s_here[c + 2] << 1 | s_below[c + 1] << 2 | s_below[c - 1] << 3
                    extra = [
                        (self.first, around | (near | w1 << 4 | up0 << 5) << 5 | (wide & 1) << 11),
                        (self.second, around | wide << 5),
                    ]
                    s += 64 * (1 + (here | (1 if around in (0, 31) else 0) << 1))
                if is_light:
                    filled = mixed.code_or_sure(bits, s, places, self.SURE, extra)
                else:
                    filled = mixed.code(bits, s, places, 0.0, extra)
                cells[at] = filled
                empty_above[column] = empty_above[column] >> 1 | (0 if filled else 128)
                run = run + 1 if filled == w0 else 0
            image.append(cells[4:-4])
            before = [n2, n, cells]
        return image


# 8.5 Intensity


class Scale:
    def __init__(self, plain):
        self.per_unit = plain(16)
        self.bits = clamp(plain(4), 1, 9)
        self.exceptions = plain(1)
        if not self.per_unit:
            scale = plain(8)
            self.rough = RoughScale(scale if scale <= 64 else 0, F32)

    def without_grid(self, integer):
        """The bits of the value of an integer modulo 2^32 if there is no grid."""
        return self.rough.value(wrap(integer, 32))

    def value(self, level):
        """The bits of the value of a level."""
        return bits_of_float(f32(level / self.per_unit))

    def context_level(self, bits):
        if self.per_unit > 0:
            value = float_of_bits(bits)
            q = value * self.per_unit + 0.5
            if 0 <= q < 512 and self.value(int(q)) == bits:
                return self.of_level(int(q))
        return 1

    def of_level(self, level):
        return min(level >> max(self.bits - 7, 0), 127) + 1


def first_of(*values):
    """`or` of several: the first that is not 0, else the last."""
    for v in values:
        if v > 0:
            return v
    return values[-1]


class Near:
    """What is near a value; a plain record."""

    __slots__ = ("row", "column", "left", "nww", "nw", "n", "ne", "nee", "nnw", "nn", "nne", "s", "sl", "sr", "m", "back")


def values_of(image, strays, reference, begin, code):
    """Codes all values: `code(near, mean_at)` gives (bits of the value, context level).

    Returns the values of the returns by cell, those of the strays, and the context levels by cell."""
    rows = len(image)
    columns = len(image[0]) if rows else 0
    values = [[0] * columns for _ in range(rows)]
    none = [0] * (columns + 4)
    levels = [none, none]
    near = Near()
    begin(rows, columns, sum(map(sum, image)))
    for row in range(rows):
        own = none[:]
        n2, n = levels[-2:]
        left = [0, 0, 0, 0]
        cells = image[row]
        near.row = row
        if reference:
            same = reference.same.levels[row] + [0]
            moved = reference.moved.levels[row]
        begin_row = True
        for column in range(columns):
            if not cells[column]:
                continue
            near.column = column
            near.left = left
            near.nww, near.nw, near.n, near.ne, near.nee = n[column : column + 5]
            near.nnw, near.nn, near.nne = n2[column + 1 : column + 4]
            if reference:
                near.s, near.m = same[column], moved[column]
                near.sl, near.sr = same[column - 1] if column else 0, same[column + 1]
            else:
                near.s = near.m = near.sl = near.sr = 0
            near.back = reference
            value, level = code(near, begin_row)
            begin_row = False
            values[row][column] = value
            own[column + 2] = level
            left = [level] + left[:3]
        levels.append(own)
    of_strays = []
    stray_levels = []
    begin(max((row for row, _, _ in strays), default=0) + 1, 1, len(strays))
    near.back = None
    near.column = near.s = near.m = near.sl = near.sr = near.nee = near.nne = 0

    def before(index):
        return None if index is None or index < 0 else strays[index][1]

    def level_at(index):
        return stray_levels[index] if index is not None and 0 <= index < len(stray_levels) else 0

    for index, (near.row, west, _) in enumerate(strays):
        at = west
        near.left = []
        for _ in range(4):
            near.left.append(level_at(at))
            at = before(at)
        nw = before(index - 1)
        near.nww, near.nw, near.n = level_at(before(nw)), level_at(nw), level_at(index - 1)
        near.ne = 0 if west is None else level_at(west + 1)
        near.nn, near.nnw = level_at(index - 2), level_at(before(index - 2))
        value, level = code(near, index == 0)
        of_strays.append(value)
        stray_levels.append(level)
    return values, of_strays, [row[2:-2] for row in levels[2:]]


class OffGrid:
    def __init__(self):
        self.exception = AdaptiveBit()
        self.model = IntegerModel()
        self.last = 0

    def is_next(self, bits, scale):
        return scale.exceptions and self.exception.code(bits)

    def code(self, bits):
        self.last = self.last + unzigzag(self.model.code(bits)) & 0xFFFFFFFF
        return self.last


class LevelViews:
    """8.5: what levels of up to so many bits have taught."""

    def __init__(self, bits):
        self.bits = bits
        self.views = [new_counters(0), new_counters(0), new_counters(0)]
        self.slot_bits = 0
        self.row_slot_bits = 0
        self.weights = [floats([0.55, 0.55]) for _ in range(1 << bits)]
        self.reference_weights = [floats([0.45] * 3) for _ in range(1 << bits)]

    def grow(self, slot_bits, rows):
        stride = 1 << self.bits
        row_slot_bits = min(slot_bits, 7 + (max(rows, 1) - 1).bit_length())
        if not self.views[0]:
            self.slot_bits, self.row_slot_bits = slot_bits, row_slot_bits
            self.views = [new_counters(stride << n) for n in (slot_bits, row_slot_bits, slot_bits)]
            return
        if row_slot_bits > self.row_slot_bits:
            self.views[1] *= 1 << (row_slot_bits - self.row_slot_bits)
            self.row_slot_bits = row_slot_bits
        if slot_bits > self.slot_bits:
            copies = 1 << (slot_bits - self.slot_bits)
            for k in (0, 2):
                view = self.views[k]
                grown = new_counters(0)
                for start in range(0, len(view), stride):
                    grown.extend(view[start : start + stride] * copies)
                self.views[k] = grown
            self.slot_bits = slot_bits


class Intensity:
    """8.5 as `mixed` and `light` have it."""

    def __init__(self, off_grid):
        self.off_grid = off_grid
        self.levels = LevelViews(7)
        self.rate = f32(f32(0.02) / 65536)

    def code(self, bits, scale, image, strays, reference):
        def begin(rows, columns, n):
            self.start(scale.bits, rows, n)

        def value(near, _):
            if self.off_grid.is_next(bits, scale):
                v = self.off_grid.code(bits)
                return v, scale.context_level(v)
            level = self.level(bits, scale.bits, near)
            return scale.value(level), scale.of_level(level)

        return values_of(image, strays, reference, begin, value)

    def start(self, n, rows, values):
        if n > self.levels.bits:
            self.levels = LevelViews(n)
        self.levels.grow(clamp(ilog2(max(values, 1)), 6, 13), rows)

    def level(self, bits, n, near):
        levels = self.levels
        left = near.left
        west = first_of(left[0], near.n, near.nw, near.ne, 20)
        west2 = first_of(left[1], west)
        row = near.row
        contexts = [(west // 2) << 16 | (west2 // 2) << 8 | left[2] // 8]
        weights = levels.weights
        if near.s or near.m:
            contexts.append((near.s or near.m) << 8 | west // 4)
            weights = levels.reference_weights
        shift, root = 32 - levels.slot_bits, 1 << (levels.bits - n)
        places = [((c * 0x9E3779B1 & 0xFFFFFFFF) >> shift) << levels.bits for c in contexts]
        last = (1 << levels.row_slot_bits) - 1
        places.insert(1, (row * 128 + west - 1 & last) << levels.bits)
        views = levels.views
        if row and views[1][places[1] + root] & 1023 == 0:
            above = ((row - 1) * 128 + west - 1 & last) << levels.bits
            for node in range(1 << levels.bits):
                c = views[1][above + node]
                views[1][places[1] + node] = clamp(c >> 10, 4096, 4190208) << 10 | min(c & 1023, 4)
        node = root
        for _ in range(n):
            cells = [views[k][p + node] for k, p in enumerate(places)]
            o = array("f", [STRETCH[c >> 20] * BELIEF[c & 255] for c in cells])
            w = weights[node]
            odds = 0.0
            for x in array("f", [a * b for a, b in zip(w, o)]):
                odds = f32(odds + x)
            p = squash(odds)
            bit = bits.decode(p)
            pull = f32((65536 - p if bit else -p) * self.rate)
            for k, x in enumerate(array("f", [pull * x for x in o])):
                w[k] += x
                views[k][places[k] + node] = learnt(cells[k], bit)
            node = node * 2 + bit
        return node - (1 << levels.bits)


LEAST = 1 / (1 << 24)


def past_of(reference, row, column):
    """What the network of 8.5 is told of an earlier frame: levels, and differences of range."""
    same, moved = reference.same, reference.moved

    def at(table, o):
        return table[row][column + o] if 0 <= column + o < len(table[row]) else 0

    def farther(other):
        here = at(moved.ranges, 0)
        if not here or not other:
            return 0
        away = here - other
        return signed_level(abs(away) // 4 * (1 if away > 0 else -1))

    levels = [min(at(moved.levels, o), 127) for o in (-1, 1, 2, -2)] + [min(at(same.levels, o), 127) for o in (-1, 1, 2)]
    return levels + [farther(v) for v in (at(moved.ranges, -1), at(same.ranges, 0), at(moved.ranges, 1))]


class DeepIntensity:
    """8.5 as `deep` has it."""

    LEVELS = Levels(11, 0.7, 1.45)

    def __init__(self, off_grid):
        self.off_grid = off_grid
        self.fits = [LeastSquares(16, 0.998) for _ in range(8)]
        self.errors = floats([4.0] * 144)
        self.zero = MixedBits([1 << 16] * 8, 128, 0.2, 0.3, 0.002)
        self.network = Network([128] * 17 + [16384] * 4, 1, 33280, 0.03, 0.01, 0.01)
        self.b = 8
        self.hashed = [HashedCounters(8) for _ in range(8)]
        self.mixer = LayeredMixer([1024, 9216], [0.15] * 12, 0.0045, 0.0005, 18, [512, 144])

    def code(self, bits, scale, image, strays, reference):
        def begin(rows, columns, n):
            self.above = floats([4.0] * columns)
            b = clamp(1 + ilog2(max(n, 1)), 8, 17)
            if b > self.b:
                self.b = b
                self.hashed = [HashedCounters(b) for _ in range(8)]

        def value(near, begins_row):
            if begins_row:
                self.mean = 4.0
            if self.off_grid.is_next(bits, scale):
                v = self.off_grid.code(bits)
                return v, scale.context_level(v)
            level = self.level(bits, scale, near)
            return scale.value(level), scale.of_level(level)

        return values_of(image, strays, reference, begin, value)

    def level(self, bits, scale, near):
        left = near.left
        s, m, sl, sr = near.s, near.m, near.sl, near.sr
        back = 1 if s or m else 0
        if not back:
            sl = sr = 0
        n, ne, nw, nn, nee, nww, nnw, nne = near.n, near.ne, near.nw, near.nn, near.nee, near.nww, near.nnw, near.nne
        west = first_of(left[0], n, nw, ne, 20)
        west2 = first_of(left[1], west)
        west3 = first_of(left[2], west2)
        north = first_of(n, ne, nw, west)
        zeros = 0
        for k, v in enumerate((left[0], n, ne, nw, s, m, left[1], nn, left[2], nee, sr, sl)):
            zeros |= (v == 1) << k
        fit = self.fits[(1 if n > 0 else 0) + 2 * back + (4 if left[0] > 0 else 0)]
        s_was, m_was = s, m
        l0, l1, l2, l3, n, ne, nw, nn, nee, nww, nnw, nne, s, sl, sr, m = [
            0 if v == 1 else v for v in (*left, n, ne, nw, nn, nee, nww, nnw, nne, s, sl, sr, m)
        ]
        base = first_of(l0, n, nw, ne, l1, l2, nn, s, 20)
        a2 = l1 or base
        a3 = l2 or a2
        a4 = l3 or a3
        b = n or ne or nw or base
        bw, be, bb = nw or b, ne or b, nn or b
        c = s or m or base
        features = [a2, b, bw, be, bb, a3, a4, nee or be, nww or bw, nnw or bb, nne or bb]
        features = [v - base for v in features] + [4.0]
        if back:
            features += [v - base for v in (c, sl or c, sr or c, m or c)]
        else:
            features += [0.0] * 4
        features = floats(features)
        prediction = clamp(f32(base + fit.predict(features)), 0.0, f32(127.9))
        gradient = abs(base - b) + abs(base - a2) + abs(b - be)
        coarse = int(f32(prediction * 0.625))
        row, column = near.row, near.column
        r = min(row, 127)
        s, m = s_was, m_was
        contexts = (
            zeros,
            zeros & 0xFF | r << 8,
            zeros & 0x1F | coarse << 5 | r << 12,
            zeros & 0xF | west << 4 | r << 12,
            zeros & 3 | s << 2 | (west // 8) << 10,
            zeros & 3 | west << 2 | north << 10,
            zeros & 0xF | r << 4 | (column // 32) << 11,
            zeros & 0x33 | (s // 2) << 6 | (m // 2) << 13 | (coarse // 2) << 20,
        )
        places = [(x * 0x9E3779B1 & 0xFFFFFFFF) >> 16 for x in contexts]
        past = past_of(near.back, near.row, near.column) if back else [0] * 10
        lw, lw2, lw3, lw4, ln, ls, lm = (
            min(v, 127) for v in (west, west2, west3, first_of(left[3], west3), north, s, m)
        )
        network = self.network
        pairs = [lw * 128 + lw2, lw2 * 128 + lw3, lw * 128 + ls, r * 128 + lw]
        network.activate([lw, lw2, lw3, lw4, r, lm, *past, ln, *pairs], [1.0])
        gate = (1 + lw // 2) * 512
        other = network.odds((0, gate))
        zero = self.zero.code(bits, zeros % 64 + 64 * back, places, other)
        network.learn_bit((0, gate), other, zero)
        if zero:
            network.learn()
            return 0
        away = signed_level(int(f32(prediction - base)))
        contexts = (
            west // 2 | (west2 // 2) << 8,
            r | (west // 4) << 7 | (west2 // 4) << 15 | (west3 // 4) << 23,
            r | west << 7 | away << 15,
            west | west3 << 8,
            r // 32 | west << 2 | west2 << 10,
            r | (s // 2) << 7 | (m // 2) << 15,
            r // 2 | (west // 2) << 6 | (column // 64) << 14,
            r | (west // 4) << 7 | (column // 32) << 15,
        )
        hashes = [hash_of(v, x) for v, x in enumerate(contexts)]
        n_bits = scale.bits
        unit = 1 << max(n_bits - 7, 0)
        level_of = self.LEVELS.of
        uncertainty = 12 * level_of(f32(self.mean + f32(0.5 * self.above[column]))) + level_of(gradient)
        place_at = f32(f32(prediction - 0.5) * unit)
        placed = ErrorShape.place(place_at, f32(max(self.errors[uncertainty], f32(0.3)) * unit))
        low, high, low_p, high_p = 0, 1 << n_bits, 0.0, 1.0
        pair = min(max(west - 1, 0) // 4, 31) * 32 + min(max(north - 1, 0) // 4, 31)
        node = 1
        for i in range(n_bits - 1, -1, -1):
            if (n_bits - 1 - i) % 4 == 0:
                lines = [v.line(hash_below(h, node)) for v, h in zip(self.hashed, hashes)]
                place = 1
            middle = (low + high) // 2
            middle_p = ErrorShape.below(placed, middle)
            cells = [line[place] for line in lines]
            opinions = [STRETCH[x >> 4] * BELIEF[x & 15] for x in cells]
            upper, lower = [f32(max(f32(p), 0.0) + LEAST) for p in (high_p - middle_p, middle_p - low_p)]
            opinions.append(odds_of(upper, lower))
            outputs = (node, gate + node)
            odds = network.odds(outputs)
            opinions += [odds, 0.25, 0.0]
            bit = self.mixer.code(
                bits,
                (node + 512 * back, pair * 9 + i),
                2 * i + back,
                (node, uncertainty),
                array("f", opinions),
            )
            for line, x in zip(lines, cells):
                line[place] = learnt_small(x, bit)
            network.learn_bit(outputs, odds, bit)
            if bit:
                low, low_p = middle, middle_p
            else:
                high, high_p = middle, middle_p
            node = node * 2 + bit
            place = place * 2 + bit
        network.learn()
        level = node - (1 << n_bits)
        if level:
            own = scale.of_level(level)
            error = f32(own - prediction)
            fit.learn(features, float(own - base), f32(1 / f32(9 + f32(error * error))))
            a = abs(error)
            self.errors[uncertainty] += f32(f32(a - self.errors[uncertainty]) * f32(0.01))
            self.mean = f32(f32(f32(0.6) * self.mean) + f32(f32(0.4) * a))
            self.above[column] = f32(0.5 * self.above[column]) + f32(0.5 * a)
        return level


# 8.7 Correction


class Correction:
    def __init__(self):
        self.is_corrected = adaptive(8)
        self.recent = 0
        self.unclear = AdaptiveBit()
        self.any = adaptive(21)
        self.expected = adaptive(7)
        self.rest = integers(144)

    def corrections(self, bits, grid, formula):
        if grid.kind != MILLIMETRE:
            exponents = [_exponent(v) for v in formula]
            largest = max(exponents)
            found = []
            for axis in range(3):
                context = 2 * (axis * 24 + min(largest - exponents[axis], 23)) + any(found)
                found.append(unzigzag(self.rest[context].code(bits)))
            return found
        offsets = []
        for v in formula:
            units = v * 1000
            offsets.append(units - round(units) if isfinite(units) else float("nan"))
        distances = [0.5 - abs(o) for o in offsets]
        if all(d >= 0.05 for d in distances) and not self.unclear.code(bits):
            return [0, 0, 0]
        found = []
        for axis in range(3):
            level = sum(t <= distances[axis] for t in (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016))
            if not self.any[level * 3 + axis].code(bits):
                found.append(0)
            elif self.expected[level].code(bits):
                found.append(-1 if offsets[axis] < 0 else 1)
            else:
                found.append(unzigzag(self.rest[axis * 48].code(bits)))
        return found

    def code(self, bits, grid, positions, formulas):
        found = []
        for formula in formulas:
            if positions or grid.kind != MILLIMETRE:
                is_corrected = self.is_corrected[self.recent].code(bits)
                self.recent = (self.recent << 1 | is_corrected) % 8
                if not is_corrected:
                    found.append(uncorrected(grid, positions, formula))
                    continue
            found.append(corrected(grid, formula, self.corrections(bits, grid, formula)))
        return found


def rounded(formula):
    return tuple(bits_of_float(f32(v)) for v in formula)


def uncorrected(grid, positions, formula):
    if positions == 2:
        return rounded(formula)
    return tuple(grid.value(grid.unit_of(v), v) for v in formula)


def corrected(grid, formula, corrections):
    return tuple(grid.value(wrap(grid.unit_of(v) + c, 64), v) for v, c in zip(formula, corrections))


def _exponent(v):
    import struct

    return struct.unpack("<Q", struct.pack("<d", v))[0] >> 52 & 0x7FF


# 8.19 Blanks


class Blanks:
    def __init__(self):
        self.same_kind = adaptive(4)
        self.other_kind = [adaptive(2) for _ in range(4)]
        self.differences = integers(3)

    def code(self, bits, formulas):
        """Positions, as the bits of float32s, like the formula's."""
        found = []
        kind = last = 0
        kept = [(0, 0, 0), (0, 0, 0)]
        for formula in formulas:
            if not self.same_kind[kind].code(bits):
                first, second, third = [other for other in range(4) if other != kind]
                if self.other_kind[kind][0].code(bits):
                    kind = first
                else:
                    kind = second if self.other_kind[kind][1].code(bits) else third
            if kind == 0:
                found.append(formula)
                continue
            if kind == 3:
                position = tuple(
                    of_rank(rank(v) + unzigzag(model.code(bits)))
                    for v, model in zip(kept[last], self.differences)
                )
                last = 1 - last
                kept[last] = position
            else:
                last = kind - 1
            found.append(kept[last])
        return found


# 8.20 Echoes


class Echoes:
    def __init__(self):
        self.exists = adaptive(8)
        self.same_range, self.by_last, self.same_intensity = adaptive(2), adaptive(2), adaptive(2)
        self.is_whole = adaptive(1)[0]
        self.ranges = integers(2)
        self.intensities = integers(1)[0]

    def code(self, bits, missing, image, steps, values):
        """For each cell with echoes, its row and column: their ranges and the bits of their intensities.

        `values` are those of the first returns, none if intensities are not coded.
        """
        found, known = {}, 0
        was_same = was_last = 0
        above = [0] * (len(image[0]) if image else 0)
        for row, cells in enumerate(image):
            left, last = 0, None
            for column in (n for n, filled in enumerate(cells) if filled):
                own = []
                first = steps[row][column]
                while known < missing and self.exists[left + 2 * above[column] + 4 * bool(own)].code(bits):
                    was_same = self.same_range[was_same].code(bits)
                    if was_same:
                        range_ = first
                    else:
                        if last is not None:
                            was_last = self.by_last[was_last].code(bits)
                        by = int(last is not None and was_last)
                        range_ = (last if by else first) + unzigzag(self.ranges[by].code(bits))
                        if not 1 <= range_ < 1 << 24:
                            raise Refused("an echo out of range")
                    last = range_
                    value = 0
                    if values is not None:
                        value = self.intensity(bits, was_same, values[row][column])
                    own.append((range_, value))
                    known += 1
                left = above[column] = int(bool(own))
                if own:
                    found[row, column] = own
        if known != missing:
            raise Refused("the range image does not hold as many points as it should")
        return found

    def intensity(self, bits, was_same, first):
        if self.same_intensity[was_same].code(bits):
            return first
        number = float_of_bits(first)
        is_whole = isfinite(number) and abs(number) < 1 << 24 and number == int(number) and first != 1 << 31
        if is_whole and self.is_whole.code(bits):
            return bits_of_float(float(int(number) + unzigzag(self.intensities.code(bits))))
        return bits.plain(32)


# 8.8 Order


class Order:
    def __init__(self):
        self.counts, self.stray_gaps, self.move_gaps = integers(3)

    def code(self, bits, records, strays):
        inside = records - strays
        stray_places = self.rising(bits, self.stray_gaps, strays, records)
        n = self.counts.code(bits)
        if n > inside:
            raise Refused("more moved elements than the image has")
        moved = self.rising(bits, self.move_gaps, n, inside)
        width = inside.bit_length()
        return stray_places, moved, [bits.plain(width) for _ in range(n)]

    @staticmethod
    def rising(bits, model, n, end):
        if n == end:
            return list(range(end))
        found = []
        following = 0
        for _ in range(n):
            found.append(following + model.code(bits))
            following = found[-1] + 1
        return found


def placed(n, fixed, others):
    """n places: the fixed ones, a pair of place and element each, and the others in the free ones."""
    places = [None] * n
    for place, element in fixed:
        if place >= n or places[place] is not None:
            raise Refused("a place that is taken, or lies outside")
        places[place] = element
    others = iter(others)
    for place in range(n):
        if places[place] is None:
            places[place] = next(others, None)
            if places[place] is None:
                raise Refused("a place is left free")
    if next(others, None) is not None:
        raise Refused("an element is left over")
    return places
