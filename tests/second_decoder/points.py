"""Section 8.4 of FORMAT.md: the positions of strays."""

import struct
from math import inf, isfinite, nan, sqrt

from entropy import M64, unzigzag, AdaptiveBit, IntegerModel, SymbolModel, wrap
from models import TAU, LeastSquares, MixedBits, clamp, f32
from scanner import FLOAT32, Grid, exponent, float_of_bits
from trigonometry import atan2, cos, sin


def finite(point):
    """Of a position as bits of float32s."""
    return [v if isfinite(v) else 0.0 for v in map(float_of_bits, point)]


def divided(a, b):
    """As float64s are divided."""
    if b:
        return a / b
    if not a or a != a:
        return nan
    # The signs of infinities do not matter: all of them are on no grid, or clamped.
    return inf if (a > 0) == (struct.pack(">d", b)[0] < 128) else -inf


def clamped(v, least, most):
    return v if v != v else clamp(v, least, most)


def close(d):
    return 1 / max(d, 0.01)


def turned(angle):
    return angle - TAU * round(angle / TAU)


class Repeats:
    """What says which points repeat others."""

    def __init__(self):
        self.is_repeat = [[AdaptiveBit(), AdaptiveBit()] for _ in range(4)]
        self.is_at = [AdaptiveBit() for _ in range(4)]
        self.is_held = [AdaptiveBit() for _ in range(4)]
        self.distances = IntegerModel()

    def code(self, bits, n):
        """For each point the index of its source, -1 for the origin; None if it is no repeat."""
        sources = []
        kind = distance = 0
        held = -1

        def source(index):
            return index - distance if 1 <= distance <= index else -1

        for index in range(n):
            ends = 1 <= distance <= index and sources[index - distance] is not None
            if not self.is_repeat[kind][int(ends)].code(bits):
                kind = 0
                sources.append(None)
            elif self.is_at[kind].code(bits):
                kind, distance = 3, self.distances.code(bits)
                held = source(index)
                sources.append(held)
            elif self.is_held[kind].code(bits):
                kind = 2
                sources.append(held)
            else:
                kind = 1
                sources.append(source(index))
        return sources


class Trail:
    def __init__(self, number, point):
        self.number = number
        self.last = self.earlier = point
        self.history = 1
        self.missed = 0
        self.cone = LeastSquares(4, 0.9, 1)
        self.errors = [-6.0] * 3


class TrailModel:
    def __init__(self):
        self.begins = [AdaptiveBit(), AdaptiveBit()]
        self.goes_on = [AdaptiveBit() for _ in range(1024)]


