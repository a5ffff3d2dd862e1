"""Section 4 of FORMAT.md: a frame's sections in order, and what they make."""

import struct
from math import inf, isfinite, isnan, sqrt

import container as kinds
import files
import image as images
import reference as references
import residual
import sections
import tokens
import world
from back_ends import NAMES, unpacked
from channels import Beside, Channels, decompressed
from container import Reader, Unknown, crc32c
from entropy import AdaptiveBit, Bits, IntegerModel, adaptive, integers, unzigzag, wrap
from errors import NotHere, Refused
from layout import F32, PLAIN, TYPES, Field, Layout
from models import TAU, f32
from points import Points
from ranges import Deep, Mixed
from residual import BACK_ENDS
from scanner import LATTICE, MILLIMETRE, Grid, bits_of_float, float_of_bits, of_rank, rank
from trigonometry import atan2, cos, sin

OF_FORMULA, AS_FORMULA, ON_GRID = 1, 2, 3
REGIONS, INTER = 1, 2
MIXED, DEEP, LIGHT, TOKENS, FITTED_TOKENS, PACKED = range(6)


class Parameters:
    """8.10."""

    def __init__(self, payload):
        reader = Reader(payload)
        self.positions = reader.varint()
        self.max_error_um = None
        if self.positions in (AS_FORMULA, ON_GRID):
            self.max_error_um = reader.varint()
            if not 1 <= self.max_error_um <= 10**7:
                raise Refused("an impossible greatest error")
        self.intensity = reader.varint()
        if self.intensity == 2 and not 1 <= reader.varint() < 1 << 32:
            raise Refused("an impossible step of intensities")
        self.prediction = reader.varint()
        self.motion = [reader.svarint() for _ in range(6)] if self.prediction == INTER else None
        self.snake = reader.varint()
        self.coder = reader.varint()
        self.range_bits, self.bin, self.between, self.halved = 16, 1, 0, 0
        if self.coder <= PACKED:
            self.range_bits, self.bin, self.between = (reader.varint() for _ in range(3))
            self.halved = reader.varint()
            if self.halved > 1:
                raise Refused("neither halved nor whole")
            if not 16 <= self.range_bits <= 24 or not 1 <= self.bin <= 1 << 20 or self.between > 1:
                raise Refused("impossible parameters of ranges")
        elif BACK_ENDS <= self.coder < BACK_ENDS + len(NAMES):
            self.packing = reader.varint()
        elif self.coder not in (images.JPEG, images.JPEG_2000):
            raise Refused("an unknown coder")
        has_source = reader.varint()
        if has_source:
            for _ in range(4):
                reader.varint()
        reader.end()
        if self.positions > ON_GRID or self.intensity > 2 or self.prediction > INTER or self.snake > 1 or has_source > 1:
            raise Refused("unknown parameters")

    @property
    def is_tokens(self):
        return self.coder in (TOKENS, FITTED_TOKENS, PACKED)

    @property
    def is_light(self):
        """Whether all but the ranges is as `light` has it."""
        return self.coder == LIGHT or self.coder >= BACK_ENDS


class Returns:
    """What the images of a track, or one half of them, have taught: 8.3, 8.5 and 8.6."""

    def __init__(self):
        self.occupancy = sections.Occupancy()
        self.token_occupancy = tokens.Occupancy()
        self.off_grid = sections.OffGrid()
        self.intensity = sections.Intensity(self.off_grid)
        self.made = {}

    def model(self, make, *arguments):
        """A model that few frames need, made when the first does."""
        key = make, arguments
        if key not in self.made:
            self.made[key] = make(*arguments)
        return self.made[key]

    def intensities(self, payload, parameters, image, strays, seen):
        """Of the cells and of the strays, and context levels."""
        if parameters.is_tokens:
            make = tokens.PackedIntensity if parameters.coder == PACKED else tokens.Intensity
            return self.model(make).code(Reader(payload), image, strays)
        bits = Bits(payload)
        scale = sections.Scale(bits.plain)
        if not scale.per_unit:
            return self.rough_intensities(bits, image, strays)
        if parameters.coder == DEEP:
            model = self.model(sections.DeepIntensity, self.off_grid)
        else:
            model = self.intensity
        return model.code(bits, scale, image, strays, seen)

    def rough_intensities(self, bits, image, strays):
        """8.5, without a grid."""
        are_shared = bits.plain(1)
        cells = [(row, column) for row, own in enumerate(image) for column, filled in enumerate(own) if filled]
        coded = [n for n, (_, _, is_repeat) in enumerate(strays) if not (are_shared and is_repeat)]
        rows = [row + 1 for row, _ in cells] + [0 if cells else strays[n][0] for n in coded]
        columns = [column + 1 for _, column in cells] + [0] * len(coded)
        model = self.model(Channels)
        (data,) = model.code(bits, [Field("", F32, 1)], len(rows), Beside(rows, columns))
        found = struct.unpack(f"<{len(rows)}I", data)
        values = [[0] * len(own) for own in image]
        for (row, column), value in zip(cells, found):
            values[row][column] = value
        of_strays = [0] * len(strays)
        for n, value in zip(coded, found[len(cells) :]):
            of_strays[n] = value
        if are_shared:
            for n, (_, before, is_repeat) in enumerate(strays):
                if is_repeat:
                    of_strays[n] = of_strays[before]
        return values, of_strays, [[1] * len(own) for own in image]

    def ranges(self, payload, parameters, image, levels, seen):
        coder = parameters.coder
        if coder in (MIXED, DEEP):
            model = self.model(Mixed if coder == MIXED else Deep)
            return model.code(Bits(payload), image, levels, parameters, seen)
        if coder == PACKED:
            model = self.model(tokens.PackedRange)
        else:
            model = self.model(tokens.Range, coder != TOKENS)
        return model.code(Reader(payload), image, levels, parameters, seen)


