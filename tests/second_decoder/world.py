"""Section 8.15 of FORMAT.md, through a map: points that went from the scanner to a map and back."""

import struct
from math import isnan, sqrt

from entropy import AdaptiveBit, Bits, adaptive, integers, unzigzag, wrap
from errors import Refused
from models import f32
from scanner import bits_of_float, float_of_bits, of_rank, rank
from trigonometry import cos, sin

SLOTS = 32


def rotation(a):
    ax, ay, az = a
    angle = sqrt(ax * ax + ay * ay + az * az)
    x, y, z = (v / angle for v in a) if angle else (0.0, 0.0, 0.0)
    s, c = sin(angle), cos(angle)
    r = 1 - c
    return (
        (c + x * x * r, x * y * r - z * s, x * z * r + y * s),
        (y * x * r + z * s, c + y * y * r, y * z * r - x * s),
        (z * x * r - y * s, z * y * r + x * s, c + z * z * r),
    )


def product(matrix, v):
    return tuple(row[0] * v[0] + row[1] * v[1] + row[2] * v[2] for row in matrix)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def bounded(v, most):
    if v > most:
        raise Refused("a map that is none")
    return v


def exponent(v):
    return v >> 23 & 255


class World:
    def __init__(self, reader, records):
        firings = -(-records // SLOTS)
        values = struct.unpack("<6d", reader.take(48))
        if not all(abs(v) <= most for v, most in zip(values, [8.0] * 3 + [1e9] * 3)):
            raise Refused("a map that is none")
        self.axes = rotation(values[:3])
        self.back = tuple(zip(*self.axes))
        self.origin = values[3:]
        self.steps = [2.0 ** (1 - e) if e else 0.0 for e in (bounded(reader.varint(), 61) for _ in range(2))]
        border, short = (bounded(reader.varint(), 4096) for _ in range(2))
        self.last = [0] * 6
        poses = [self.pose(reader) for _ in range(min(firings, border + 1))]
        count = bounded(reader.varint(), 4096)
        knots, time = [], 0
        for number in range(count):
            later = reader.varint()
            time = bounded(time + later, 1 << 31)
            if number and not later:
                raise Refused("knots out of order")
            knots.append((time * 0.25, self.pose(reader)))
        if count < 2:
            raise Refused("a path without an end")
        poses += self.path(knots, firings, border, short)
        self.movers = [self.mover(place, turn) for place, turn in poses]

    def pose(self, reader):
        self.last = [wrap(v + reader.svarint(), 64) for v in self.last]
        if max(map(abs, self.last)) > 1 << 45:
            raise Refused("a pose too far away")
        return [v * 2.0**-30 for v in self.last[:3]], [v * 2.0**-36 for v in self.last[3:]]

    def path(self, knots, firings, border, short):
        lever = product(self.back, (0.0, 0.0, self.origin[2]))
        time, piece = 0.0, 0
        for firing in range(firings):
            if firing > border:
                while piece + 2 < len(knots) and knots[piece + 1][0] <= time:
                    piece += 1
                (start, a), (end, b) = knots[piece : piece + 2]
                part = (time - start) / (end - start)
                place, turn = (
                    [v * (1 - part) + w * part for v, w in zip(of_a, of_b)] for of_a, of_b in zip(a, b)
                )
                rate = [(w - v) / (end - start) for v, w in zip(a[1], b[1])]
                bend = cross(rate, cross(rate, lever))
                sag = -0.5 * (time - start) * (end - time)
                yield [v + w * sag for v, w in zip(place, bend)], turn
            packet, rest = divmod(firing - border, 12)
            is_late = firing >= border and not rest and (packet < short or (packet - short) % 25 != 0)
            time = time + 46 + (1 if is_late else 0)

    def mover(self, place, turn):
        columns = [product(self.axes, column) for column in zip(*rotation(turn))]
        shift = product(self.axes, place)
        return tuple(zip(*columns)), [v + o for v, o in zip(shift, self.origin)]

    def on_map(self, record, position):
        matrix, shift = self.movers[record // SLOTS]
        return [f32(v + s) for v, s in zip(product(matrix, [*map(float_of_bits, position)]), shift)]

    def in_file(self, g, steps, position):
        g = (g[0] + steps[0] * self.steps[0], g[1] + steps[1] * self.steps[1], g[2])
        v = [f32(x) for x in product(self.back, [x - o for x, o in zip(g, self.origin)])]
        return position if any(map(isnan, v)) else tuple(map(bits_of_float, v))


def moved(reader, positions):
    world = World(reader, len(positions))
    bits = Bits(reader.rest())
    again = AdaptiveBit()
    is_missed = [adaptive(3), adaptive(3)]
    of_steps = integers(2)
    of_units = [integers(16) for _ in range(3)]
    missed, last = 0, None
    found = []
    for record, position in enumerate(positions):
        if record % SLOTS == 0:
            last = None
        none = all(v & 0x7FFFFFFF == 0 for v in position)
        g = world.on_map(record, position)
        if none and last and again.code(bits):
            steps, units = last
        else:
            steps, units = [0, 0], [0, 0, 0]
            if is_missed[none][missed.bit_count()].code(bits):
                for axis in range(2):
                    if world.steps[axis]:
                        steps[axis] = unzigzag(of_steps[axis].code(bits))
                start = world.in_file(g, steps, position)
                for axis in range(3):
                    model = of_units[axis][min(max(exponent(start[axis]) - 116, 0), 15)]
                    units[axis] = unzigzag(model.code(bits))
            missed = (missed * 2 + (1 if any(steps) or any(units) else 0)) % 4
            if none:
                last = steps, units
        position = world.in_file(g, steps, position)
        if any(units):
            position = tuple(of_rank(wrap(rank(v) + u, 64)) for v, u in zip(position, units))
        found.append(position)
    return found
