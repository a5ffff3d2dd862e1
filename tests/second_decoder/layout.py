"""Section 8.1 of FORMAT.md: the serialised layout of records."""

import struct
from collections import namedtuple
from math import isfinite
from unicodedata import category

from container import Reader
from errors import Refused

PLAIN, PCD_COMPRESSED, TEXT, BIG_ENDIAN, SCALED, WIDENED, BY_FIELD, ARROW = range(8)
# By the numbers of the types, their letters in the module `struct`.
TYPES = "bBhHiIqQfd"
I8, U8, I16, U16, I32, U32, I64, U64, F32, F64 = range(10)
SIZES = [struct.calcsize("<" + letter) for letter in TYPES]
INTEGER, FIXED, SCIENTIFIC, SIGNIFICANT, SHORTEST, CHARACTER = range(6)
# Of a text: flags, and separators by theirs.
CRLF, TRAILING_SEPARATOR, SPACE_AFTER, OPEN_END, PADDED = 1, 4, 32, 64, 512
SEPARATORS = {0: " ", 2: "\t", 8: ",", 16: ";"}
SEPARATOR_FLAGS = 2 | 8 | 16
# Hash bits, multiplier, inserts of each dialect of LZF.
DIALECTS = ((13, 1, 1), (16, 1, 1), (16, 5, 2))


Axis = namedtuple("Axis", "per_metre offset")
HALF = "half"


class Field:
    def __init__(self, name, kind, count, offset=0):
        self.name = name
        self.kind = kind
        self.count = count
        self.offset = offset

    @property
    def size(self):
        """Bytes of a value."""
        return SIZES[self.kind]

    @property
    def width(self):
        return self.size * self.count


def number(reader):
    n = reader.varint()
    if n >> 32:
        raise Refused("a number of more than 32 bits")
    return n


class Layout:
    """`fields` in the order of the record; of these `position` (three) and `intensity`, if there are any, and
    `channels`, all others."""

    def __init__(self, data):
        reader = Reader(data)
        self.wrapping = reader.unsigned(1)
        self.fields = []
        self.stride = 0
        for _ in range(number(reader)):
            self.fields.append(self.field(reader))
            self.stride += self.fields[-1].width
            if self.stride > 65536:
                raise Refused("records are too long")
        roles = [number(reader) for _ in range(4)]
        if 0 < sum(map(bool, roles[:3])) < 3:
            raise Refused("a coordinate is missing")
        taken = [role - 1 for role in roles if role]
        if len(set(taken)) < len(taken) or any(n >= len(self.fields) for n in taken):
            raise Refused("roles of no field, or two of one")
        x, y, z, self.intensity = (self.fields[role - 1] if role else None for role in roles)
        self.position = (x, y, z) if x else None
        if x and any((f.kind, f.count) != (F32, 1) for f in self.position):
            raise Refused("a coordinate of another type")
        if self.intensity and (self.intensity.kind not in (F32, U8, U16) or self.intensity.count != 1):
            raise Refused("an intensity of another type")
        self.channels = [field for n, field in enumerate(self.fields) if n not in taken]
        if self.wrapping == PCD_COMPRESSED:
            dialect = reader.unsigned(1)
            if dialect >= len(DIALECTS):
                raise Refused("unknown dialect of LZF")
            self.dialect = DIALECTS[dialect]
        elif self.wrapping == TEXT:
            self.read_text(reader)
        elif self.wrapping == SCALED:
            self.axes = [self.read_axis(reader) for _ in range(3)]
            if not self.position:
                raise Refused("no coordinates to scale")
        elif self.wrapping in (WIDENED, BY_FIELD, ARROW):
            if self.wrapping == ARROW:
                self.is_wide = reader.unsigned(1)
                if self.is_wide > 1:
                    raise Refused("an Arrow file of unknown alignment")
            self.widened = [self.read_widening(reader, field) for field in self.fields]
        elif self.wrapping not in (PLAIN, BIG_ENDIAN):
            raise Refused("unknown wrapping")
        if self.wrapping != PLAIN and not self.fields:
            raise Refused("wrapped records without fields")
        reader.end()

    def field(self, reader):
        name = str(reader.take(number(reader)), "utf-8")
        if len(name.encode()) > 64 or any(c.isspace() or category(c) == "Cc" for c in name):
            raise Refused("a name that no field has")
        kind, count = reader.unsigned(1), number(reader)
        if kind >= len(TYPES) or count == 0:
            raise Refused("a field of unknown type, or without values")
        return Field(name, kind, count, self.stride)

    def read_axis(self, reader):
        axis = Axis(*struct.unpack("<dd", reader.take(16)))
        if not (isfinite(axis.per_metre) and axis.per_metre > 0 and isfinite(axis.offset)):
            raise Refused("a scale that is not positive, or an offset that is not finite")
        return axis

    def read_widening(self, reader, field):
        """None; HALF; the rule and its parameter, where rule is None for the same number; for steps, `per_metre` and `offset`."""
        widening = reader.unsigned(1)
        if widening > 4 or widening == 3 and self.wrapping != WIDENED or widening and field.kind != F32:
            raise Refused("a widened field of another type")
        if widening == 4:
            return HALF
        if widening == 3:
            return self.read_axis(reader)
        if widening < 2:
            return (None, 0) if widening else None
        return self.rule(F32, *reader.take(2))

    def rule(self, kind, rule, parameter):
        if rule > CHARACTER or (rule in (INTEGER, CHARACTER)) != (kind < F32) or rule == CHARACTER and kind > U8:
            raise Refused("a rule that does not suit a type")
        most = (0, 40, 40, 40, 3, 0)[rule]
        if parameter > most or rule == SIGNIFICANT and parameter == 0:
            raise Refused("unknown rule of a text")
        return rule, parameter

    def read_text(self, reader):
        """`columns`: letter, rule and parameter of each."""
        self.flags = reader.varint()
        if self.flags & SEPARATOR_FLAGS not in SEPARATORS or self.flags & ~PADDED > 127:
            raise Refused("unknown flags of a text")
        self.columns = []
        for kind in (field.kind for field in self.fields for _ in range(field.count)):
            first, parameter = reader.take(2)
            if first & 15 != kind:
                raise Refused("unknown column of a text")
            self.columns.append((TYPES[kind], *self.rule(kind, first >> 4, parameter)))
        self.widths = reader.take(len(self.columns)) if self.flags & PADDED else bytes(len(self.columns))
        if any(width > 40 for width in self.widths):
            raise Refused("unknown width of a text")