class Decoder:
    """The frames of one track of a group, in order."""

    def __init__(self, scanner):
        if isinstance(scanner, Unknown):
            raise NotHere(f"scanners of family {scanner.family}")
        self.scanner = scanner
        self.sizes, self.zeros = IntegerModel(), IntegerModel()
        self.bytes = sections.ByteModel()
        self.layout = None
        self.columns = scanner.new_columns() if scanner else None
        self.points = Points()
        self.points_are_compressed = AdaptiveBit()
        self.returns = [Returns(), Returns()]
        self.correction = sections.Correction()
        self.token_correction = tokens.Correction()
        self.blanks = sections.Blanks()
        self.echoes = sections.Echoes()
        self.order = sections.Order()
        self.channels = Channels()
        self.contour = residual.Contour()
        self.regions = residual.Regions()
        self.past = None

    def is_next(self, kind):
        return bool(self.sections) and self.sections[0][0] == kind

    def next_section(self, kind):
        if not self.is_next(kind):
            raise Refused(f"section {kind} is missing, or others stand in its place")
        return self.sections.pop(0)[1]

    def bits(self, kind):
        return Bits(self.next_section(kind))

    def frame(self, frame):
        """The file of a frame."""
        self.sections = list(frame.sections)
        parameters = Parameters(self.next_section(kinds.PARAMETERS))
        if self.is_next(kinds.BYTES):
            file = whole_file(Reader(self.next_section(kinds.BYTES)), frame.point_count)
        else:
            file = self.file(parameters, frame.point_count)
        if self.sections:
            raise Refused("a section too many")
        if len(file) != frame.file_size or crc32c(file) != frame.file_crc:
            raise Refused("the file is not the one that was encoded")
        return file

    def bytes_without_zeros(self, bits):
        length = self.sizes.code(bits)
        zeros = self.zeros.code(bits) if length else 0
        if zeros > length:
            raise Refused("more zeros than bytes")
        return self.bytes.code(bits, length - zeros) + bytes(zeros)

    def file(self, parameters, point_count):
        bits = self.bits(kinds.FILE)
        layout, prefix, suffix = (self.bytes_without_zeros(bits) for _ in range(3))
        if layout:
            self.layout = Layout(layout)
        layout = self.layout
        if layout is None:
            raise Refused("there is no layout before")
        records, strays = self.sizes.code(bits), self.sizes.code(bits)
        if records != point_count or strays > records or records and not layout.stride:
            raise Refused("numbers of points that do not agree")
        if records > strays and not (self.scanner and layout.position):
            raise Refused("returns without a scanner or a position")

        beside = self.points_of(layout, parameters, records, strays)
        channels = []
        if records and layout.channels:
            channels = self.channels.code(self.bits(kinds.CHANNELS), layout.channels, records, beside)
        positions = beside.positions
        if self.is_next(kinds.COMPENSATION):
            positions = compensated(Reader(self.next_section(kinds.COMPENSATION)), positions)
        elif self.is_next(kinds.WORLD):
            positions = world.moved(Reader(self.next_section(kinds.WORLD)), positions)
        elif self.is_next(kinds.STAMPED):
            fields = list(zip(layout.channels, channels))
            positions = moved_by_stamps(Reader(self.next_section(kinds.STAMPED)), positions, fields)
        if self.scanner:
            positions = [along_axes_of_file(position, *self.scanner.orientation) for position in positions]
        found = files.records_of(layout, records, positions, beside.intensities, channels)
        if self.is_next(kinds.SORTED):
            payload = Reader(self.next_section(kinds.SORTED))
            number = payload.varint()
            payload.end()
            if number >= len(channels):
                raise Refused("no channel of the frame")
            order, stride = in_sorted_order(channels[number], layout.channels[number].width), layout.stride
            found = b"".join(found[record * stride : (record + 1) * stride] for record in order)
        return files.file_of(layout, prefix, found, suffix)

    def points_of(self, layout, parameters, records, strays):
        """What there is of rows, columns, positions and intensities, in the order of the file."""
        inside = records - strays
        scanner = self.scanner
        image, columns, seen = [], [], None
        blanks = []
        if inside:
            columns, is_full = self.columns.code(self.bits(kinds.COLUMNS), scanner)
            if parameters.prediction == INTER:
                if self.past is None:
                    raise Refused("a frame is predicted from none")
                seen = references.Reference(
                    scanner, self.past, columns, parameters.motion, parameters.coder == LIGHT
                )
            image = self.occupied(parameters, columns, seen)
            if is_full:
                blanks = [(row, n) for row, cells in enumerate(image) for n, filled in enumerate(cells) if not filled]
            in_image = sum(map(sum, image)) + len(blanks)
            if in_image > inside or is_full and in_image < inside:
                raise Refused("the range image does not hold as many points as it should")

        of_strays, around = [], [(0, index - 1 if index else None, False) for index in range(strays)]
        if strays and layout.position:
            grid = None
            if parameters.max_error_um:
                grid = Grid(LATTICE, float(parameters.max_error_um * 1140) * 1e-9)
            of_strays, around = self.strays(strays, grid, around)
        stray_rows = [row for row, _, _ in around]
        around += [(0, index - 1 if index else None, False) for index in range(strays, strays + len(blanks))]
        found = self.values(parameters, layout, image, columns, around, seen)
        values, values_of_strays, levels, ranges = found
        for (row, column), value in zip(blanks, values_of_strays[strays:]):
            values[row][column] = value
        values_of_strays = values_of_strays[:strays]
        if inside:
            if parameters.coder >= BACK_ENDS:
                ranges = self.residuals(parameters, image, columns, seen)
            if not parameters.is_tokens and len(image) * len(columns) <= 1 << 22:
                self.past = references.Past(columns, ranges, levels)
        elements = scanner.in_canonical_order(ranges, columns, is_full) if inside else []
        echoes = {}
        if inside and in_image < inside:
            known = values if layout.intensity and parameters.intensity else None
            echoes = self.echoes.code(self.bits(kinds.ECHOES), inside - in_image, image, ranges, known)
            elements = [
                element
                for row, column, tick, steps in elements
                for element in [(row, column, tick, steps)]
                + [(row, column, tick, range_) for range_, _ in echoes.get((row, column), [])]
            ]
        stray_places, moved, move_places = range(inside, records), [], []
        positions = []
        if inside:
            positions = self.positions(parameters, elements)
            if parameters.positions != OF_FORMULA:
                stray_places, moved, move_places = self.order.code(self.bits(kinds.ORDER), records, strays)
        is_moved = set(moved)
        sequence = sections.placed(
            inside, zip(move_places, moved), (e for e in range(inside) if e not in is_moved)
        )
        sequence = sections.placed(records, zip(stray_places, range(inside, records)), sequence)

        def in_order(of_image, of_strays):
            values = of_image + of_strays
            return [values[e] for e in sequence]

        beside = Beside()
        if inside:
            beside.rows = in_order([row + 1 for row, _, _, _ in elements], [0] * strays)
            beside.columns = in_order([column + 1 for _, column, _, _ in elements], [0] * strays)
            if scanner.is_of_firings:
                beside.ticks = in_order([tick for _, _, tick, _ in elements], [0] * strays)
                beside.steps = in_order([steps for _, _, _, steps in elements], [0] * strays)
                beside.range_step_m, beside.tick_degrees = scanner.range_step, scanner.tick_degrees
        elif any(stray_rows):
            beside.rows, beside.columns = stray_rows, [0] * strays
        if layout.position:
            beside.positions = in_order(positions, of_strays)
        if layout.intensity:
            of_image, before = [], None
            for row, column, _, _ in elements:
                if (row, column) == before:
                    of_image.append(next(rest))
                else:
                    of_image.append(values[row][column])
                    rest = (value for _, value in echoes.get((row, column), []))
                before = row, column
            beside.intensities = in_order(of_image, values_of_strays)
        return beside

    def strays(self, n, grid, around):
        """8.4: positions, and what is around each, which is `around` if they are compressed."""
        bits = self.bits(kinds.STRAYS)
        if not self.points_are_compressed.code(bits):
            return self.points.code(bits, n, grid)
        values = decompressed(bits, F32, 12, n)
        return list(struct.iter_unpack("<3I", values)), around

    def halves(self, parameters):
        """4.4: the rows that are coded apart."""
        middle = (self.scanner.rows + 1) // 2
        return [range(middle), range(middle, self.scanner.rows)] if parameters.halved else [range(self.scanner.rows)]

    def occupied(self, parameters, columns, seen):
        image = []
        for model, rows in zip(self.returns, self.halves(parameters)):
            payload = self.next_section(kinds.OCCUPANCY)
            if parameters.is_tokens:
                image += model.token_occupancy.code(Reader(payload), len(rows), len(columns))
            else:
                of_rows = seen and seen.part(slice(rows.start, rows.stop))
                image += model.occupancy.code(Bits(payload), len(rows), len(columns), parameters.is_light, of_rows)
        return image

    def values(self, parameters, layout, image, columns, strays, seen):
        """4.4: intensities of the cells, of strays and blanks, context levels and ranges."""
        parts = [(rows, []) for rows in self.halves(parameters)] if image else [(range(0), [])]
        parts[-1] = parts[-1][0], strays
        found = []
        for model, (rows, strays) in zip(self.returns, parts):
            rows = slice(rows.start, rows.stop)
            known = image[rows], columns, seen and seen.part(rows)
            found.append(self.values_of_part(model, parameters, layout, known, strays))
        return tuple(sum(of_parts, []) for of_parts in zip(*found))

    def values_of_part(self, model, parameters, layout, known, strays):
        image, columns, seen = known
        values, levels = ([[0] * len(columns) for _ in image] for _ in range(2))
        of_strays, ranges = [0] * len(strays), []
        if layout.intensity and parameters.intensity:
            payload = self.next_section(kinds.INTENSITY)
            values, of_strays, levels = model.intensities(payload, parameters, image, strays, seen)
        if image and parameters.coder < BACK_ENDS:
            ranges = model.ranges(self.next_section(kinds.RANGE), parameters, image, levels, seen)
        return values, of_strays, levels, ranges

    def residuals(self, parameters, image, columns, seen):
        labels = models = None
        if parameters.prediction == REGIONS:
            if not self.scanner.has_surfaces:
                raise Refused("regions, which only scanners of the family hdl64 have")
            labels = self.contour.code(self.bits(kinds.CONTOUR), image)
            models = self.regions.code(self.bits(kinds.REGIONS), self.contour.regions)
        payload = self.next_section(kinds.RESIDUAL)
        return residual.ranges(self.scanner, parameters, payload, image, columns, labels, models, seen)

    def positions(self, parameters, elements):
        """Those of returns and blanks, in canonical order."""
        is_blank = [steps == 0 for _, _, _, steps in elements]
        returns = iter(self.positions_of_returns(parameters, [e for e in elements if e[3]]))
        blanks = iter(())
        if any(is_blank):
            formulas = [
                sections.rounded(self.scanner.expected_position(row, tick, 0, 0))
                for row, _, tick, steps in elements
                if not steps
            ]
            blanks = iter(self.blanks.code(self.bits(kinds.BLANKS), formulas))
        return [next(blanks if blank else returns) for blank in is_blank]

    def positions_of_returns(self, parameters, elements):
        scanner = self.scanner
        formulas = [
            scanner.expected_position(row, tick, steps, parameters.between) for row, _, tick, steps in elements
        ]
        if parameters.positions == OF_FORMULA:
            return [sections.rounded(formula) for formula in formulas]
        payload = self.next_section(kinds.CORRECTION)
        grid = scanner.grid
        if parameters.is_tokens or parameters.is_light and grid.kind == MILLIMETRE:
            return self.token_correction.code(Reader(payload), grid, parameters.positions, formulas)
        return self.correction.code(Bits(payload), grid, parameters.positions, formulas)


