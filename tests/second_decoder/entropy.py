"""Section 5 of FORMAT.md: the arithmetic coder, its adaptive models, and tokens."""

from errors import Refused

M32 = 0xFFFFFFFF
M64 = 0xFFFFFFFFFFFFFFFF


def unzigzag(c):
    return (c >> 1) ^ -(c & 1)


def wrap(v, bits):
    """The signed integer of so many bits that v is modulo their power of two."""
    v &= (1 << bits) - 1
    return v - (1 << bits) if v >> (bits - 1) else v


class Bits:
    """5.1: the arithmetic decoder."""

    __slots__ = ("data", "at", "width", "place")

    def __init__(self, data):
        self.data = data
        self.at = 8
        self.width = M64
        self.place = int.from_bytes((data[:8] + bytes(8))[:8], "big")

    def decode(self, p):
        width = self.width
        one = (width >> 16) * p
        if self.place < one:
            bit = 1
            width = one
        else:
            bit = 0
            width -= one
            self.place -= one
        self.width = width
        if width <= M32:
            self.widen()
        return bit

    def widen(self):
        at = self.at
        self.at = at + 4
        word = self.data[at : at + 4]
        if self.at > len(self.data) + 64:
            raise Refused("a section wants more bytes than it has")
        self.width <<= 32
        self.place = (self.place << 32 | int.from_bytes((word + bytes(4))[:4], "big")) & M64

    def part(self, k):
        width = self.width >> k
        part = min(self.place // width, (1 << k) - 1)
        self.place -= part * width
        self.width = width
        if width <= M32:
            self.widen()
        return part

    def plain(self, n):
        """`code_plain(n)`."""
        value = 0
        while n > 0:
            k = min(n, 16)
            value = value << k | self.part(k)
            n -= k
        return value


class AdaptiveBit:
    """5.2."""

    __slots__ = ("p", "seen")

    def __init__(self):
        self.p = 32768
        self.seen = 0

    def code(self, bits):
        p = self.p
        bit = bits.decode(16 if p < 16 else 65520 if p > 65520 else p)
        if bit:
            self.p = p + (65535 - p) // (self.seen + 2)
        else:
            self.p = p - p // (self.seen + 2)
        if self.seen < 62:
            self.seen += 1
        return bit


def adaptive(n):
    return [AdaptiveBit() for _ in range(n)]


class SymbolModel:
    """5.3."""

    __slots__ = ("bits", "nodes")

    def __init__(self, bits):
        self.bits = bits
        self.nodes = [None] * (1 << bits)

    def code(self, bits):
        node = 1
        nodes = self.nodes
        for _ in range(self.bits):
            model = nodes[node]
            if model is None:
                model = nodes[node] = AdaptiveBit()
            node = node * 2 + model.code(bits)
        return node - (1 << self.bits)


class IntegerModel:
    """5.4."""

    __slots__ = ("length", "top")

    def __init__(self):
        self.length = SymbolModel(6)
        self.top = [None] * 64

    def code(self, bits):
        length = self.length.code(bits)
        if length < 2:
            return length
        below = length - 1
        modelled = min(below, 2)
        rest = below - modelled
        if self.top[length] is None:
            self.top[length] = SymbolModel(2)
        top = self.top[length].code(bits) % (1 << modelled)
        return (((1 << modelled) + top) << rest) + bits.plain(rest)


def integers(n):
    return [IntegerModel() for _ in range(n)]


# 5.5 Tokens

ESCAPE = 255


def numbers(frequencies):
    """The 4096 numbers of a table: (token, place, frequency) of each."""
    left = list(frequencies)
    own = [0] * 256
    other = list(range(256))
    other_place = [0] * 256
    poor = [t for t in range(256) if left[t] < 16]
    rich = [t for t in range(256) if left[t] > 16]
    while poor and rich:
        source = rich.pop()
        to = poor.pop()
        left[source] -= 16 - left[to]
        own[to] = left[to]
        other[to] = source
        other_place[to] = left[source] - own[to]
        if left[source] < 16:
            poor.append(source)
        elif left[source] > 16:
            rich.append(source)
    table = []
    for b in range(256):
        for place in range(16):
            if place < own[b]:
                table.append((b, place, frequencies[b]))
            else:
                token = other[b]
                table.append((token, place + other_place[b], frequencies[token]))
    return table


def frequencies_of(counts):
    """A table's frequencies from counts."""
    total = sum(counts)
    frequencies = [max(1, c * 4096 // total) if c else 0 for c in counts]
    frequencies[ESCAPE] = max(1, frequencies[ESCAPE])
    if not any(frequencies[:ESCAPE]):
        frequencies[0] = 1
    while (s := sum(frequencies)) != 4096:
        m = max(frequencies)
        last = max(t for t in range(256) if frequencies[t] == m)
        frequencies[last] = m + 4096 - s if s < 4096 else m - min(s - 4096, m // 2)
    return frequencies


class TokenModel:
    """What the tokens of one section teach, to the end of the group."""

    def __init__(self, contexts):
        self.counts = [[0] * 256 for _ in range(contexts)]
        self.tables = [None] * contexts
        self.frames = 0

    def finished(self, seen):
        for (context, token), n in seen.items():
            self.counts[context][token] = min(self.counts[context][token] + n, M32)
        self.frames += 1
        if self.frames & (self.frames - 1) == 0:
            for context, counts in enumerate(self.counts):
                if any(counts):
                    self.tables[context] = numbers(frequencies_of(counts))


class Tokens:
    """A section as tokens, being read."""

    def __init__(self, model, reader):
        self.model = model
        self.seen = {}
        self.new_tables(Bits(reader.take(reader.varint())))
        self.escaped = reader.take(reader.varint())
        self.next_escaped = 0
        words = reader.take(2 * reader.varint())
        self.words = [words[i] | words[i + 1] << 8 for i in range(0, len(words), 2)]
        self.next_word = 0
        rest = reader.rest()
        self.data = rest
        self.at = 0
        self.buffer = 0
        self.filled = 0
        self.states = [self.first_state() for _ in range(4)]

    def new_tables(self, bits):
        is_new = AdaptiveBit()
        frequency_models = integers(14)
        for context in range(len(self.model.tables)):
            if not is_new.code(bits):
                continue
            end = bits.plain(8)
            left = 4096
            before = 0
            frequencies = [0] * 256
            for token in range(end):
                before = frequency_models[before.bit_length()].code(bits)
                frequencies[token] = before
                left -= before
                if left < 0:
                    raise Refused("frequencies of a table are above 4096")
            if not 1 <= left < 4096:
                raise Refused("a table without an escape, or with nothing else")
            frequencies[ESCAPE] = left
            self.model.tables[context] = numbers(frequencies)

    def word(self):
        at = self.next_word
        self.next_word = at + 1
        if at >= len(self.words):
            raise Refused("a section has too few words")
        return self.words[at]

    def first_state(self):
        low = self.word()
        return low | self.word() << 16

    def token(self, context):
        state = self.states.pop(0)
        table = self.model.tables[context]
        if table is None:
            raise Refused("a token of a context without a table")
        token, place, frequency = table[state & 4095]
        state = frequency * (state >> 12) + place & M32
        if state < 0x10000:
            state = state << 16 | self.word()
        self.states.append(state)
        if token == ESCAPE:
            at = self.next_escaped
            self.next_escaped = at + 1
            if at >= len(self.escaped):
                raise Refused("a section has too few escaped tokens")
            token = self.escaped[at]
        key = context, token
        self.seen[key] = self.seen.get(key, 0) + 1
        return token

    def bits(self, n):
        while self.filled < n:
            if self.at >= len(self.data):
                raise Refused("a section has too few plain bits")
            self.buffer |= self.data[self.at] << self.filled
            self.at += 1
            self.filled += 8
        value = self.buffer & ((1 << n) - 1)
        self.buffer >>= n
        self.filled -= n
        return value

    def number(self, context):
        t = self.token(context)
        if t < 32:
            return t
        octave = min(5 + ((t - 32) >> 2), 59)
        low = octave - 2
        base = (4 | (t - 32) & 3) << low
        r = min(low, 32)
        high = self.bits(low - r)
        return base + (high << r | self.bits(r))

    def finish(self):
        self.model.finished(self.seen)
