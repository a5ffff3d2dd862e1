"""Section 2 of FORMAT.md: varints, checksums, records, groups, frames, sections, the index."""

from errors import Refused
from firings import Scanner as Firings
from scanner import Scanner as Hdl64

MAGIC = b"\x89LPC"
VERSION = 1

SCANNER, GROUP, INDEX, END = 1, 2, 3, 4
# The kind of a file beside the scans, 2.5.
BESIDE = 3
SKIPPABLE = 0x80

FILE, COLUMNS, OCCUPANCY, RANGE, CORRECTION, INTENSITY, ORDER, STRAYS, CHANNELS, PARAMETERS = range(1, 11)
CONTOUR, REGIONS, RESIDUAL, COMPENSATION, BYTES, BLANKS, WORLD, ECHOES, SORTED, STAMPED = range(11, 21)

FAMILIES = {1: Hdl64, 2: Firings}
AXES = (0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)


def _crc_table():
    table = []
    for i in range(256):
        for _ in range(8):
            i = i >> 1 ^ (0x82F63B78 if i & 1 else 0)
        table.append(i)
    return table


_CRC = _crc_table()


def crc32c(data):
    crc = 0xFFFFFFFF
    table = _CRC
    for byte in data:
        crc = table[(crc ^ byte) & 255] ^ crc >> 8
    return crc ^ 0xFFFFFFFF


class Reader:
    """Reads fields from bytes."""

    def __init__(self, data, at=0, end=None):
        self.data = data
        self.at = at
        self.limit = len(data) if end is None else end

    def take(self, n):
        if n > self.limit - self.at:
            raise Refused("the data end early")
        at = self.at
        self.at = at + n
        return self.data[at : at + n]

    def rest(self):
        return self.take(self.limit - self.at)

    def at_end(self):
        return self.at == self.limit

    def end(self):
        if self.at != self.limit:
            raise Refused("bytes follow where nothing should")

    def unsigned(self, n):
        return int.from_bytes(self.take(n), "little")

    def varint(self):
        value = 0
        shift = 0
        while True:
            byte = self.unsigned(1)
            value |= (byte & 127) << shift
            if byte < 128:
                break
            shift += 7
        if value >> 64 or shift > 63 or (byte == 0 and shift > 0):
            raise Refused("a varint is too long")
        return value

    def svarint(self):
        c = self.varint()
        return (c >> 1) ^ -(c & 1)

    def block(self):
        """A record (2.2) or a section (2.6): kind, payload, checksum."""
        start = self.at
        kind = self.unsigned(1)
        payload = self.take(self.varint())
        crc = crc32c(self.data[start : self.at])
        if self.unsigned(4) != crc:
            raise Refused("a checksum does not match")
        return kind, payload, crc


def stamp(reader):
    """Of a frame, in its header and in the index: kind, track, time_source, time."""
    kind, track, time_source = reader.varint(), reader.varint(), reader.varint()
    if kind > BESIDE or track > 254 or time_source > 3:
        raise Refused("an unknown kind, track or source of time")
    return kind, track, time_source, reader.svarint() if time_source else None


class Frame:
    """2.5."""

    def __init__(self, reader, scanner_count):
        start = reader.at
        length = reader.varint()
        if length > 4095:
            raise Refused("a name is too long")
        self.name = str(reader.take(length), "utf-8")
        self.stamp = stamp(reader)
        self.track = self.stamp[1]
        if self.track >= scanner_count:
            raise Refused("a frame of a track that its group does not have")
        self.file_size = reader.varint()
        self.file_crc = reader.unsigned(4)
        self.point_count = reader.varint()
        self.sections = []
        self.allowance = 65536
        for _ in range(reader.varint()):
            kind, payload, _ = reader.block()
            self.allowance += 1024 * len(payload)
            if kind < SKIPPABLE:
                self.sections.append((kind, payload))
        if max(self.file_size, self.point_count) > self.allowance:
            raise Refused("a frame too short for its file")
        self.size = reader.at - start


