"""Section 9 of FORMAT.md: Arrow files."""

import struct

from errors import Refused

MARK = b"\xff\xff\xff\xff"
SCHEMA, BATCH = 1, 3
BLOCK = 65536


class Table:
    """A table of a FlatBuffer; `place` of a field is None if it is left out."""

    def __init__(self, data, at):
        self.data, self.at = data, at

    def unpack(self, letter, place):
        return struct.unpack_from("<" + letter, self.data, place)[0]

    def place(self, field):
        fields = self.at - self.unpack("i", self.at)
        if 4 + 2 * field >= self.unpack("H", fields):
            return None
        offset = self.unpack("H", fields + 4 + 2 * field)
        return self.at + offset if offset else None

    def number(self, field, letter):
        place = self.place(field)
        return 0 if place is None else self.unpack(letter, place)

    def follow(self, place):
        return Table(self.data, place + self.unpack("I", place))

    def table(self, field):
        place = self.place(field)
        return None if place is None else self.follow(place)

    def list(self, field):
        """The place of its first item, and their number."""
        table = self.table(field)
        return (0, 0) if table is None else (table.at + 4, self.unpack("I", table.at))


def file_of(prefix, columns, records, is_wide):
    """The file with these columns, of which each is the bytes of all its values."""
    try:
        return put_together(prefix, columns, records, 64 if is_wide else 8)
    except struct.error:
        raise Refused("the prefix of an Arrow file is damaged") from None


def put_together(prefix, columns, records, alignment):
    out = bytearray(prefix)
    if prefix[-6:] != b"ARROW1":
        raise Refused("no Arrow file")
    footer = len(prefix) - 10 - struct.unpack_from("<I", prefix, len(prefix) - 10)[0]
    root = Table(prefix, 0)
    blocks, count = root.follow(footer).list(3)
    at, bodies, before, first = 8, [], 0, 0

    def put(place, number):
        struct.pack_into("<Q", out, place, number)

    while prefix[at : at + 4] == MARK and (size := root.unpack("I", at + 4)):
        message, metadata = at, root.follow(at + 8)
        at += 8 + size
        kind = metadata.number(1, "B")
        if kind == SCHEMA:
            continue
        batch = metadata.table(2)
        if kind != BATCH or batch is None:
            raise Refused("a message that is neither a schema nor a batch")
        length = batch.number(0, "q")
        (nodes, n), (buffers, m) = batch.list(1), batch.list(2)
        if (n, m) != (len(columns), 2 * len(columns)):
            raise Refused("a batch with other columns")
        if first + length > records:
            raise Refused("batches of more records")
        body = bytearray()
        for number, column in enumerate(columns):
            width = len(column) // max(records, 1)
            values = column[first * width : (first + length) * width]
            put(nodes + 16 * number, length)
            offset = len(body)
            body += struct.pack("<Q", len(values)) + lz4(values) if values and batch.table(3) else values
            for place, value in enumerate((offset, 0, offset, len(body) - offset)):
                put(buffers + 32 * number + 8 * place, value)
            body += bytes(-len(body) % alignment)
        if (place := metadata.place(3)) is not None:
            put(place, len(body))
        put(blocks + 24 * len(bodies), message + before)
        put(blocks + 24 * len(bodies) + 16, len(body))
        before += len(body)
        first += length
        bodies.append((at, body))
    if first != records or len(bodies) != count or at + 8 != footer:
        raise Refused("batches of fewer records, or other messages")
    for at, body in reversed(bodies):
        out[at:at] = body
    return bytes(out)


def lz4(data):
    """The frame that liblz4 makes."""
    is_linked = len(data) > BLOCK
    out = bytearray(b"\x04\x22\x4d\x18" + (b"\x40\x40\xc0" if is_linked else b"\x60\x40\x82"))
    table = [0] * (1 << 12 if is_linked else 1 << 13)

    def enter(at):
        if is_linked:
            slot = (int.from_bytes(data[at : at + 8], "little") << 24) * 889523592379 % 2**64 >> 52
        else:
            slot = int.from_bytes(data[at : at + 4], "little") * 2654435761 % 2**32 >> 19
        before, table[slot] = table[slot], at
        return before

    for start in range(0, len(data), BLOCK):
        block = data[start : start + BLOCK]
        packed = lz4_block(data, start, start + len(block), enter)
        if packed is None:
            out += struct.pack("<I", len(block) | 1 << 31) + block
        else:
            out += struct.pack("<I", len(packed)) + packed
    return bytes(out + bytes(4))


def lz4_block(data, start, end, enter):
    """The block; None if it cannot be shortened."""
    most, last = end - start - 1, end - 11
    out = bytearray()
    literals = start

    def is_match(c, at):
        return c + 65535 >= at and data[c : c + 4] == data[at : at + 4]

    def rest(n):
        return b"\xff" * ((n - 15) // 255) + bytes([(n - 15) % 255]) if n >= 15 else b""

    def found(at):
        step, tried = 1, 64
        while at + step <= last:
            c = enter(at)
            if is_match(c, at):
                return at, c
            at, step, tried = at + step, tried >> 6, tried + 1
        return None

    if end - start >= 13:
        enter(start)
        at = start + 1
        while at < last and (match := found(at)):
            at, c = match
            while at > literals and c > 0 and data[at - 1] == data[c - 1]:
                at, c = at - 1, c - 1
            while True:
                m = 0
                while at + 4 + m < end - 5 and data[at + 4 + m] == data[c + 4 + m]:
                    m += 1
                n = at - literals
                if len(out) + 1 + n + n // 255 + 8 > most:
                    return None
                out.append(min(n, 15) << 4 | min(m, 15))
                out += rest(n) + data[literals:at] + struct.pack("<H", at - c)
                if len(out) + 6 + (m + 240) // 255 > most:
                    return None
                out += rest(m)
                at += 4 + m
                literals = at
                if at >= last:
                    break
                enter(at - 2)
                c = enter(at)
                if not is_match(c, at):
                    break
            at += 1
    n = end - literals
    if len(out) + n + 1 + (n + 240) // 255 > most:
        return None
    out.append(min(n, 15) << 4)
    return bytes(out + rest(n) + data[literals:end])