class Ring:
    """The trails of a frame."""

    def __init__(self):
        self.trails = []
        self.at = 0
        self.began = 0
        self.answers = 0

    def code(self, bits, model, n):
        """Whether the point n continues a trail; it is that at `at`."""
        trails = self.trails
        self.began = int(model.begins[self.began].code(bits) or not trails)
        if self.began:
            if len(trails) == 256:
                self.at = (self.at + 1) % 256
                trails[self.at] = Trail(trails[self.at].number, n)
            else:
                used = {trail.number for trail in trails}
                number = next(k for k in range(256) if k not in used)
                self.at = self.at + 1 if trails else 0
                trails.insert(self.at, Trail(number, n))
            return False
        for steps in range(1, len(trails) + 2):
            place = (self.at + steps) % len(trails)
            trail = trails[place]
            long = min((trail.history >> 6 & 255).bit_count() // 2, 3)
            go = model.goes_on[trail.history & 63 | self.answers << 6 | long << 8].code(bits)
            self.answers = (self.answers << 1 | go) & 3
            trail.history = (trail.history << 1 | go) & 0xFFFFFFFF
            trail.missed += 1
            if go:
                break
        trail.missed = 0
        self.trails = [trail for trail in trails if trail.missed <= 100]
        self.at = place - sum(trail.missed > 100 for trail in trails[:place])
        return True


class Place:
    def __init__(self, position, before=None):
        self.position = position
        x, y, _ = position
        self.distance = sqrt(x * x + y * y)
        self.azimuth = atan2(y, x)
        self.close = close(self.distance)
        self.before = before


NOWHERE = Place([0.0, 0.0, 0.0])


class CoordinateModel:
    def __init__(self):
        self.errors = [-6.0] * 4
        self.off_grid = [AdaptiveBit(), AdaptiveBit()]
        self.off = 0
        self.raw = AdaptiveBit()
        self.length = MixedBits([2560, 102400, 163840], 64, 0.4, 0.0, 0.015)
        self.top = [None] * 64

    def code(self, bits, grid, predictions, detail, errors, number):
        self.off = self.off_grid[self.off].code(bits)
        if self.off:
            if self.raw.code(bits):
                return bits.plain(32)
            grid = Grid(FLOAT32)
        own = self.errors[: len(predictions)]
        best = own.index(min(own))
        s = grid.step_exponent(predictions[best])
        trail_error = errors[number]

        def error_class(e):
            return clamp(int(f32(e - s)), 0, 39)

        a, b = error_class(own[best]), error_class(trail_error)
        both = error_class(f32(0.5 * f32(own[best] + trail_error)))
        contexts = a, b * 40 + a, detail * 40 + both
        node = 1
        for _ in range(6):
            node = node * 2 + self.length.code(bits, node, [c * 64 + node for c in contexts])
        length = node - 64
        residual = length
        if length >= 2:
            below = length - 1
            modelled = min(below, 2)
            if self.top[length] is None:
                self.top[length] = SymbolModel(2)
            top = self.top[length].code(bits) % (1 << modelled)
            rest = below - modelled
            residual = (((1 << modelled) + top) << rest) + bits.plain(rest)
        units = [grid.unit_of(p) for p in predictions]
        unit = wrap(units[best] + unzigzag(residual), 64)

        def size(k):
            return (abs(wrap(unit - units[k], 64)) & M64).bit_length() + grid.step_exponent(predictions[k])

        for k in range(len(predictions)):
            self.errors[k] = f32(f32(f32(0.9) * own[k]) + f32(f32(0.1) * size(k)))
        errors[number] = f32(f32(f32(0.7) * trail_error) + f32(f32(0.3) * size(best)))
        return grid.value(unit, predictions[best])


class Points:
    def __init__(self):
        self.repeats = Repeats()
        self.trails = TrailModel()
        self.coordinates = None
        self.parallax = LeastSquares(1, f32(0.998), 1)

    @staticmethod
    def grid(bits):
        kind = bits.plain(3)
        return Grid.of_numbers(kind, bits.plain(30) if kind >= 2 else 0) or Grid(FLOAT32)

    def code(self, bits, n, grid):
        """The positions, as bits of float32s, and for each the row of its trail, the point before it, and whether that is
        its source."""
        if grid is not None:
            grids = [grid] * 3
        elif bits.plain(1):
            grids = [self.grid(bits) for _ in range(3)]
        else:
            grids = [self.grid(bits)] * 3
        sources = self.repeats.code(bits, n)
        own = [index for index in range(n) if sources[index] is None]
        points = [(0, 0, 0)] * n
        rows = [(0, None, False)] * n
        ring = Ring()
        places = []
        for number, index in enumerate(own):
            continues = ring.code(bits, self.trails, number)
            trail = ring.trails[ring.at]
            points[index] = self.point(bits, grids, trail, places, continues)
            before = places[number].before
            rows[index] = trail.number + 1, None if before is None else own[before], False
        for index, source in enumerate(sources):
            if source is not None and source >= 0:
                points[index] = points[source]
                rows[index] = 0, source, True
        return points, rows

    def offset(self):
        return clamped(self.parallax.predict((1.0,)), -3.0, 3.0)

    def step(self, to, before):
        return turned(to.azimuth - before.azimuth) - self.offset() * (to.close - before.close)

    def point(self, bits, grids, trail, places, continues):
        n = len(places)
        if continues:
            west, west2 = places[trail.last], places[trail.earlier]
        elif n:
            west, west2 = places[n - 1], places[max(n - 2, 0)]
        else:
            west = west2 = NOWHERE
        partners = []
        if continues:
            for k in range(1, min(n, 12) + 1):
                before = places[n - k].before
                if before is not None and before < trail.last and trail.last - before <= k + 8:
                    partners.append((places[n - k], places[before]))
                    if len(partners) == 3:
                        break
        north, north_west = partners[0] if partners else (west, west)
        own_step = self.step(north, north_west)
        middle_step = sorted(self.step(*pair) for pair in partners)[1] if len(partners) == 3 else own_step
        if self.coordinates is None:
            self.coordinates = [[CoordinateModel() for _ in range(3)] for _ in range(2)]
        models = self.coordinates[0 if continues else 1]
        errors = trail.errors

        offset = self.offset()
        a = west.azimuth + own_step
        u = cos(a), sin(a)
        major, minor = (0, 1) if abs(u[0]) >= abs(u[1]) else (1, 0)
        far = west.distance - west2.distance, north.distance - north_west.distance
        e = [clamp(exponent(v) + 8, 0, 7) for v in far]
        point = [0, 0, 0]
        predictions = [d * u[major] for d in (west.distance, west.distance + far[0], west.distance + far[1])]
        point[major] = models[0].code(bits, grids[major], predictions, e[0] * 8 + e[1], errors, 0)

        along = finite(point)[major]
        closer = close(divided(along, u[major])) - west.close
        predictions = []
        for angle in (
            a + offset * closer,
            west.azimuth + middle_step + offset * closer,
            west.azimuth + turned(north.azimuth - north_west.azimuth),
            west.azimuth + turned(west.azimuth - west2.azimuth),
        ):
            v = cos(angle), sin(angle)
            predictions.append(divided(along * v[minor], v[major]))
        point[minor] = models[1].code(bits, grids[minor], predictions, clamp(exponent(closer) + 22, 0, 31), errors, 1)

        own = Place(finite(point))
        moved = own.distance - west.distance, own.position[0] - west.position[0], own.position[1] - west.position[1]

        def tenths(v):
            return f32(clamped(v * 1e4, -1e7, 1e7))

        features = [tenths(v) for v in moved] + [1.0]

        def at(p):
            return p.position[2] * divided(own.distance, p.distance) if p.distance else p.position[2]

        z = west.position[2]
        predictions = [
            z + trail.cone.predict(features) / 1e4,
            at(west),
            at(west) + at(north) - at(north_west),
            2 * z - west2.position[2],
        ]
        point[2] = models[2].code(bits, grids[2], predictions, clamp(exponent(moved[0]) + 14, 0, 31), errors, 2)

        own = Place(finite(point), trail.last if continues else None)
        if continues:
            f = f32(features[0] / 1000)
            weight = f32(1 / f32(1 + f32(f * f)))
            trail.cone.learn(features, tenths(own.position[2] - z), weight)
            t = turned(own.azimuth - west.azimuth) - turned(north.azimuth - north_west.azimuth)
            c = (own.close - west.close) - (north.close - north_west.close)
            if abs(t) < 0.0008:
                self.parallax.learn([f32(c * 1e6)], f32(t * 1e6), 1.0)
            trail.last, trail.earlier = n, trail.last
        places.append(own)
        return tuple(point)