def read_motion(reader):
    motion = struct.unpack("<6d", reader.take(48))
    if not all(abs(v) <= most for v, most in zip(motion, [8.0] * 3 + [1e6] * 3)):
        raise Refused("a motion that is none")
    return motion


def mover(motion):
    """Where a part of the motion takes a point."""
    rx, ry, rz, tx, ty, tz = motion
    angle = sqrt(rx * rx + ry * ry + rz * rz)
    kx, ky, kz = (rx / angle, ry / angle, rz / angle) if angle else (0.0, 0.0, 0.0)

    def moved(position, part):
        x, y, z = map(float_of_bits, position)
        s = part(y, x)
        sn, cs = sin(s * angle), cos(s * angle)
        along = (kx * x + ky * y + kz * z) * (1 - cs)
        now = (
            (x * cs + (ky * z - kz * y) * sn + kx * along) + s * tx,
            (y * cs + (kz * x - kx * z) * sn + ky * along) + s * ty,
            (z * cs + (kx * y - ky * x) * sn + kz * along) + s * tz,
        )
        if any(map(isnan, (x, y, z, *now))):
            return position
        return tuple(bits_of_float(f32(v)) for v in now)

    return moved


def put_right(position, units):
    return tuple(of_rank(wrap(rank(v) + u, 64)) for v, u in zip(position, units))


