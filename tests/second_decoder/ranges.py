"""Section 8.6 of FORMAT.md: ranges by the arithmetic coder, as `mixed` and `deep` have them."""

from struct import pack, unpack

from models import (
    ErrorShape,
    LayeredBits,
    LeastSquares,
    Levels,
    MixedBits,
    Network,
    Residuals,
    clamp,
    dot_from,
    f32,
    floats,
    ilog2,
    new_counters,
    odds_of,
    signed_level,
    squash,
)
from sections import first_of

EVEN = 1 / 256
LEAST = 1 / (1 << 26)
TINY = f32(1e-9)
RATES = f32(0.02), f32(0.03)
ALWAYS = f32(0.1)
LEAST_WEIGHT = f32(0.001)
EARLY = f32(0.3)


def start_scales(n, e):
    s = 3.0
    for _ in range(e - 2):
        s = f32(s * f32(1.6))
    scales = floats([s] * n)
    scales[4] = 500.0
    return scales


class Bins:
    """Ranges in bins of W steps around a base."""

    def __init__(self, base, width, range_bits):
        self.width = width
        self.end = 1 << range_bits
        self.origin = (base - width // 2) % width
        self.central = (base - width // 2) // width

    def bin(self, r):
        return (r - self.origin) // self.width

    def start(self, i):
        return clamp(self.origin + i * self.width, 1, self.end)

    def middle(self, i):
        return clamp(self.origin + i * self.width + self.width // 2, 1, self.end - 1)


class Scales:
    """The scales of predictors in contexts; 4 is the one for surprises."""

    def __init__(self, contexts, n):
        self.n = n
        self.scales = [None] * contexts

    def of(self, context):
        if self.scales[context] is None:
            self.scales[context] = start_scales(self.n, context % 12)
        return self.scales[context]

    def learn(self, context, rate, range_, predictions, resp):
        scales = self.of(context)
        for k, (prediction, r) in enumerate(zip(predictions, resp)):
            error = abs(f32(range_ - prediction))
            most, least, always = (4000.0, 100.0, 0.0) if k == 4 else (400.0, 1.5, ALWAYS)
            by = f32(f32(rate * f32(r + always)) * f32(min(error, most) - scales[k]))
            scales[k] = max(f32(scales[k] + by), least)


class Weights:
    """A set of weights of predictors in contexts."""

    def __init__(self, contexts, n):
        self.n = n
        self.weights = [None] * contexts
        self.counts = [0] * contexts

    def of(self, context):
        if self.weights[context] is None:
            self.weights[context] = floats([f32(1 / self.n)] * self.n)
        return self.weights[context]

    def early(self, context):
        return f32(EARLY / f32(self.counts[context] + 1.5))

    def learn(self, context, rate, likelihood):
        """Returns how responsible each predictor is."""
        self.counts[context] = min(self.counts[context] + 1, 1000)
        w = self.of(context)
        most = f32(1 / dot_from(TINY, w, likelihood))
        kept = f32(1 - rate)
        resp = []
        for k, p in enumerate(likelihood):
            merit = f32(f32(p + TINY) * most)
            w[k] = max(f32(w[k] * f32(kept + f32(rate * merit))), LEAST_WEIGHT)
            resp.append(min(f32(w[k] * merit), 1.0))
        even_out = f32(1 / dot_from(0.0, w, [1.0] * self.n))
        for k, x in enumerate(w):
            w[k] = x * even_out
        return resp


def likelihood_of(low, high):
    return floats([max(f32(h - l), 0.0) for l, h in zip(low, high)])


def first_bucket(scale):
    n = int(f32(scale * f32(0.84853)))
    return 1 << ilog2(n) if n else 1


def octaves(v):
    return int(v).bit_length()


def change(own, other):
    if other == 0:
        return 7
    s = abs(own - other)
    k = 0 if s < 2 else 1 if s < 6 else 2 if s < 16 else 3
    return k + 3 if own < other and k > 0 else k


def pair(a, b):
    return signed_level(a) * 32 + signed_level(b)


class Coding:
    """The halvings of one range."""

    def __init__(self, bits, bins, range_bits, placed, sets):
        """`placed`: the predictors; `sets`: the sets of their weights."""
        self.bits = bits
        self.bins = bins
        self.even = EVEN / (1 << range_bits)
        self.placed = placed
        self.sets = sets
        self.low = bins.bin(1)
        self.high = bins.bin((1 << range_bits) - 1) + 1
        self.at_low = [0.0] * len(placed), [0.0] * len(sets)
        self.at_high = [1.0] * len(placed), [1 + EVEN] * len(sets)

    def below(self, i):
        bins = self.bins
        value = bins.origin + i * bins.width
        value = 1 if value < 1 else bins.end if value > bins.end else value
        each = floats([ErrorShape.below(placed, value) for placed in self.placed])
        return each, [dot_from(self.even * value, weights, each) for weights in self.sets]

    def odds(self, at):
        return [
            odds_of(max(f32(h - a), LEAST), max(f32(a - l), LEAST))
            for l, a, h in zip(self.at_low[1], at[1], self.at_high[1])
        ]

    def run(self, code, fine, corrected):
        """`code(odds, node)`: a bit, and the odds that it had if nothing corrects them."""
        last = [0.0]

        def halve(middle, node):
            at = self.below(middle)
            bit, last[0] = code(self.odds(at), node)
            if bit:
                self.low = middle
                self.at_low = at
            else:
                self.high = middle
                self.at_high = at
            return bit

        edge = self.bins.central
        up = halve(edge, 0)
        width = fine
        bucket = 0
        while True:
            following = edge + width if up else edge - width
            if following <= self.low or following >= self.high:
                break
            if halve(following, 1 + min(bucket, 14) * 2 + up) != up:
                break
            edge = following
            if bucket > 0:
                width *= 2
            bucket += 1
        halving = 0
        while self.high - self.low > 1:
            middle = (self.low + self.high) // 2
            if halving >= corrected and self.high - self.low <= fine:
                last[0] = f32(0.5 * last[0])
                if self.bits.decode(squash(last[0])):
                    self.low = middle
                else:
                    self.high = middle
            else:
                node = 32 + halving * 8 + min(bucket, 3) * 2 + up if halving < corrected else None
                halve(middle, node)
                halving += 1
        return self.bins.middle(self.low)


class RangeModel:
    """What `mixed` and `deep` share."""

    ERROR_LEVELS = Levels(11, 1.6, 1.6)

    def __init__(self):
        self.has_reference = False
        self.residuals = Residuals()

    def code(self, bits, image, levels, parameters, reference):
        """Ranges by cell."""
        rows = len(image)
        columns = len(image[0])
        self.bits = bits
        self.range_bits = parameters.range_bits
        self.bin = parameters.bin
        self.reference = reference
        if reference and not self.has_reference:
            self.has_reference = True
            self.first_reference()
        self.above = floats([0.0] * columns)
        self.signed_above = floats([0.0] * (columns + 1))
        self.reference_above = floats([0.0] * columns)
        self.starts_frame(columns)
        self.residuals.start_frame(columns)
        none = [0] * (columns + 4)
        done = [none, none]
        no_levels = [0] * (columns + 1)
        for row in range(rows):
            n2, n = done[-2:]
            own = none[:]
            self.mean = 20.0
            self.error_west = 0.0
            self.reference_mean = 20.0
            self.residuals.start_row()
            self.row = row
            left = [0] * 5
            own_levels = levels[row] + [0] if levels else no_levels
            self.row_levels = own_levels
            above_levels = levels[row - 1] if levels and row else no_levels
            for column in range(columns):
                if not image[row][column]:
                    continue
                self.column = column
                self.own = own_levels[column]
                self.iw = own_levels[column - 1] if column else 0
                self.in_ = above_levels[column]
                self.s = self.m = 0
                if reference:
                    self.s = reference.same.ranges[row][column]
                    self.m = reference.moved.ranges[row][column]
                value = self.value(left, n, n2)
                own[column + 2] = value
                left = [value] + left[:4]
            done.append(own)
        return [row[2:-2] for row in done[2:]]

    def around(self, left, n, n2):
        c = self.column
        nw, nn = n[c + 1], n2[c + 2]
        no, ne, nee = n[c + 2], n[c + 3], 0
        nee = n[c + 4] if c + 4 < len(n) else 0
        west = first_of(left[0], no, nw, ne, 3000)
        west2 = left[1] or west
        west3 = left[2] or west2
        west4 = left[3] or west3
        north = no or ne or nw or west
        north_west = nw or north
        north_east = ne or north
        north_east2 = nee or north_east
        north2 = nn or north
        self.west, self.west2, self.north = west, west2, north
        self.neighbours = (west2, west3, west4, north, north_west, north_east, north_east2, north2)
        self.eight = [clamp(float(v - west), -300.0, 300.0) for v in self.neighbours]
        self.edge = (1 if abs(self.eight[0]) > 60 else 0) + (2 if abs(self.eight[3] - self.eight[4]) > 60 else 0)
        activity = abs(west - west2) + abs(north - north_west) + abs(north - north_east)
        activity_level = min(octaves(activity), 11)
        self.error_level = self.ERROR_LEVELS.of(f32(self.mean + f32(0.5 * self.above[c])))
        self.context = activity_level * 12 + self.error_level
        if self.s or self.m:
            self.same = self.s or self.m
            self.moved = self.m or self.s
            same_row = self.reference.same.ranges[self.row]
            self.sw = same_row[c - 1] if c else 0
            self.se = same_row[c + 1] if c + 1 < len(same_row) else 0
            v = f32(0.5 * f32(self.reference_mean + f32(0.5 * self.reference_above[c])))
            self.level = min(octaves(v), 6)
            self.four = [
                clamp(float(v - west), -300.0, 300.0)
                for v in (self.same, self.sw or self.same, self.se or self.same, self.moved)
            ]

    def views(self, base):
        coarse = self.error_level * 8 // 12
        changes = change(self.own, self.iw) * 8 + change(self.own, self.in_)
        return [
            pair(self.west - base, self.north - base),
            pair(self.error_west, self.signed_above[self.column]),
            min(self.own, 127) * 8 + coarse,
            (changes * 4 + min(self.own // 8, 3)) * 8 + coarse,
        ]

    def base_of(self, fit):
        return clamp(int(self.west + fit + 0.5), 1, (1 << self.range_bits) - 2)

    def learnt(self, value, base, fit):
        c = self.column
        m = f32(min(abs(value - self.west - fit), 300.0))
        self.mean = f32(f32(f32(0.6) * self.mean) + f32(f32(0.4) * m))
        self.above[c] = f32(0.5 * self.above[c]) + f32(0.5 * m) if self.row else m
        self.error_west = value - base
        self.signed_above[c] = value - base
        if self.s or self.m:
            e = f32(min(abs(value - self.same), abs(value - self.moved), 300))
            self.reference_mean = f32(f32(f32(0.6) * self.reference_mean) + f32(f32(0.4) * e))
            self.reference_above[c] = f32(0.5 * self.reference_above[c]) + f32(0.5 * e)

    def learn_fit(self, fits, features, value, fit):
        error = value - self.west - fit
        target = clamp(float(value - self.west), -400.0, 400.0)
        fits.learn(features, target, f32(1 / (25 + error * error)))


def predicted(fits, features):
    return clamp(fits.predict(features), -400.0, 400.0)


class Mixed(RangeModel):
    def __init__(self):
        super().__init__()
        self.fits = [LeastSquares(8, 0.998) for _ in range(4)]
        self.scales, self.weights = Scales(144, 5), Weights(144, 5)
        self.mixed = MixedBits([65536, 65536, 65536, 131072], 6144, 0.0, 1.0, 0.004)

    def starts_frame(self, columns):
        pass

    def first_reference(self):
        self.reference_fits = [fits.widened(12) for fits in self.fits]
        self.reference_scales, self.reference_weights = Scales(1008, 7), Weights(1008, 7)
        share, new = f32(5 / 7), f32(1 / 7)
        for c in range(1008):
            self.reference_weights.weights[c] = floats([f32(w * share) for w in self.weights.of(c % 144)] + [new] * 2)
            scales = self.scales.of(c % 144)
            self.reference_scales.scales[c] = floats(scales.tolist() + [scales[3]] * 2)
        self.first, self.second = new_counters(65536), new_counters(65536)
        self.mixed.spread(768)

    def value(self, left, n, n2):
        self.around(left, n, n2)
        seen = self.s or self.m
        west, north = self.west, self.north
        features = floats(self.eight + self.four if seen else self.eight)
        fits = (self.reference_fits if seen else self.fits)[self.edge]
        linear = predicted(fits, features)
        fit = clamp(linear + self.residuals.hint(self.column, self.own, self.iw), -400.0, 400.0)
        base = self.base_of(fit)
        predictions = [float(west), float(north), float(2 * west - self.west2), f32(west + fit), float(west)]
        scales, weights, context, sets = self.scales, self.weights, self.context, self.error_level
        extra_places = ()
        if seen:
            predictions += [float(self.same), float(self.moved)]
            scales, weights = self.reference_scales, self.reference_weights
            context += self.level * 144
            sets += (1 + self.level) * 768
            extra_places = (
                (signed_level(self.same - base) * 32 + self.level * 4 + self.error_level // 3) * 64,
                pair(self.same - base, self.moved - base) * 64,
            )
        placed = [ErrorShape.place(f32(p + 0.5), s) for p, s in zip(predictions, scales.of(context))]
        views = [v * 64 for v in self.views(base)]
        bits = self.bits
        mixed = self.mixed
        arrays = (self.first, self.second) if seen else ()

        def code(odds, node):
            odds = odds[0]
            if node is None:
                return bits.decode(squash(odds)), odds
            extra = [(a, p + node) for a, p in zip(arrays, extra_places)]
            return mixed.code(bits, sets + node * 12, [v + node for v in views], odds, extra), odds

        bins = Bins(base, self.bin, self.range_bits)
        coding = Coding(bits, bins, self.range_bits, placed, [weights.of(context)])
        value = coding.run(code, first_bucket(f32(scales.of(context)[3] / self.bin)), 1)
        resp = weights.learn(context, RATES[0], likelihood_of(coding.at_low[0], coding.at_high[0]))
        scales.learn(context, RATES[0], value, predictions, resp)
        self.learn_fit(fits, features, value, linear)
        self.residuals.learn(self.column, f32(value - self.west - linear))
        self.learnt(value, base, fit)
        return value


class Deep(RangeModel):
    def __init__(self):
        super().__init__()
        self.wide = [LeastSquares(28, 0.998) for _ in range(8)]
        self.recent = [LeastSquares(8, 0.97, 8) for _ in range(4)]
        self.local = []
        self.blend = [LeastSquares(12, 0.998, 8) for _ in range(12)]
        self.scales = Scales(6240, 8)
        self.sets = [Weights(n, 8) for n in (1152, 3072, 6240)]
        self.layered = LayeredBits(
            4, [64 * n for n in (1024, 1024, 2048, 1024, 1024)], [6144, 4096, 4160], 64, [768, 4096]
        )
        sizes = [128, 128, 128, 128, 64, 128, 144, 16384, 16384, 16384]
        self.network = Network(sizes, 40, 10304, 0.025, 0.005, 0.003)
        self.weak = [f32(40 / (i + 2)) for i in range(129)]

    def starts_frame(self, columns):
        while len(self.local) * 64 < columns:
            self.local.append(LeastSquares(12, 0.97, 8))

    def first_reference(self):
        self.wide[4:] = [fits.copy() for fits in self.wide[:4]]
        for weights, n in ((self.sets[0], 144), (self.sets[2], 12)):
            for c in range(n, len(weights.weights)):
                weights.weights[c] = weights.of(c % n)[:]
                weights.counts[c] = weights.counts[c % n]
        for c in range(12, 6240):
            self.scales.scales[c] = self.scales.of(c % 12)[:]
        self.layered.mixer.spread(0, 768)
        self.layered.mixer.spread(2, 64)

    def value(self, left, n, n2):
        self.around(left, n, n2)
        seen = bool(self.s or self.m)
        c, row = self.column, self.row
        west, north = self.west, self.north

        def f(v):
            return clamp(float(v - west), -300.0, 300.0)

        west2, west3, west4, _, north_west, _, _, north2 = self.neighbours
        far = [f(left[4] or west4), f(n[c] or north_west), f(n2[c + 1] or north2), f(n2[c + 3] or north2)]
        own, iw, in_ = self.own, self.iw, self.in_
        weak = self.weak
        brightness = [
            float(own - iw) if iw else 0.0,
            float(own - in_) if in_ else 0.0,
            f32(weak[own] - weak[iw]) if iw else 0.0,
            f32(weak[own] - weak[in_]) if in_ else 0.0,
        ]
        past = around = [0.0] * 4
        around = [0.0] * 6
        if seen:
            past = self.four

            def layer(ranges, d, o, instead):
                r, k = row + d, c + o
                if 0 <= r < len(ranges) and 0 <= k < len(ranges[r]):
                    return ranges[r][k] or instead
                return instead

            moved = self.reference.moved.ranges
            same = self.reference.same.ranges
            moved_west = layer(moved, 0, -1, self.moved)
            moved_east = layer(moved, 0, 1, self.moved)
            moved_north = layer(moved, -1, 0, self.moved)
            moved_south = layer(moved, 1, 0, self.moved)
            around = [f(moved_west), f(moved_east), f(moved_north), f(moved_south)]
            around += [f(layer(same, -1, 0, self.same)), f(layer(same, 1, 0, self.same))]
        eight = self.eight
        wide = self.wide[self.edge + (4 if seen else 0)]
        wide_features = floats(eight + far + brightness + past + around + [0.0, 0.0])
        w = predicted(wide, wide_features)
        recent = self.recent[self.edge]
        recent_features = floats(eight)
        r = predicted(recent, recent_features)
        local = self.local[c // 64]
        local_features = floats(eight + past)
        l = predicted(local, local_features)
        signed_east = self.signed_above[c + 1]
        if seen:
            four = [
                float(self.same - west),
                float(self.moved - west),
                float(self.moved - moved_west),
                float(north - west + self.moved - moved_north),
            ]
        else:
            four = [w] * 4
        blending = [w, r, l, float(north - west)] + four
        blending += [float(self.error_west), self.signed_above[c], signed_east, 10.0]
        blending = floats([clamp(v, -300.0, 300.0) for v in blending])
        blend = self.blend[self.error_level]
        linear = predicted(blend, blending)
        b = clamp(linear + self.residuals.hint(c, own, iw), -400.0, 400.0)
        base = self.base_of(b)

        if seen:
            kind = 1 + self.level
            ls = self.reference.same.levels[row][c]
            lm = self.reference.moved.levels[row][c]
            known = 1 + change(own, ls) * 8 + change(own, lm)
            same_base, moved_base = self.same - base, self.moved - base
            last_three = [float(self.moved), float(moved_west), float(moved_east)]
        else:
            kind = known = 0
            same_base = moved_base = int(west + w - base)
            last_three = [west + w] * 3
        error_level = self.error_level
        line = min(row, 63)
        both = change(own, iw) * 8 + change(own, in_)
        predictions = [float(2 * west - west2), west + r, west + l, west + b, float(west)] + last_three
        predictions = floats(predictions).tolist()
        contexts = (
            kind * 144 + self.context,
            (both * 4 + min(own // 8, 3)) * 12 + error_level,
            (known * 8 + kind) * 12 + error_level,
        )
        first, second, _, third = self.views(base)
        views = [
            first,
            second,
            third,
            signed_level(same_base) * 32 + kind * 4 + error_level // 3,
            pair(same_base, moved_base),
        ]
        views = [v * 64 for v in views]
        scales = self.scales.of(contexts[2])
        placed = [ErrorShape.place(f32(p + 0.5), s) for p, s in zip(predictions, scales)]
        weights = [weights.of(context) for weights, context in zip(self.sets, contexts)]
        network = self.network
        scale = max(scales[3], 1.0)
        level_at = self.row_levels
        beside = [level_at[c + o] if 0 <= c + o < len(level_at) else 0 for o in (1, 2, -2)]
        east, east2, level_west2, own_level, level_west = (min(v, 127) for v in (*beside, own, iw))
        octaves_of_scale = min((unpack("<I", pack("<f", scale))[0] >> 20) - 1016, 127)
        pairs = [own_level * 128 + v for v in (line, level_west, east)]
        unit = f32(1 / scale)

        def within(v):
            return clamp(f32(f32(v) * unit), -4.0, 4.0) * 0.5

        def relative(v):
            return within(f32(f32(v) - f32(base)))

        numbers = [within(v) for v in self.residuals.inputs]
        numbers += [1.0, octaves_of_scale / 32 - 1, within(self.residuals.hinted)]
        numbers += [within(self.error_west), within(signed_east)]
        numbers += [relative(v) for v in (west, west2, west3, 2 * west - west2, north, self.neighbours[5])]
        if seen:
            ranges = [self.same, self.sw or self.same, self.se or self.same, self.moved, moved_west, moved_east]
            ranges += [layer(moved, 0, 2, self.moved), layer(moved, 0, 3, self.moved)]
            numbers += [1.0, *(relative(v) for v in ranges)]
        else:
            numbers += [0.0] * 9
        network.activate([level_west, east, east2, level_west2, line, octaves_of_scale, self.context, *pairs], numbers)
        third = f32(1 / 3)
        bits = self.bits
        layered = self.layered

        def code(odds, node):
            mean = f32(f32(f32(odds[0] + odds[1]) + odds[2]) * third)
            if node is None:
                return bits.decode(squash(mean)), mean
            outputs = (node, (1 + kind * 12 + error_level) * 64 + node, (97 + line) * 64 + node)
            corrected = f32(mean + network.odds(outputs))
            bit = layered.code(
                bits,
                [v + node for v in views],
                ((kind * 64 + node) * 12 + error_level, line * 64 + node, known * 64 + node),
                node,
                (node * 12 + error_level, line * 64 + node),
                [*odds, corrected],
            )
            network.learn_bit(outputs, corrected, bit)
            return bit, mean

        bins = Bins(base, self.bin, self.range_bits)
        coding = Coding(bits, bins, self.range_bits, placed, weights)
        value = coding.run(code, first_bucket(f32(scales[3] / self.bin)), 2)
        network.learn()
        likelihood = likelihood_of(coding.at_low[0], coding.at_high[0])
        scale_rate = max(RATES[0], self.sets[2].early(contexts[2]))
        for weights, context in zip(self.sets, contexts):
            resp = weights.learn(context, max(RATES[1], weights.early(context)), likelihood)
        self.scales.learn(contexts[2], scale_rate, value, predictions, resp)
        self.learn_fit(wide, wide_features, value, w)
        self.learn_fit(recent, recent_features, value, r)
        self.learn_fit(local, local_features, value, l)
        self.learn_fit(blend, blending, value, linear)
        self.residuals.learn(c, f32(value - west - linear))
        self.learnt(value, base, b)
        return value
