"""Section 8.6 of FORMAT.md: ranges by the arithmetic coder, as `mixed` and `deep` have them."""

from models import (
    BELOW,
    DIFFERENCE,
    ErrorShape,
    LayeredBits,
    LeastSquares,
    Levels,
    MixedBits,
    Residuals,
    clamp,
    f32,
    floats,
    ilog2,
    ln,
    new_counters,
    signed_level,
    squash,
)
from sections import first_of

ONE = 1 << 30


def start_scales(surprise_at, n, e):
    s = 3.0
    for _ in range(e - 2):
        s *= 1.6
    scales = [s] * n
    scales[surprise_at] = 500.0
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


class Mixture:
    """Weights and scales of contexts of predictors; 4 is the one for surprises."""

    def __init__(self, contexts, n):
        self.n = n
        self.weights = [None] * contexts
        self.shares = [None] * contexts
        self.scales = [None] * contexts
        self.counts = [0] * contexts

    def start(self, context):
        if self.weights[context] is None:
            self.weights[context] = [1 / self.n] * self.n
            self.shares[context] = [int(1 / self.n * 65536)] * self.n
            self.scales[context] = start_scales(4, self.n, context % 12)

    def copy(self, to, source):
        for part in (self.weights, self.shares, self.scales):
            part[to] = None if part[source] is None else part[source][:]
        self.counts[to] = self.counts[source]

    def learn(self, context, range_, predictions, low, high, is_deep):
        """`low`, `high`: the probabilities of the predictors at the ends."""
        likelihood = [max(h - l, 0) / 1073741824.0 for l, h in zip(low, high)]
        w = self.weights[context]
        scales = self.scales[context]
        total = 0.0
        for a, b in zip(w, likelihood):
            total += a * b
        total += 1e-9
        rate = scale_rate = 0.02
        if is_deep:
            n = self.counts[context]
            self.counts[context] = min(n + 1, 1000)
            early = 0.3 / (n + 1.5)
            rate = max(0.03, early)
            scale_rate = max(0.02, early)
            kept = 1 - rate
        else:
            kept = 0.98
        sum_ = 0.0
        new = []
        for k, weight in enumerate(w):
            merit = (likelihood[k] + 1e-9) / total
            v = max(weight * (kept + rate * merit), 0.001)
            sum_ += v
            error = abs(range_ - predictions[k])
            s = scales[k]
            resp = min(v * merit, 1.0)
            if k == 4:
                s += scale_rate * resp * (min(error, 4000.0) - s)
                scales[k] = s if s > 100.0 else 100.0
            else:
                s += scale_rate * (resp + 0.1) * (min(error, 400.0) - s)
                scales[k] = s if s > 1.5 else 1.5
            new.append(v)
        share = 1 / sum_
        new = [v * share for v in new]
        self.weights[context] = new
        self.shares[context] = [int(v * 65536) for v in new]