def compensated(reader, positions):
    """8.15."""
    moved = mover(read_motion(reader))
    misses = {}
    following = 0
    while not reader.at_end():
        place = following + reader.varint()
        misses[place] = [reader.svarint() for _ in range(3)]
        following = place + 1
    if following > len(positions):
        raise Refused("a miss of a point that is none")
    now = [moved(position, lambda y, x: atan2(y, x) / TAU) for position in positions]
    for place, units in misses.items():
        now[place] = put_right(now[place], units)
    return now


def moved_by_stamps(reader, positions, channels):
    """8.15, by time stamps: `channels` are their fields and bytes."""
    number, moment = reader.varint(), reader.varint()
    if number >= len(channels) or channels[number][0].count != 1 or moment > 2:
        raise Refused("no channel of time stamps, or an unknown moment")
    moved = mover(read_motion(reader))
    field, data = channels[number]
    times = [time for (time,) in struct.iter_unpack("<" + TYPES[field.kind], data)]
    first = min((time for time in times if isfinite(time)), default=inf)
    since = [float(time - first) for time in times]
    span = max((time for time in since if isfinite(time)), default=0.0)
    bits = Bits(reader.rest())
    is_missed, of_units = [adaptive(3), adaptive(3)], [integers(16) for _ in range(3)]
    missed = 0
    found = []
    for position, time in zip(positions, since):
        s = (time - span, time, time)[moment] / span if span else 0.0
        if moment == 2 and span:
            s -= 0.5
        s = s + 0.0 if isfinite(s) else 0.0
        position = moved(position, lambda y, x: s)
        classes = [min(max((v >> 23 & 255) - 116, 0), 15) for v in position]
        miss = is_missed[0 in classes][missed.bit_count()].code(bits)
        missed = (missed * 2 + miss) % 4
        if miss:
            units = [unzigzag(models[e].code(bits)) for models, e in zip(of_units, classes)]
            position = put_right(position, units)
        found.append(position)
    return found


