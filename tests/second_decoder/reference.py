"""Section 4.3 of FORMAT.md: what the frame before lets expect of this one."""

from bisect import bisect_left
from copy import copy
from math import sqrt

from models import TAU
from scanner import small_atan
from trigonometry import atan2, cos, sin


def nearest(metres, scanner):
    """`nearest` of 8.12: the steps of a range in metres."""
    if scanner.range_step_um == 0:
        from models import f32
        from scanner import bits_of_float

        return bits_of_float(f32(metres))
    return min(round(metres * (10**6 / scanner.range_step_um)), (1 << 24) - 1)


class Past:
    """A range image with the context levels of its intensities: lists of rows; range 0 where there is no return."""

    def __init__(self, columns, ranges, levels):
        self.columns = columns
        self.ranges = ranges
        self.levels = levels


class Layer:
    """Ranges and levels of each cell, 0: nothing."""

    def __init__(self, rows, columns):
        self.ranges = [[0] * columns for _ in range(rows)]
        self.levels = [[0] * columns for _ in range(rows)]


    def part(self, rows):
        layer = Layer(0, 0)
        layer.ranges, layer.levels = self.ranges[rows], self.levels[rows]
        return layer


class Reference:
    def __init__(self, scanner, past, columns, motion, is_still_empty):
        if scanner.is_of_firings:
            self.same = self.moved = layer_of_nearest(scanner, past, columns)
            return
        self.same = same_layer(scanner, past, columns)
        if is_still_empty and not any(motion):
            self.moved = Layer(scanner.rows, len(columns))
        else:
            self.moved = moved_layer(scanner, past, columns, motion)

    def part(self, rows):
        """Some rows of both layers."""
        part = copy(self)
        part.same, part.moved = self.same.part(rows), self.moved.part(rows)
        return part