def first_bucket(scale):
    n = int(scale * 0.84853)
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

    def __init__(self, bits, bins, range_bits, mixtures):
        """`mixtures`: pairs of placed predictors and their shares."""
        self.bits = bits
        self.bins = bins
        self.shift = 38 - range_bits
        self.mixtures = mixtures
        self.low = bins.bin(1)
        self.high = bins.bin((1 << range_bits) - 1) + 1
        self.at_low = [([0] * len(shares), 0) for _, shares in mixtures]
        self.at_high = [([ONE] * len(shares), (1 << 46) + (1 << 38)) for _, shares in mixtures]

    def below(self, i):
        bins = self.bins
        value = bins.origin + i * bins.width
        value = 1 if value < 1 else bins.end if value > bins.end else value
        plain = value << self.shift
        found = []
        for placed, shares in self.mixtures:
            mixed = plain
            each = []
            for (origin, slope), share in zip(placed, shares):
                at = origin + value * slope
                if at <= 0:
                    each.append(0)
                elif at >= 0x8000000:
                    each.append(ONE)
                    mixed += share << 30
                else:
                    k = at >> 16
                    b = BELOW[k] + (DIFFERENCE[k] * (at & 65535) >> 16)
                    each.append(b)
                    mixed += share * b
            found.append((each, mixed))
        return found

    def odds(self, at):
        return [
            f32(ln(max(h[1] - a[1], 0) | 1) - ln(max(a[1] - l[1], 0) | 1))
            for l, a, h in zip(self.at_low, at, self.at_high)
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
        self.mixture = Mixture(144, 5)
        self.mixed = MixedBits([65536, 65536, 65536, 131072], 6144, 0.0, 1.0, 0.004)

    def starts_frame(self, columns):
        pass

    def first_reference(self):
        self.reference_fits = [fits.widened(12) for fits in self.fits]
        self.with_reference = with_reference = Mixture(1008, 7)
        for c in range(1008):
            source = c % 144
            self.mixture.start(source)
            weights = [w * (5 / 7) for w in self.mixture.weights[source]] + [1 / 7] * 2
            with_reference.weights[c] = weights
            with_reference.shares[c] = [int(w * 65536) for w in weights]
            scales = self.mixture.scales[source]
            with_reference.scales[c] = scales + [scales[3]] * 2
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
        predictions = [float(west), float(north), float(2 * west - self.west2), west + fit, float(west)]
        mixture, context, sets = self.mixture, self.context, self.error_level
        extra_places = ()
        if seen:
            predictions += [float(self.same), float(self.moved)]
            mixture = self.with_reference
            context += self.level * 144
            sets += (1 + self.level) * 768
            extra_places = (
                (signed_level(self.same - base) * 32 + self.level * 4 + self.error_level // 3) * 64,
                pair(self.same - base, self.moved - base) * 64,
            )
        mixture.start(context)
        scales = mixture.scales[context]
        placed = [ErrorShape.place(p + 0.5, s) for p, s in zip(predictions, scales)]
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
        coding = Coding(bits, bins, self.range_bits, [(placed, mixture.shares[context])])
        value = coding.run(code, first_bucket(scales[3] / self.bin), 1)
        mixture.learn(context, value, predictions, coding.at_low[0][0], coding.at_high[0][0], False)
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
        self.mixtures = [Mixture(n, 8) for n in (1152, 3072, 6240)]
        self.layered = LayeredBits(
            3, [64 * n for n in (1024, 1024, 1024, 2048, 1024, 1024, 768, 780)], [6144, 4096, 4160], 64, [768, 4096]
        )
        self.weak = [f32(40 / (i + 2)) for i in range(129)]

    def starts_frame(self, columns):
        while len(self.local) * 64 < columns:
            self.local.append(LeastSquares(12, 0.97, 8))

    def first_reference(self):
        self.wide[4:] = [fits.copy() for fits in self.wide[:4]]
        for mixture, n in ((self.mixtures[0], 144), (self.mixtures[2], 12)):
            for c in range(n, len(mixture.weights)):
                mixture.copy(c, c % n)
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
        contexts = (
            kind * 144 + self.context,
            (both * 4 + min(own // 8, 3)) * 12 + error_level,
            (known * 8 + kind) * 12 + error_level,
        )
        views = self.views(base) + [
            signed_level(same_base) * 32 + kind * 4 + error_level // 3,
            pair(same_base, moved_base),
            line * 12 + error_level,
            known * 12 + error_level,
        ]
        views = [v * 64 for v in views]
        placed = []
        for mixture, context in zip(self.mixtures, contexts):
            mixture.start(context)
            places = [ErrorShape.place(p + 0.5, s) for p, s in zip(predictions, mixture.scales[context])]
            placed.append((places, mixture.shares[context]))
        third = f32(1 / 3)
        bits = self.bits
        layered = self.layered

        def code(odds, node):
            mean = f32(f32(f32(odds[0] + odds[1]) + odds[2]) * third)
            if node is None:
                return bits.decode(squash(mean)), mean
            bit = layered.code(
                bits,
                [v + node for v in views],
                ((kind * 64 + node) * 12 + error_level, line * 64 + node, known * 64 + node),
                node,
                (node * 12 + error_level, line * 64 + node),
                odds,
            )
            return bit, mean

        bins = Bins(base, self.bin, self.range_bits)
        coding = Coding(bits, bins, self.range_bits, placed)
        fine = first_bucket(self.mixtures[0].scales[contexts[0]][3] / self.bin)
        value = coding.run(code, fine, 2)
        for k, (mixture, context) in enumerate(zip(self.mixtures, contexts)):
            mixture.learn(context, value, predictions, coding.at_low[k][0], coding.at_high[k][0], True)
        self.learn_fit(wide, wide_features, value, w)
        self.learn_fit(recent, recent_features, value, r)
        self.learn_fit(local, local_features, value, l)
        self.learn_fit(blend, blending, value, linear)
        self.residuals.learn(c, f32(value - west - linear))
        self.learnt(value, base, b)
        return value
