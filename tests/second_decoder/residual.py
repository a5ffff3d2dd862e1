"""Sections 8.11 to 8.13 of FORMAT.md: contours, regions, residuals by general-purpose back-ends."""

import image as images
from back_ends import unpacked
from container import Reader
from entropy import IntegerModel, adaptive, integers, unzigzag, wrap
from errors import Refused
from models import MixedBits, ilog2
from reference import nearest

WORDS, ZIGZAG, PLANES, ESCAPE, VARINT = range(5)


class Returns:
    """Returns numbered row by row, with their neighbours; none is -1."""

    def __init__(self, image):
        self.rows = len(image)
        self.columns = len(image[0])
        self.cells = []
        self.number = [[-1] * self.columns for _ in image]
        for row, cells in enumerate(image):
            for column, filled in enumerate(cells):
                if filled:
                    self.number[row][column] = len(self.cells)
                    self.cells.append((row, column))
        n = len(self.cells)
        # One more: those of none are none.
        self.left, self.right, self.up, self.down = ([-1] * (n + 1) for _ in range(4))
        last = [-1] * self.columns
        for r, (row, column) in enumerate(self.cells):
            if r and self.cells[r - 1][0] == row:
                self.left[r] = r - 1
                self.right[r - 1] = r
            above = last[column]
            self.up[r] = above
            if above >= 0:
                self.down[above] = r
            last[column] = r

    def __len__(self):
        return len(self.cells)


