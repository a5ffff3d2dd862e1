"""Section 8.16 of FORMAT.md: sections as tokens."""

from entropy import TokenModel, Tokens, frequencies_of, numbers, unzigzag
from models import LeastSquares, Residuals, clamp, f32, floats, ilog2
from ranges import Bins, change
from sections import Scale, corrected, uncorrected


def kind(c):
    n = c.bit_count()
    return 0 if n == 8 else 1 if n == 0 else 2 if n >= 4 else 3


class Occupancy:
    def __init__(self):
        self.model = TokenModel(16)

    def code(self, reader, rows, columns):
        tokens = Tokens(self.model, reader)
        groups = (columns + 7) // 8
        above = [255] * groups
        image = []
        for _ in range(rows):
            before = 255
            own = []
            for k in range(groups):
                before = tokens.token(kind(above[k]) * 4 + kind(before)) ^ above[k]
                own.append(before)
            above = own
            image.append([own[c >> 3] >> (c & 7) & 1 for c in range(columns)])
        tokens.finish()
        return image


class Intensity:
    def __init__(self):
        self.model = TokenModel(146)

    def code(self, reader, image, strays):
        tokens = Tokens(self.model, reader)
        scale = Scale(tokens.bits)
        low = max(scale.bits - 8, 0)
        last = d = 0

        def value(west, north):
            nonlocal last, d
            if scale.per_unit == 0 or scale.exceptions and tokens.token(128) == 1:
                d = tokens.number(129 if scale.per_unit else 130 + min(ilog2(max(d, 1)), 15))
                last = last + unzigzag(d) & 0xFFFFFFFF
                v = last if scale.per_unit else scale.without_grid(last)
                return v, scale.context_level(v)
            w = west if west > 0 else north
            agree = 1 if north > 0 and abs(w - north) < 4 else 0
            level = tokens.token(min(w // 2, 63) * 2 + agree) << low
            level |= tokens.bits(low)
            return scale.value(level), scale.of_level(level)

        columns = len(image[0]) if image else 0
        north = [0] * columns
        values, levels = [], []
        for cells in image:
            own, of_own = [0] * columns, [0] * columns
            west = 0
            for c in range(columns):
                if cells[c]:
                    own[c], west = value(west, north[c])
                    north[c] = of_own[c] = west
            values.append(own)
            levels.append(of_own)
        of_strays, stray_levels = [], []
        for _, before, _ in strays:
            v, level = value(0 if before is None else stray_levels[before], stray_levels[-1] if stray_levels else 0)
            of_strays.append(v)
            stray_levels.append(level)
        tokens.finish()
        return values, of_strays, levels


def level(m, most):
    m += 4
    o = ilog2(m)
    return min((o - 2) * 4 + (m >> (o - 2)) % 4, most - 1)


def start_of(w):
    """The frequencies of tokens that a table of ranges starts with."""

    def weight(k):
        return 1 / (1 + (k / w) * (k / w))

    weights = []
    for t in range(255):
        if t < 32:
            weights.append(weight((t + 1) // 2))
            continue
        octave = min(5 + ((t - 32) >> 2), 59)
        base = (4 | (t - 32) & 3) << (octave - 2)
        if base >= 1 << 18:
            weights.append(0.0)
            continue
        n = 1 << (octave - 2)
        total = 0.0
        for i in range(4):
            total += weight((base + n * (2 * i + 1) // 8) / 2.0)
        weights.append(n / 4 * total)
    total = 0.0
    for v in weights:
        total += v
    return [int(4096 * v / total) for v in weights] + [0]


class Range:
    """Of `tokens`, `fitted tokens` and `light`."""

    def __init__(self, is_fitted):
        self.is_fitted = is_fitted
        self.model = TokenModel(96)
        self.fits = [LeastSquares(8, 0.998) for _ in range(4)]
        self.fits_before = [LeastSquares(16, 0.998) for _ in range(4)]
        self.residuals = Residuals()
        self.noise = floats([1.0] * 64)
        for c in range(96 if is_fitted else 40):
            if is_fitted:
                e = 5.657
                for _ in range(c // 6):
                    e *= 1.587401
                starts = start_of(1.5 + e / 48)
            else:
                m = ((4 + c % 4) << (c // 4)) - 4
                starts = start_of(2 + m / 9)
            self.model.tables[c] = numbers(frequencies_of(starts))
            self.model.counts[c] = [s // 32 for s in starts]

    def code(self, reader, image, levels, parameters, reference):
        tokens = Tokens(self.model, reader)
        columns = len(image[0])
        width = parameters.bin
        end = 1 << parameters.range_bits
        ranges = [3000] * (columns + 2)
        ranges2 = [3000] * columns
        misses = [20] * (columns + 1)
        residuals = self.residuals
        residuals.start_frame(columns)
        found = []
        expected = None
        if reference:
            none = [0] * (columns + 4)
            expected = [none]
            for moved, same in zip(reference.moved.ranges, reference.same.ranges):
                expected.append([0, 0] + [m or s for m, s in zip(moved, same)] + [0, 0])
            expected.append(none)
        is_fitted = self.is_fitted
        for row, cells in enumerate(image):
            own = [0] * columns
            miss_left = 320
            north_west = ranges[0]
            west = None
            residuals.start_row()
            for c in range(columns):
                if not cells[c]:
                    continue
                north, north_east, north_east2 = ranges[c : c + 3]
                north2 = ranges2[c]
                if west is None:
                    west = west2 = west3 = west4 = north
                activity = abs(west - west2) + abs(north - north_west) + abs(north - north_east)
                awaited = miss_left + 8 * misses[c]
                start = west
                if is_fitted:
                    awaited = miss_left + 8 * ((3 * misses[c] + 2 * misses[c + 1]) // 5)
                    deltas = [
                        clamp(v - west, -300, 300)
                        for v in (west2, west3, west4, north, north_west, north_east, north_east2, north2)
                    ]
                    edge = (1 if abs(west2 - west) > 60 else 0) + (2 if abs(deltas[3] - deltas[4]) > 60 else 0)
                    fits = self.fits[edge]
                    if expected:
                        here = expected[row + 1]
                        k = c + 2
                        if here[k] > 0 and here[k - 1] > 0 and abs(here[k - 1] - west) <= 60:
                            start = here[k]
                            up, down = expected[row], expected[row + 2]
                            deltas = [
                                clamp((v or start) - start, -300, 300)
                                for v in (
                                    west, west2, north, north_west, north_east, north2, west3, west4, north_east2,
                                    up[k + 1], here[k - 1], here[k - 2], up[k], here[k + 1], down[k], down[k + 1],
                                )
                            ]  # fmt: skip
                            fits = self.fits_before[edge]
                    features = floats(deltas)
                    fit = clamp(fits.predict(features), -400.0, 400.0)
                    i, iw = levels[row][c], levels[row][c - 1] if c > 0 else 0
                    n = min(ilog2(max(i, 1)), 7) * 8 + change(i, iw)
                    hint = residuals.hint(c, i, iw)
                    e = min(int(f32(f32(awaited) * self.noise[n])) // width, 1 << 15)
                    l = min(ilog2(max(e * e * e * 181 >> 15, 1)) // 2, 15)
                    context = l * 6 + min(ilog2(1 + activity // width) // 2, 5)
                else:
                    fit = hint = 0.0
                    context = level(((awaited + 5 * min(activity, 1200)) // width) >> 3, 40)
                base = clamp(start + int(f32(clamp(f32(fit + hint), -400.0, 400.0) + 1000.5)) - 1000, 1, end - 2)
                miss = clamp(unzigzag(tokens.number(context)), -(1 << 25), 1 << 25)
                if width == 1:
                    value = clamp(base + miss, 1, end - 1)
                else:
                    bins = Bins(base, width, parameters.range_bits)
                    value = bins.middle(bins.central + miss)
                if is_fitted:
                    residual = f32(value - start - fit)
                    target = float(clamp(value - start, -400, 400))
                    fits.learn(features, target, f32(1 / f32(25 + f32(residual * residual))))
                    ranges2[c] = north
                miss = min(abs(value - base), 300)
                if is_fitted:
                    ratio = min(f32(f32(24 * miss) / f32(awaited + 8)), 4.0)
                    self.noise[n] += f32(f32(ratio - self.noise[n]) * f32(0.01))
                    residuals.learn(c, residual)
                miss_left = (5 * miss_left + 48 * miss) >> 3
                misses[c] = (misses[c] + miss) >> 1
                north_west = north
                ranges[c] = own[c] = value
                west4, west3, west2, west = west3, west2, west, value
            found.append(own)
        tokens.finish()
        return found


class Correction:
    def __init__(self):
        self.model = TokenModel(4)

    def code(self, reader, grid, positions, formulas):
        tokens = Tokens(self.model, reader)
        how = 2 if positions == 2 else 3
        found = [uncorrected(grid, how, formula) for formula in formulas]
        at = tokens.number(0)
        while at < len(found):
            corrections = [unzigzag(tokens.number(1 + axis)) for axis in range(3)]
            found[at] = corrected(grid, formulas[at], corrections)
            at += 1 + tokens.number(0)
        tokens.finish()
        return found


def packed(tokens, n, start):
    """n packed values, as the differences, each with the value before it."""
    width = 0
    left = n
    before = start
    while left:
        width = min(tokens.token(width), 32)
        for _ in range(min(left, 8)):
            m = tokens.bits(width)
            d = (m >> 1) ^ -(m & 1)
            before = yield d, before
        left -= min(left, 8)


class PackedRange:
    def __init__(self):
        self.model = TokenModel(33)

    def code(self, reader, image, levels, parameters, reference):
        tokens = Tokens(self.model, reader)
        width, range_bits = parameters.bin, parameters.range_bits
        found = []
        values = packed(tokens, sum(map(sum, image)), 3000)
        value = None
        for cells in image:
            own = []
            for filled in cells:
                if not filled:
                    own.append(0)
                    continue
                d, before = values.send(value)
                if width == 1:
                    value = clamp(before + d & 0xFFFFFFFF, 1, (1 << range_bits) - 1)
                else:
                    bins = Bins(before, width, range_bits)
                    value = bins.middle(bins.central + d)
                own.append(value)
            found.append(own)
        tokens.finish()
        return found


class PackedIntensity:
    def __init__(self):
        self.model = TokenModel(39)

    def code(self, reader, image, strays):
        tokens = Tokens(self.model, reader)
        scale = Scale(tokens.bits)
        n = sum(map(sum, image)) + len(strays)
        found = []
        if not scale.per_unit:
            values = packed(tokens, n, 0)
            value = None
            for _ in range(n):
                d, before = values.send(value)
                value = before + d & 0xFFFFFFFF
                found.append(scale.without_grid(value))
        else:
            width = least = 0
            while len(found) < n:
                width = min(tokens.token(width), 9)
                least = least + unzigzag(tokens.number(34 + width // 2)) & 0xFFFFFFFF
                block = range(min(n - len(found), 8))
                found.extend([least + tokens.bits(width) & 0xFFFFFFFF for _ in block])
            found = [scale.value(v) if v < 1 << scale.bits else 0 for v in found]
            if scale.exceptions:
                at, last = tokens.number(33), 0
                while at < n:
                    if not tokens.bits(1):
                        last = tokens.bits(32)
                    found[at] = last
                    at += 1 + tokens.number(33)
        tokens.finish()
        found = iter(found)
        return [[next(found) if filled else 0 for filled in cells] for cells in image], list(found), []