class Group:
    """2.4."""

    def __init__(self, payload, scanners):
        reader = Reader(payload)
        count = reader.varint()
        if not 1 <= count <= 255:
            raise Refused("a group of no tracks, or too many")
        names = [reader.varint() for _ in range(count)]
        if any(name and name - 1 not in scanners for name in names):
            raise Refused("a group has a scanner that does not stand before it")
        self.scanners = [scanners[name - 1] if name else None for name in names]
        self.frames = [Frame(reader, count) for _ in range(reader.varint())]
        self.is_beside = any(frame.stamp[0] == BESIDE for frame in self.frames)
        if self.is_beside and any(frame.stamp[0] != BESIDE for frame in self.frames):
            raise Refused("a file beside the scans, in a group with scans")
        reader.end()


def groups(data):
    """The groups of a stream, which is checked as a whole at the end."""
    if data[:4] != MAGIC:
        raise Refused("not a lidarpc stream")
    if int.from_bytes(data[8:12], "little") != crc32c(data[:8]):
        raise Refused("the header's checksum does not match")
    version, flags = data[4] | data[5] << 8, data[6] | data[7] << 8
    if version != VERSION or flags:
        raise Refused(f"version {version}, flags {flags:#x}: unknown")
    reader = Reader(data, 12)
    scanners = {}
    copies = {}
    places = []
    index = None
    has_beside = False
    while True:
        start = reader.at
        kind, payload, crc = reader.block()
        if kind & SKIPPABLE:
            continue
        if index is not None and kind != END:
            raise Refused("a record after the index")
        if kind == SCANNER:
            known, offsets = copies.setdefault(crc, (payload, []))
            if known != payload:
                raise Refused("two scanners have the same checksum")
            if not offsets:
                scanners[crc] = scanner_of(Reader(payload))
            offsets.append(start)
        elif kind == GROUP:
            group = Group(payload, scanners)
            if has_beside and not group.is_beside:
                raise Refused("scans after the files beside them")
            has_beside = group.is_beside
            places.append((start, reader.at - start, crc, group_entry(group)))
            yield group
        elif kind == INDEX:
            index = start
            compare(Reader(payload), copies, places)
        elif kind == END:
            break
        else:
            raise Refused(f"a record of unknown kind {kind}")
    if index is None or payload != index.to_bytes(8, "little") + data[:8]:
        raise Refused("the end record does not point to the index, or does not repeat the header")
    reader.end()


class Unknown:
    """A scanner of a family that this decoder does not know."""

    def __init__(self, family):
        self.family = family


def scanner_of(reader):
    """2.3 and 3.1."""
    family = reader.varint()
    payload = Reader(reader.take(reader.varint()))
    reader.end()
    if family not in FAMILIES:
        return Unknown(family)
    orientation = payload.varint()
    if orientation >= 8 * len(AXES):
        raise Refused("no such orientation")
    scanner = FAMILIES[family](payload)
    scanner.orientation = AXES[orientation // 8], [orientation >> axis & 1 for axis in range(3)]
    return scanner


def group_entry(group):
    return [frame.size for frame in group.frames], [frame.stamp for frame in group.frames]


def read_entry(reader):
    count = reader.varint()
    return [reader.varint() for _ in range(count)], [stamp(reader) for _ in range(count)]


def compare(reader, copies, places):
    """2.7: the index with what was read."""
    scanners = [(reader.unsigned(4), read_offsets(reader)) for _ in range(reader.varint())]
    found = [read_group(reader) for _ in range(reader.varint())]
    reader.end()
    if scanners != [(crc, offsets) for crc, (_, offsets) in copies.items()] or found != places:
        raise Refused("the index does not match the records")


def read_offsets(reader):
    return [reader.varint() for _ in range(reader.varint())]


def read_group(reader):
    return reader.varint(), reader.varint(), reader.unsigned(4), read_entry(reader)