class Contour:
    """8.11."""

    def __init__(self):
        self.blocks = MixedBits([128, 512, 512, 1024], 32, 0.4, 0.0, 0.005)
        self.bits = MixedBits([1024, 4096, 2048, 4096, 512, 4096], 64, 0.25, 0.0, 0.01)
        self.is_left, self.is_above, self.is_above_right, self.is_new = (adaptive(32) for _ in range(4))
        self.is_recent = adaptive(4)
        self.back = IntegerModel()

    def code(self, bits, image):
        """The region of each return."""
        returns = Returns(image)
        borders = self.borders(bits, returns)
        return self.values(bits, returns, borders)

    def borders(self, bits, returns):
        L, R, U, D = returns.left, returns.right, returns.up, returns.down
        n_blocks = (returns.columns + 3) // 4
        last = [0] * (4 * n_blocks + 8)
        above = [0] * (n_blocks + 2)
        borders = [0] * (len(returns) + 1)
        for top in range(0, returns.rows, 4):
            rows = range(top, min(top + 4, returns.rows))
            count = [0] * n_blocks
            for row in rows:
                for column, number in enumerate(returns.number[row]):
                    if number >= 0:
                        count[column // 4] += 1
            has = [0] * (n_blocks + 2)
            for b in range(n_blocks):
                if count[b] == 0:
                    has[b] = has[b - 1]
                    continue
                bit = [last[4 * b + i] if 4 * b + i >= 0 else 0 for i in range(-2, 6)]
                near = has[b - 1] | above[b] << 1 | above[b - 1] << 2 | above[b + 1] << 3
                fill = max(ilog2(count[b]), 1) - 1
                touching = bit[2] | bit[3] << 1 | bit[4] << 2 | bit[5] << 3
                before = bit[1] | bit[0] << 1
                after = bit[6] | bit[7] << 1
                places = (
                    near | fill << 4 | has[b - 2] << 6,
                    touching | before << 4 | after << 6 | has[b - 1] << 8,
                    near | min(top // 4, 31) << 4,
                    touching | near << 4 | fill << 8,
                )
                has[b] = self.blocks.code(bits, (1 if touching > 0 else 0) | near << 1, places)
            lacks = [2 * c for c in count]
            for row in rows:
                for column, r in enumerate(returns.number[row]):
                    if r < 0:
                        continue
                    b = column // 4
                    lacks[b] -= 2
                    if has[b]:

                        def gap(x, axis):
                            if x < 0:
                                return 3
                            return min(abs(returns.cells[x][axis] - returns.cells[r][axis]) - 1, 2)

                        w, n = L[r], U[r]
                        ww, nn, nw, ne = L[w], U[n], L[n], R[n]
                        nee = R[ne]
                        near = borders[w] | borders[n] << 1 | borders[nw] << 2 | borders[ne] << 3
                        straight = borders[ww] | borders[nn] << 1
                        wide = near | straight << 4 | borders[nee] << 6
                        ahead = gap(R[r], 1) | gap(D[r], 0) << 2
                        behind = gap(w, 1) | gap(n, 0) << 2
                        places = (
                            wide | borders[L[nw]] << 7 | borders[R[nn]] << 8 | borders[L[nn]] << 9,
                            near | ahead << 4 | behind << 8,
                            near | min(row, 127) << 4,
                            wide
                            | borders[L[ww]] << 7
                            | borders[U[nn]] << 8
                            | borders[R[nee]] << 9
                            | (ahead & 3) << 10,
                            near | lacks[b] << 4,
                            near | (has[b + 1] | has[b - 1] << 1) << 4 | ahead << 6 | (column % 4) << 10,
                        )
                        borders[r] = self.bits.code(bits, near | straight << 4, places)
                        if borders[r]:
                            lacks[b] |= 1
                    last[column] = borders[r]
            above = has
        return borders

    def values(self, bits, returns, borders):
        L, R, U, D = returns.left, returns.right, returns.up, returns.down
        n = len(returns)
        parent = list(range(n))

        def root(x):
            while parent[x] != x:
                parent[x] = parent[parent[x]]
                x = parent[x]
            return x

        for r in range(n):
            if not borders[r]:
                for other in (R[r], D[r]):
                    if other >= 0:
                        a, b = root(r), root(other)
                        parent[max(a, b)] = min(a, b)
        piece = [root(r) for r in range(n)]
        region_of = [0] * (n + 1)
        regions = 0
        recent = [0] * 4
        for r in range(n):
            if piece[r] != r:
                region_of[r] = region_of[piece[r]]
                continue

            def of(x):
                return region_of[piece[x]] if x >= 0 and piece[x] < r else 0

            l, a, ar, al = of(L[r]), of(U[r]), of(R[U[r]]), of(L[U[r]])
            more = any(x >= 0 and piece[x] == r for x in (R[r], D[r]))
            context = (l == a) | (a == ar) << 1 | (l == ar) << 2 | (l == al) << 3 | more << 4
            not_left = l if D[L[r]] < 0 or of(D[L[r]]) == l else 0
            not_above = a if R[U[r]] < 0 or ar == a else 0
            candidates = []
            for v in (l, a, ar):
                candidates.append(0 if v in (not_left, not_above) or v in candidates else v)
            models = self.is_left, self.is_above, self.is_above_right
            region = None
            for v, model in zip(candidates, models):
                if v > 0 and model[context].code(bits):
                    region = v
                    break
            if region is None and self.is_new[context].code(bits):
                region = regions + 1
            if region is None:
                for i in range(4):
                    v = recent[i]
                    if v > 0 and v not in candidates and v not in (not_left, not_above):
                        if self.is_recent[i].code(bits):
                            region = v
                            break
            if region is None:
                region = regions - self.back.code(bits)
            if region < 1:
                raise Refused("a region below 1")
            regions = max(regions, region)
            if region in recent:
                recent.remove(region)
            else:
                recent.pop()
            recent.insert(0, region)
            region_of[r] = region
        self.regions = regions
        return region_of[:n]


class Regions:
    """8.12."""

    def __init__(self):
        self.is_plane = adaptive(2)
        self.mean_model = IntegerModel()
        self.plane_models = integers(3)
        self.last_kind = 0
        self.mean = 0
        self.plane = [0, 0, 0]

    def code(self, bits, n):
        models = []
        for _ in range(n):
            self.last_kind = self.is_plane[self.last_kind].code(bits)
            if self.last_kind:
                for i in range(3):
                    self.plane[i] = wrap(self.plane[i] + unzigzag(self.plane_models[i].code(bits)), 32)
                models.append(tuple(self.plane))
            else:
                self.mean = wrap(self.mean + unzigzag(self.mean_model.code(bits)), 32)
                models.append(self.mean)
        return models


def region_prediction(scanner, model, row, tick):
    if isinstance(model, int):
        return model
    beam = scanner.beams[row]
    cos_a, sin_a = scanner.turned(beam, tick)
    x, y, z = cos_a * beam.cos_v, sin_a * beam.cos_v, beam.sin_v
    inverse = (model[0] * x + model[1] * y + model[2] * z) * 2.0**-22
    metres = 1 / inverse if inverse * 120 > 1 else 120.0
    return nearest(min(metres, 10.0**6), scanner)


# 8.13

BACK_ENDS = 32
def residuals(data, packing, n):
    reader = Reader(data)
    if packing == WORDS:
        found = [wrap(reader.unsigned(4), 32) for _ in range(n)]
    elif packing == ZIGZAG:
        width = reader.unsigned(1)
        found = [unzigzag(reader.unsigned(width)) for _ in range(n)]
    elif packing == PLANES:
        width = reader.unsigned(1)
        planes = [reader.take(n) for _ in range(width)]
        found = [unzigzag(sum(plane[i] << 8 * k for k, plane in enumerate(planes))) for i in range(n)]
    elif packing == ESCAPE:
        first = reader.take(n)
        found = [unzigzag(b if b < 255 else 255 + reader.varint()) for b in first]
    elif packing == VARINT:
        found = [reader.svarint() for _ in range(n)]
    else:
        raise Refused("unknown packing")
    reader.end()
    return found


def path(image):
    """The cells of returns along the snake's path."""
    for row, cells in enumerate(image):
        columns = range(len(cells))
        for column in columns if row % 2 == 0 else reversed(columns):
            if cells[column]:
                yield row, column


def predictions(scanner, parameters, image, columns, labels, models, reference):
    """The prediction of each return's range."""
    found = [[0] * len(columns) for _ in image]
    if parameters.prediction == 1:
        labels = iter(labels)
        for row, cells in enumerate(image):
            for column, filled in enumerate(cells):
                if filled:
                    tick = scanner.tick_of_column(row, columns[column])
                    found[row][column] = region_prediction(scanner, models[next(labels) - 1], row, tick)
    elif parameters.prediction == 2:
        last = 0
        for row, column in path(image):
            last = reference.moved.ranges[row][column] or reference.same.ranges[row][column] or last
            found[row][column] = last
    return found


def ranges(scanner, parameters, payload, image, columns, labels, models, reference):
    """The ranges of a frame with a residual section."""
    predicted = predictions(scanner, parameters, image, columns, labels, models, reference)
    most = (1 << 24) - 1 if scanner.range_step_um else 0x49742400
    if parameters.coder >= images.JPEG:
        residual = images.residuals(parameters.coder, payload, len(image), len(columns))
        return [
            [min(max(p + r, 1), most) if filled else 0 for filled, p, r in zip(*rows)]
            for rows in zip(image, predicted, residual)
        ]
    reader = Reader(payload)
    size = reader.varint()
    n = sum(map(sum, image))
    found = iter(residuals(unpacked(parameters.coder - BACK_ENDS, reader.rest(), size), parameters.packing, n))
    residual = [[next(found) if filled else 0 for filled in cells] for cells in image]
    if parameters.snake:
        total = 0
        for row, column in path(image):
            total = wrap(total + residual[row][column], 32)
            residual[row][column] = total
    out = []
    for rows in zip(image, predicted, residual):
        own = [wrap(p + r, 32) if filled else 0 for filled, p, r in zip(*rows)]
        if any(filled and not 1 <= v <= most for filled, v in zip(rows[0], own)):
            raise Refused("a range that is none")
        out.append(own)
    return out