def layer_of_nearest(scanner, past, columns):
    """The layer of family `firings`."""
    layer = Layer(scanner.rows, len(columns))
    first = {}
    for number, column in enumerate(past.columns):
        first.setdefault(column.tick, number)
    ticks = sorted(first)
    gaps = sorted(b - a for a, b in zip(ticks, ticks[1:]))
    reach = gaps[len(gaps) // 2] if gaps else 0

    def apart(a, b):
        return min(abs(a - b), scanner.ticks - abs(a - b))

    for number, column in enumerate(columns):
        if not ticks:
            break
        after = bisect_left(ticks, column.tick)
        near = min(ticks[after - 1], ticks[after % len(ticks)], key=lambda tick: apart(tick, column.tick))
        if apart(near, column.tick) <= reach:
            at = first[near]
            for row in range(scanner.rows):
                layer.ranges[row][number] = past.ranges[row][at]
                layer.levels[row][number] = past.levels[row][at]
    return layer


def same_layer(scanner, past, columns):
    layer = Layer(scanner.rows, len(columns))
    before = past.columns
    at = 0
    for column, tick in enumerate(columns):
        while at + 1 < len(before) and abs(before[at + 1] - tick) <= abs(before[at] - tick):
            at += 1
        if before and abs(before[at] - tick) <= 2:
            for row in range(scanner.rows):
                layer.ranges[row][column] = past.ranges[row][at]
                layer.levels[row][column] = past.levels[row][at]
    return layer


def turns(scanner, width):
    ticks = scanner.ticks
    return [(b.column_shift % ticks * width + ticks // 2) // ticks % width for b in scanner.beams]


def sub(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def surfels(scanner, past):
    """(row, position, normal, level) of each return of the past."""
    width = len(past.columns)
    turn = turns(scanner, width)
    points = []
    metres = []
    for row, ranges in enumerate(past.ranges):
        points.append([None] * width)
        metres.append([0.0] * width)
        for column, steps in enumerate(ranges):
            if steps:
                tick = scanner.tick_of_column(row, past.columns[column])
                points[row][column] = scanner.point(row, tick, steps)
                metres[row][column] = scanner.metres(steps)
    for row in range(scanner.rows):
        for column in range(width):
            p = points[row][column]
            if p is None:
                continue
            m = metres[row][column]

            def counts(r, c, gap):
                return 0 <= r < scanner.rows and 0 <= c < width and points[r][c] and abs(metres[r][c] - m) < gap

            def beside(step):
                for c in (column + 2 * step, column + step):
                    if counts(row, c, 0.2 + 0.03 * m):
                        return points[row][c]
                return None

            def across_to(r):
                if not 0 <= r < scanner.rows:
                    return None
                c = (column + width - turn[row] + turn[r]) % width
                return (points[r][c], metres[r][c]) if counts(r, c, 0.3 + 0.15 * m) else None

            left, right = beside(-1), beside(1)
            if left and right:
                along = sub(right, left)
            elif left:
                along = sub(p, left)
            elif right:
                along = sub(right, p)
            else:
                along = None
            above, below = across_to(row - 1), across_to(row + 1)
            if above and (not below or abs(above[1] - m) < abs(below[1] - m)):
                across = sub(p, above[0])
            elif below:
                across = sub(below[0], p)
            else:
                across = None
            normal = (0.0, 0.0, 0.0)
            if along and across:
                a, b = along, across
                normal = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
            yield row, p, normal, past.levels[row][column]


def moved_layer(scanner, past, columns, motion):
    rows, width = scanner.rows, len(columns)
    ticks = scanner.ticks
    (sy, cy), (sp, cp), (sr, cr) = [(sin(v * 2.0**-17), cos(v * 2.0**-17)) for v in motion[:3]]
    c = [v * 2.0**-12 for v in motion[3:]]
    rotation = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    column_of = {tick: column for column, tick in enumerate(columns)}
    near_column = {}
    for tick in range(ticks):
        if tick in column_of:
            near_column[tick] = column_of[tick]
        else:
            both = [column_of[t] for t in ((tick - 1) % ticks, (tick + 1) % ticks) if t in column_of]
            near_column[tick] = min(both) if both else None

    def extended(seen, row, column):
        metres, position, normal = seen[:3]
        tick = scanner.tick_of_column(row, columns[column])
        beam = scanner.beams[row]
        q = scanner.point_at(row, tick, metres)
        cos_a, sin_a = scanner.turned(beam, tick)
        u = cos_a * beam.cos_v, sin_a * beam.cos_v, beam.sin_v
        slope = dot(normal, u)
        if slope == 0:
            return None
        further = dot(normal, sub(position, q)) / slope
        return metres + further if abs(further) < 0.2 * metres else None

    cells = [[None] * width for _ in range(rows)]
    beams = scanner.beams
    for hint, p, n, level in surfels(scanner, past):
        position = x, y, z = tuple(r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + t for r, t in zip(rotation, c))
        normal = tuple(r[0] * n[0] + r[1] * n[1] + r[2] * n[2] for r in rotation)
        rho = sqrt(x * x + y * y)

        def miss(row):
            if not 0 <= row < rows:
                return float("inf")
            b = beams[row]
            return abs((rho - b.b) * (b.sin_v / b.cos_v) + b.c - z)

        row = hint
        while miss(row + 1) < miss(row):
            row += 1
        while miss(row - 1) < miss(row):
            row -= 1
        beam = beams[row]
        metres = (rho - beam.b) * beam.cos_v + (z - beam.c) * beam.sin_v
        if not 0.5 < metres < 10**6:
            continue
        tick = (atan2(y, x) - small_atan(beam.h / rho) - beam.rot) * (ticks / TAU)
        if not abs(tick) < 1e9:
            continue
        whole = round(tick)
        column = near_column[(whole + beam.column_shift) % ticks]
        if column is None:
            continue
        off = miss(row) / metres + abs(tick - whole) * (TAU / ticks)
        found = metres, position, normal, level
        new = extended(found, row, column)
        if new is None:
            new = metres
        before = cells[row][column]
        if before is not None:
            closer = new - before[0]
            if not (closer < -0.05 * new or closer < 0.05 * new and off < before[1]):
                continue
        cells[row][column] = new, off, (new, position, normal, level)

    layer = Layer(rows, width)
    turn = turns(scanner, width)
    for row in range(rows):
        for column in range(width):
            cell = cells[row][column]
            if cell is not None:
                metres, level = cell[0], cell[2][3]
            else:
                near = [(row, (column - 1) % width), (row, (column + 1) % width)]
                for r in (row - 1, row + 1):
                    if 0 <= r < rows:
                        near.append((r, (column + width - turn[row] + turn[r]) % width))
                metres = None
                for r, c in near:
                    if cells[r][c] is not None:
                        there = extended(cells[r][c][2], row, column)
                        if there is not None and (metres is None or there < metres):
                            metres, level = there, cells[r][c][2][3]
                if metres is None:
                    continue
            layer.ranges[row][column] = max(nearest(metres, scanner), 1)
            layer.levels[row][column] = level
    return layer
