"""Sections 6 and 7 of FORMAT.md: logistic mixing, least squares. Arrays of type `f` round to float32 on assignment."""

from array import array
from math import exp, log, sqrt
from operator import add, itemgetter, mul, truediv
from struct import pack, unpack

M32 = 0xFFFFFFFF

_CELL = array("f", [0.0])


def f32(v):
    _CELL[0] = v
    return _CELL[0]


def floats(values):
    return array("f", values)


def ilog2(n):
    return n.bit_length() - 1


def to_int(v, least=-(1 << 63), most=(1 << 63) - 1):
    """`int(v)`."""
    if v != v:
        return 0
    if v >= most:
        return most
    if v <= least:
        return least
    return int(v)


def clamp(v, a, b):
    return a if v < a else b if v > b else v


# 6.1 Tables


def _squash(i):
    return int(clamp(65536 / (1 + exp(-((i - 4096) / 256))), 1, 65535))


def _stretch(i):
    p = (i + 0.5) / 4096
    return log(p / (1 - p))


SQUASH = [_squash(i) for i in range(8192)]
STRETCH = floats(_stretch(i) for i in range(4096)).tolist()
BEND = floats(log(1 + (i + 0.5) / 1024) - (i + 0.5) / 1024 * log(2) for i in range(1024)).tolist()
BELIEF = floats(i / (i + 1.5) for i in range(256)).tolist()
RATES = [16384 // (2 * i + 3) for i in range(256)]
CHORD = f32(0.6931471805599453) / (1 << 23)


def squash(odds):
    # Python rounds as the sum with 2^23 does: half to even.
    i = round(odds * 256) + 4096
    return SQUASH[0 if i < 0 else 8191 if i > 8191 else i]


def odds_of(one, zero):
    """The log odds of two f32 in this ratio."""
    a, b = unpack("<2i", pack("<2f", one, zero))
    return f32(f32(f32(a - b) * CHORD) + f32(BEND[a >> 13 & 1023] - BEND[b >> 13 & 1023]))


# 6.2 Counter

NEW = 1 << 31


def new_counters(n):
    return array("I", [NEW]) * n


def opinion(counter):
    _CELL[0] = STRETCH[counter >> 20] * BELIEF[counter & 255]
    return _CELL[0]


def learnt(counter, bit):
    count = counter & 255
    p = counter >> 10
    target = 0x3FFFFF if bit else 0
    p += ((target - p) >> 3) * RATES[count] >> 10
    return p << 10 | (count + 1 if count < 255 else 255)


def dot(a, b):
    """The sum of products in four lanes; both have one element or a multiple of four."""
    p = array("f", map(mul, a, b))
    if len(p) == 1:
        return p[0]
    if len(p) > 4:
        lanes = p[:4]
        for k in range(4, len(p), 4):
            lanes = array("f", map(add, lanes, p[k : k + 4]))
        p = lanes
    _CELL[0] = p[0] + p[1]
    x = _CELL[0]
    _CELL[0] = p[2] + p[3]
    _CELL[0] = x + _CELL[0]
    return _CELL[0]


def dot_from(start, a, b):
    """`start` and the products, summed in four lanes."""
    p = array("f", map(mul, a, b))
    lanes = array("f", [start, 0.0, 0.0, 0.0])
    for k, x in enumerate(p):
        lanes[k % 4] += x
    return f32(f32(lanes[0] + lanes[1]) + f32(lanes[2] + lanes[3]))


def rates_of(rate):
    """6.3: the learning rate after so many bits."""
    rate = f32(rate)
    return floats(f32(f32(800 / (200 + s)) * rate) / 65536 for s in range(601)).tolist()


class MixedBits:
    """6.3."""

    def __init__(self, views, sets, view_weight, other_weight, rate):
        self.views = [new_counters(n) for n in views]
        self.rates = rates_of(rate)
        self.first = floats([view_weight] * len(views) + [other_weight, 0.0, 0.0, 0.0])
        self.weights = [None] * sets
        self.seen = [0] * sets
        self.pad = -(len(views) + 2) % 4

    def weights_of(self, s, n):
        w = self.weights[s]
        if w is None:
            w = self.first
        if len(w) != n:
            # Room for another opinion, or for what fills the lanes.
            w = w[:n] + array("f", bytes(4 * max(n - len(w), 0)))
        return w

    def code(self, bits, s, places, other=0.0, extra=()):
        """`extra`: pairs of an array and a place, of `code_with`."""
        cells = [(view, place) for view, place in zip(self.views, places)]
        counters = [view[place] for view, place in cells]
        opinions = [STRETCH[c >> 20] * BELIEF[c & 255] for c in counters]
        opinions.append(other)
        opinions.append(0.25)
        if extra:
            for view, place in extra:
                c = view[place]
                opinions.append(STRETCH[c >> 20] * BELIEF[c & 255])
        n = len(opinions)
        opinions += (0.0,) * (-n % 4)
        n = len(opinions)
        opinions = array("f", opinions)
        w = self.weights[s]
        if w is None or len(w) != n:
            w = self.weights_of(s, n)
        p = squash(dot(w, opinions))
        bit = bits.decode(p)
        seen = self.seen[s]
        _CELL[0] = (65536 - p if bit else -p) * self.rates[seen]
        pull = _CELL[0]
        if seen < 600:
            self.seen[s] = seen + 1
        self.weights[s] = array("f", map(add, w, array("f", [pull * x for x in opinions])))
        if extra:
            cells += extra
        for view, place in cells:
            view[place] = learnt(view[place], bit)
        return bit

    def code_or_sure(self, bits, s, places, sure, extra=()):
        v0, v1 = self.views[:2]
        a = opinion(v0[places[0]])
        b = opinion(v1[places[1]])
        if min(a, b) < sure and max(a, b) > -sure:
            return self.code(bits, s, places, 0.0, extra)
        bit = bits.decode(squash(f32(0.5 * f32(a + b))))
        v0[places[0]] = learnt(v0[places[0]], bit)
        v1[places[1]] = learnt(v1[places[1]], bit)
        return bit

    def spread(self, sets):
        for s in range(sets, len(self.weights)):
            w = self.weights[s % sets]
            self.weights[s] = None if w is None else w[:]
            self.seen[s] = self.seen[s % sets]


# 6.4 HashedCounters


def hash_of(view, context):
    m = (context + view * 0x3C6EF372) * 0x9E3779B1 & M32
    return (m ^ (m >> 15)) * 0x85EBCA6B & M32


def hash_below(h, node):
    return (h ^ (node * 0x2545F491 & M32)) * 0x9E3779B1 & M32


SMALL_RATES = [131072 // (2 * (n + (4 * (n - 8) if n > 8 else 0)) + 3) for n in range(16)]


class HashedCounters:
    def __init__(self, b):
        self.b = b
        self.lines = [None] * (1 << b)

    def line(self, h):
        """A list: the tag, then fifteen counters."""
        first = h >> (32 - self.b)
        tag = h & 4095
        lines = self.lines
        a = lines[first]
        if a is not None and a[0] & 4095 == tag and a[0] >> 12:
            found = a
        else:
            second = first ^ 1
            b = lines[second]
            if b is not None and b[0] & 4095 == tag and b[0] >> 12:
                found = b
            else:
                asked_a = a[0] >> 12 if a is not None else 0
                asked_b = b[0] >> 12 if b is not None else 0
                found = [tag] + [0x8000] * 15
                if asked_a <= asked_b:
                    lines[first] = found
                    spared = b
                else:
                    lines[second] = found
                    spared = a
                if spared is not None and spared[0] >= 4096:
                    spared[0] -= 4096
        if found[0] + 4096 < 65536:
            found[0] += 4096
        return found


def learnt_small(counter, bit):
    n = counter & 15
    p = counter >> 4
    p += ((4095 if bit else 0) - p) * SMALL_RATES[n] + 32768 >> 16
    return p << 4 | (n + 1 if n < 15 else 15)


class LayeredMixer:
    """6.5."""

    def __init__(self, mixers, first_weights, rate, last_rate, last_sets, maps):
        self.n = len(first_weights)
        self.first = floats(first_weights)
        self.weights = [[None] * sets for sets in mixers]
        self.seen = [[0] * sets for sets in mixers]
        self.rates = rates_of(rate)
        self.last_rate = f32(last_rate)
        s = len(mixers)
        self.last = [floats([1 / s] * s) for _ in range(last_sets)]
        self.maps = [[None] * n for n in maps]
        self.point = floats(i / 2 - 8 for i in range(33))

    def code(self, bits, sets, last, maps, opinions):
        mixers = self.weights
        own = []
        first = []
        for weights, s in zip(mixers, sets):
            w = weights[s]
            if w is None:
                w = self.first
            own.append(w)
            v = dot(w, opinions)
            first.append(-12.0 if v < -12 else 12.0 if v > 12 else v)
        cell = _CELL
        cell[0] = 0.0
        last_weights = self.last[last]
        for p in array("f", map(mul, first, last_weights)):
            cell[0] += p
        mixed = cell[0]
        cell[0] = mixed * 0.5
        odds = cell[0]
        cell[0] = -8.0 if mixed < -8 else 8.0 if mixed > 8 else mixed
        cell[0] += 8
        at = cell[0] * 2
        i = min(int(at), 31)
        part = at - i
        found = []
        cell[0] = 1 - part
        rest = cell[0]
        for points, m in zip(self.maps, maps):
            x = points[m]
            if x is None:
                x = points[m] = self.point[:]
            t = array("f", (x[i] * rest, x[i + 1] * part))
            cell[0] = t[0] + t[1]
            found.append((x, cell[0]))
            cell[0] *= 0.25
            cell[0] += odds
            odds = cell[0]
        bit = bits.decode(squash(odds))
        whole = 65536 if bit else 0

        cell[0] = (whole - squash(odds)) / 65536 * self.last_rate
        pull = cell[0]
        for k, (weights, s) in enumerate(zip(mixers, sets)):
            f = first[k]
            cell[0] = pull * f
            last_weights[k] += cell[0]
            seen = self.seen[k][s]
            if seen < 600:
                self.seen[k][s] = seen + 1
            cell[0] = (whole - squash(f)) * self.rates[seen]
            step = cell[0]
            weights[s] = array("f", map(add, own[k], array("f", [step * o for o in opinions])))
        t = array("f", (0.08,))[0]
        for x, y in found:
            cell[0] = t * ((whole - squash(y)) / 65536)
            by = cell[0]
            cell[0] = by * rest
            x[i] += cell[0]
            cell[0] = by * part
            x[i + 1] += cell[0]
        return bit

    def spread(self, mixer, sets):
        weights = self.weights[mixer]
        seen = self.seen[mixer]
        for s in range(sets, len(weights)):
            w = weights[s % sets]
            weights[s] = None if w is None else w[:]
            seen[s] = seen[s % sets]


class LayeredBits:
    """6.6."""

    def __init__(self, others, views, mixers, last_sets, maps):
        n = others + len(views) + 1
        self.pad = [0.0] * (-n % 4)
        first = [1 / others] * others + [0.0] * (n - others) + self.pad
        self.mixer = LayeredMixer(mixers, first, 0.012, 0.001, last_sets, maps)
        self.views = [new_counters(v) for v in views]

    def code(self, bits, places, sets, last, maps, others):
        cells = list(zip(self.views, places))
        opinions = others + [STRETCH[c >> 20] * BELIEF[c & 255] for c in [v[p] for v, p in cells]]
        opinions.append(0.25)
        bit = self.mixer.code(bits, sets, last, maps, array("f", opinions + self.pad))
        for view, place in cells:
            view[place] = learnt(view[place], bit)
        return bit


class Network:
    """6.7."""

    UNITS = 32

    def __init__(self, sizes, numbers, outputs, row_rate, number_rate, output_rate):
        units = self.UNITS
        ends = [numbers]
        for size in sizes:
            ends.append(ends[-1] + size)
        self.firsts = ends[:-1]
        self.zeros = floats([0.0] * units)
        # None: all zeros.
        self.rows = [None] * ends[-1]
        drawn = 0
        for first, size in [(0, numbers), *((f, n) for f, n in zip(self.firsts, sizes) if n < 4096)]:
            for row in range(first, first + size):
                draws = (hash_of(0, i) >> 8 for i in range(drawn, drawn + units))
                self.rows[row] = floats([(draw / (1 << 24) - 0.5) * f32(0.1) for draw in draws])
                drawn += units
        self.weights = [self.zeros] * outputs
        self.bias = [0.0] * outputs
        self.row_rate, self.number_rate, self.output_rate = f32(row_rate), f32(number_rate), f32(output_rate)

    def activate(self, contexts, numbers):
        self.used = [first + context for first, context in zip(self.firsts, contexts)]
        self.numbers = numbers
        sums = self.zeros
        for row in self.used:
            weights = self.rows[row]
            if weights:
                sums = array("f", map(add, sums, weights))
        for weights, number in zip(self.rows, numbers):
            sums = array("f", map(add, sums, array("f", [w * number for w in weights])))
        self.slope = array("f", [1 + abs(x) for x in sums])
        self.hidden = array("f", map(truediv, sums, self.slope))
        self.gradient = self.zeros

    def odds(self, outputs):
        w, b = self.zeros, 0.0
        for o in outputs:
            w = array("f", map(add, w, self.weights[o]))
            b = f32(b + self.bias[o])
        self.w = w
        products = array("f", map(mul, w, self.hidden))
        lanes = array("f", [b, 0.0, 0.0, 0.0])
        for k in range(0, self.UNITS, 4):
            lanes = array("f", map(add, lanes, products[k : k + 4]))
        return f32(f32(lanes[0] + lanes[1]) + f32(lanes[2] + lanes[3]))

    def learn_bit(self, outputs, odds, bit):
        error = (65536 * bit - squash(odds)) / 65536
        by = f32(error * self.output_rate)
        self.gradient = array("f", map(add, self.gradient, array("f", [error * x for x in self.w])))
        changes = array("f", [by * x for x in self.hidden])
        for o in outputs:
            self.weights[o] = array("f", map(add, self.weights[o], changes))
            self.bias[o] = f32(self.bias[o] + by)

    def learn(self):
        squares = array("f", map(mul, self.slope, self.slope))
        gradient = array("f", map(truediv, self.gradient, squares))
        change = array("f", [x * self.row_rate for x in gradient])
        for row in self.used:
            self.rows[row] = array("f", map(add, self.rows[row] or self.zeros, change))
        for i, number in enumerate(self.numbers):
            rate = f32(number * self.number_rate)
            self.rows[i] = array("f", map(add, self.rows[i], array("f", [rate * x for x in gradient])))


# 7 Helpers

_TRIANGLES = {}


def _triangle(n):
    if n not in _TRIANGLES:
        pairs = [(i, j) for i in range(n) for j in range(i + 1)]
        # With a single index, itemgetter returns no tuple.
        single = lambda f: (f[0],)
        of = lambda places: itemgetter(*places) if n > 1 else single
        _TRIANGLES[n] = of([i for i, _ in pairs]), of([j for _, j in pairs])
    return _TRIANGLES[n]


class LeastSquares:
    """7.1. `normal` is the lower triangle, row after row."""

    def __init__(self, n, forget, every=32):
        self.n = n
        self.forget = f32(forget)
        self.every = every
        self.normal = array("f", bytes(4 * (n * (n + 1) // 2)))
        self.right = array("f", bytes(4 * n))
        self.weights = array("f", bytes(4 * n))
        self.samples = 0

    def predict(self, f):
        return dot(self.weights, f)

    def learn(self, f, target, weight):
        forget = self.forget
        rows, columns = _triangle(self.n)
        weighted = array("f", [weight * x for x in f])
        outer = array("f", map(mul, rows(weighted), columns(f)))
        self.normal = array("f", map(add, array("f", [x * forget for x in self.normal]), outer))
        _CELL[0] = weight * target
        wt = _CELL[0]
        kept = array("f", [x * forget for x in self.right])
        self.right = array("f", map(add, kept, array("f", [wt * x for x in f])))
        self.samples += 1
        if self.samples == self.every:
            self.samples = 0
            self.solve()

    def solve(self):
        n = self.n
        cell = _CELL
        small = f32(0.05)
        least = f32(0.000001)
        rows = []
        inverse = array("f", bytes(4 * n))
        at = 0
        for i in range(n):
            row = self.normal[at : at + i + 1]
            at += i + 1
            for j in range(i):
                cell[0] = row[j]
                for p in array("f", map(mul, row[:j], rows[j])):
                    cell[0] -= p
                row[j] = cell[0] * inverse[j]
            cell[0] = row[i]
            for p in array("f", [x * x for x in row[:i]]):
                cell[0] -= p
            cell[0] += small
            if not cell[0] > least:
                return
            row[i] = sqrt(cell[0])
            inverse[i] = 1 / row[i]
            rows.append(row)
        forward = array("f", bytes(4 * n))
        for i in range(n):
            cell[0] = 0.0
            for p in array("f", map(mul, rows[i][:i], forward)):
                cell[0] += p
            cell[0] = self.right[i] - cell[0]
            forward[i] = cell[0] * inverse[i]
        weights = array("f", bytes(4 * n))
        for i in range(n - 1, -1, -1):
            cell[0] = 0.0
            for p in array("f", [rows[k][i] * weights[k] for k in range(i + 1, n)]):
                cell[0] += p
            cell[0] = forward[i] - cell[0]
            weights[i] = cell[0] * inverse[i]
        self.weights = weights

    def widened(self, m):
        wide = LeastSquares(m, self.forget, self.every)
        wide.normal[: len(self.normal)] = self.normal
        wide.right[: self.n] = self.right
        wide.weights[: self.n] = self.weights
        wide.samples = self.samples
        return wide

    def copy(self):
        return self.widened(self.n)


class Levels:
    """7.2."""

    def __init__(self, n, first, factor):
        factor = f32(factor)
        t = [f32(first)]
        while len(t) < n:
            t.append(f32(t[-1] * factor))
        self.t = t

    def of(self, v):
        n = 0
        for t in self.t:
            if not t <= v:
                break
            n += 1
        return n


def _half_octave(m):
    if m == 0:
        return 0
    top = ilog2(m)
    return 2 * top + 1 + (1 if m * m >= 1 << (2 * top + 1) else 0)


_SIGNED = [16 + min(_half_octave(m), 15) for m in range(256)]


def signed_level(d):
    """7.3; d a whole number."""
    d = int(d)
    m = -d if d < 0 else d
    level = _SIGNED[m] if m < 256 else 31
    return 32 - level if d < 0 else level


# 8.6 ErrorShape

TAU = float.fromhex("0x1.921fb54442d18p+2")


def _shape():
    def deviations(i):
        return ((i + 0.5) / 2048 * 2 - 1) * 40

    def density(i):
        z = deviations(i)
        core = exp(-z * z / 2) / sqrt(TAU)
        t = z / 3
        tail = 1 / ((2 + t * t) * sqrt(2 + t * t)) / 3
        return 0.7 * core + (1 - 0.7) * tail

    densities = [density(i) for i in range(2048)]
    total = 0.0
    for d in densities:
        total += d
    magnitude = 0.0
    for i, d in enumerate(densities):
        magnitude += d / total * abs(deviations(i))
    below = floats([])
    run = 0.0
    for d in densities:
        below.append(run / total)
        run += d
    return below.tolist(), floats(d / total for d in densities).tolist(), f32(2048 / 80 * magnitude)


BELOW, STEP, FINENESS = _shape()


class ErrorShape:
    @staticmethod
    def place(prediction, scale):
        """Both f32."""
        return prediction, f32(FINENESS / scale)

    @staticmethod
    def below(placed, value):
        cell = _CELL
        cell[0] = value - placed[0]
        cell[0] *= placed[1]
        cell[0] += 1024
        at = cell[0]
        at = 1.0 if at < 1 else 2047.0 if at > 2047 else at
        cell[0] = at + 8388607.5
        floor = cell[0] - 8388608
        i = int(floor)
        cell[0] = at - floor
        cell[0] *= STEP[i]
        cell[0] += BELOW[i]
        return cell[0]


class Residuals:
    """7.4."""

    def __init__(self):
        self.weights = floats([0.0] * 20)
        self.quartile = 8.0
        self.offsets = [floats([0.0] * 16) for _ in range(16)]

    def start_frame(self, columns):
        self.here = [0.0] * (columns + 7)

    def start_row(self):
        self.above, self.here = self.here, [0.0] * len(self.here)
        self.left = [0.0] * 12

    def hint(self, column, own, iw):
        self.inputs = floats(self.left[-12:] + self.above[column : column + 8])
        self.place = signed_level(own) - 16, signed_level(iw) - 16
        o, w = self.place
        self.hinted = f32(dot(self.weights, self.inputs) + self.offsets[o][w])
        return self.hinted

    def learn(self, column, residual):
        quartile = self.quartile
        error = f32(residual - self.hinted)
        limited = clamp(error, -2 * quartile, 2 * quartile)
        by = f32(f32(f32(0.015) * limited) / f32(dot(self.inputs, self.inputs) + 20.0))
        for k, x in enumerate(self.inputs):
            self.weights[k] += f32(by * x)
        o, w = self.place
        self.offsets[o][w] += f32(limited * f32(0.003))
        residual = clamp(residual, f32(-5 * quartile), f32(5 * quartile))
        self.left.append(residual)
        self.here[column + 3] = residual
        by = 0.0125 if abs(error) > quartile else -0.0375
        self.quartile = max(f32(quartile + f32(by)), 0.5)