def along_axes_of_file(position, axes, reversed_axes):
    """3.1; values are bits of float32."""
    of_file = [None] * 3
    for axis, value, is_reversed in zip(axes, position, reversed_axes):
        of_file[axis] = value ^ is_reversed << 31
    return of_file


def in_sorted_order(values, width):
    """8.21: the records by their numbers in the order of arrival."""
    keys = [0]
    for at in range(width, len(values), width):
        keys.append(keys[-1] + (values[at : at + width] != values[at - width : at]))
    a = list(range(len(keys)))

    def divide(begin, end, depth):
        while end - begin > 16 and depth > 0:
            depth -= 1
            p, q, r = places = begin + 1, begin + (end - begin) // 2, end - 1
            b, c, d = (keys[a[place]] for place in places)
            if b < c:
                median = q if c < d else r if b < d else p
            else:
                median = p if b < d else r if c < d else q
            a[begin], a[median] = a[median], a[begin]
            key, i, j = keys[a[begin]], begin + 1, end
            while True:
                while keys[a[i]] < key:
                    i += 1
                j -= 1
                while key < keys[a[j]]:
                    j -= 1
                if i >= j:
                    break
                a[i], a[j] = a[j], a[i]
                i += 1
            divide(i, end, depth)
            end = i

    divide(0, len(a), 2 * (len(a).bit_length() - 1))
    return sorted(a, key=keys.__getitem__)


def whole_file(reader, point_count):
    """8.18."""
    backend = reader.unsigned(1)
    layout = reader.take(reader.varint())
    prefix, size = reader.varint(), reader.varint()
    file = unpacked(backend, reader.rest(), size)
    if layout:
        layout = Layout(layout)
        if layout.wrapping != PLAIN or not layout.stride or prefix + point_count * layout.stride > size:
            raise Refused("records that are not in the file")
    return file
