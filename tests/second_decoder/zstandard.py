"""A Zstandard frame without a dictionary (RFC 8878; its section numbers are cited)."""

MAGIC = 0xFD2FB528
RAW, RLE, COMPRESSED, REPEATED = range(4)

# 3.1.1.3.2.1.1: the first value of each code and how many bits are added.
LITERALS_LENGTHS = [(v, 0) for v in range(16)] + list(
    zip(
        (16, 18, 20, 22, 24, 28, 32, 40, 48, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768, 65536),
        (1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16),
    )
)
MATCH_LENGTHS = [(v, 0) for v in range(3, 35)] + list(
    zip(
        (35, 37, 39, 41, 43, 47, 51, 59, 67, 83, 99, 131, 259, 515, 1027, 2051, 4099, 8195, 16387, 32771, 65539),
        (1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16),
    )
)
# 3.1.1.3.2.2: distributions that need not be sent, and the logarithms of their sums.
DEFAULT_LITERALS_LENGTHS = [4, 3] + [2] * 11 + [1] * 3 + [2] * 9 + [3, 2] + [1] * 5 + [-1] * 4
DEFAULT_OFFSETS = [1] * 6 + [2] * 3 + [1] * 15 + [-1] * 5
DEFAULT_MATCH_LENGTHS = [1, 4, 3] + [2] * 6 + [1] * 37 + [-1] * 7


class Backwards:
    """Bits from the last on; behind the first all are 0."""

    def __init__(self, data):
        if not data or data[-1] == 0:
            raise IndexError("a bit stream without an end")
        self.value = int.from_bytes(data, "little")
        self.at = self.value.bit_length() - 1

    def bits(self, n):
        self.at -= n
        if self.at >= 0:
            return self.value >> self.at & ((1 << n) - 1)
        return self.value << -self.at & ((1 << n) - 1)


class Table:
    """4.1: symbols and next states of a finite-state entropy decoder."""

    def __init__(self, frequencies, log):
        size = 1 << log
        self.log = log
        self.symbols = [0] * size
        last = size
        for symbol, frequency in enumerate(frequencies):
            if frequency == -1:
                last -= 1
                self.symbols[last] = symbol
        at = 0
        for symbol, frequency in enumerate(frequencies):
            for _ in range(max(frequency, 0)):
                self.symbols[at] = symbol
                at = at + (size >> 1) + (size >> 3) + 3 & size - 1
                while at >= last:
                    at = at + (size >> 1) + (size >> 3) + 3 & size - 1
        following = [abs(frequency) for frequency in frequencies]
        self.states = []
        for symbol in self.symbols:
            n = log + 1 - following[symbol].bit_length()
            self.states.append((n, (following[symbol] << n) - size))
            following[symbol] += 1

    @staticmethod
    def of_symbol(symbol):
        table = Table([1], 0)
        table.symbols[0] = symbol
        return table

    @staticmethod
    def read(data, most_log):
        """4.1.1: a table, and how many bytes it takes."""
        value = int.from_bytes(data, "little")
        log = (value & 15) + 5
        if log > most_log:
            raise IndexError("a table that is too large")
        at = 4
        left = 1 << log
        frequencies = []
        while left > 0:
            bits = (left + 1).bit_length()
            found = value >> at & (1 << bits) - 1
            half = (1 << bits - 1) - 1
            short = (1 << bits) - 2 - left
            at += bits
            if found & half < short:
                at -= 1
                found &= half
            elif found > half:
                found -= short
            frequencies.append(found - 1)
            left -= abs(found - 1)
            if found == 1:
                more = 3
                while more == 3:
                    more = value >> at & 3
                    at += 2
                    frequencies += [0] * more
        if left or at > 8 * len(data):
            raise IndexError("frequencies that make no table")
        return Table(frequencies, log), (at + 7) // 8


class State:
    def __init__(self, table, bits):
        self.table = table
        self.at = bits.bits(table.log)

    @property
    def symbol(self):
        return self.table.symbols[self.at]

    def go_on(self, bits):
        n, base = self.table.states[self.at]
        self.at = base + bits.bits(n)


def huffman(data):
    """4.2.1: (bits, lookup table of symbol and length), and how many bytes it takes."""
    first = data[0]
    if first >= 128:
        n = first - 127
        size = 1 + (n + 1) // 2
        weights = [data[1 + k // 2] >> (4 if k % 2 == 0 else 0) & 15 for k in range(n)]
    else:
        size = 1 + first
        table, taken = Table.read(data[1:size], 6)
        bits = Backwards(data[1 + taken : size])
        states = State(table, bits), State(table, bits)
        weights = []
        while True:
            weights.append(states[0].symbol)
            states[0].go_on(bits)
            states = states[::-1]
            if bits.at < 0:
                weights.append(states[0].symbol)
                break
    total = sum(1 << w - 1 for w in weights if w)
    longest = total.bit_length()
    weights.append(((1 << longest) - total).bit_length())
    lookup = []
    for weight in range(1, longest + 1):
        for symbol, own in enumerate(weights):
            if own == weight:
                lookup += [(symbol, longest + 1 - weight)] * (1 << weight - 1)
    if len(lookup) != 1 << longest:
        raise IndexError("weights that make no code")
    return (longest, lookup), size


def huffman_stream(code, data, n):
    longest, lookup = code
    bits = Backwards(data)
    out = bytearray()
    for _ in range(n):
        symbol, length = lookup[bits.bits(longest)]
        bits.at += longest - length
        out.append(symbol)
    if bits.at != 0:
        raise IndexError("literals that do not end where they should")
    return out


class Decoder:
    def __init__(self):
        self.out = bytearray()
        self.code = None
        self.tables = [None] * 3
        self.offsets = [1, 4, 8]

    def literals(self, data):
        """3.1.1.3.1: the literals of a block, and how many bytes they take."""
        kind, form = data[0] & 3, data[0] >> 2 & 3
        if kind in (RAW, RLE):
            size, shift = ((1, 3), (2, 4), (1, 3), (3, 4))[form]
            n = int.from_bytes(data[:size], "little") >> shift
            if kind == RLE:
                return data[size : size + 1] * n, size + 1
            return data[size : size + n], size + n
        size, width = ((3, 10), (3, 10), (4, 14), (5, 18))[form]
        header = int.from_bytes(data[:size], "little") >> 4
        n, length = header & (1 << width) - 1, header >> width
        end = size + length
        data = data[size:end]
        if kind == COMPRESSED:
            self.code, taken = huffman(data)
            data = data[taken:]
        if form == 0:
            return huffman_stream(self.code, data, n), end
        parts = [int.from_bytes(data[k : k + 2], "little") for k in (0, 2, 4)]
        data = data[6:]
        out = bytearray()
        each = (n + 3) // 4
        for part in parts:
            out += huffman_stream(self.code, data[:part], each)
            data = data[part:]
        return out + huffman_stream(self.code, data, n - 3 * each), end

    def block(self, data):
        """3.1.1.3."""
        literals, at = self.literals(data)
        first = data[at]
        if first < 128:
            n, at = first, at + 1
        elif first < 255:
            n, at = (first - 128 << 8) + data[at + 1], at + 2
        else:
            n, at = data[at + 1] + (data[at + 2] << 8) + 0x7F00, at + 3
        if n == 0:
            self.out += literals
            return
        modes = data[at]
        at += 1
        known = (
            (DEFAULT_LITERALS_LENGTHS, 6, 9),
            (DEFAULT_OFFSETS, 5, 8),
            (DEFAULT_MATCH_LENGTHS, 6, 9),
        )
        for k, (default, log, most_log) in enumerate(known):
            mode = modes >> (6 - 2 * k) & 3
            if mode == RAW:
                self.tables[k] = Table(default, log)
            elif mode == RLE:
                self.tables[k] = Table.of_symbol(data[at])
                at += 1
            elif mode == COMPRESSED:
                self.tables[k], taken = Table.read(data[at:], most_log)
                at += taken
        bits = Backwards(data[at:])
        lengths, offsets, matches = (State(table, bits) for table in self.tables)
        taken = 0
        for k in range(n):
            offset = (1 << offsets.symbol) + bits.bits(offsets.symbol)
            base, more = MATCH_LENGTHS[matches.symbol]
            match = base + bits.bits(more)
            base, more = LITERALS_LENGTHS[lengths.symbol]
            length = base + bits.bits(more)
            if k + 1 < n:
                lengths.go_on(bits)
                matches.go_on(bits)
                offsets.go_on(bits)
            self.out += literals[taken : taken + length]
            taken += length
            self.copy(self.offset(offset, length == 0), match)
        self.out += literals[taken:]
        if bits.at != 0:
            raise IndexError("sequences that do not end where they should")

    def offset(self, value, is_without_literals):
        """3.1.1.5."""
        kept = self.offsets
        if value > 3:
            self.offsets = [value - 3] + kept[:2]
            return value - 3
        which = value - 1 + is_without_literals
        found = kept[which] if which < 3 else kept[0] - 1
        if which > 0:
            self.offsets = [found, kept[0], kept[2] if which == 1 else kept[1]]
        return found

    def copy(self, offset, n):
        out = self.out
        if not 1 <= offset <= len(out):
            raise IndexError("an offset beyond the start")
        for _ in range(n):
            out.append(out[-offset])


def decompress(data):
    """3.1.1. Does not verify the checksum: FORMAT.md has its own."""
    if int.from_bytes(data[:4], "little") != MAGIC:
        raise IndexError("not a Zstandard frame")
    flags = data[4]
    is_single, has_checksum = flags >> 5 & 1, flags >> 2 & 1
    if flags & 3:
        raise IndexError("a dictionary")
    at = 5 + (0 if is_single else 1) + (is_single, 2, 4, 8)[flags >> 6]
    decoder = Decoder()
    is_last = False
    while not is_last:
        header = int.from_bytes(data[at : at + 3], "little")
        is_last, kind, size = header & 1, header >> 1 & 3, header >> 3
        at += 3
        if kind == RLE:
            decoder.out += data[at : at + 1] * size
            at += 1
            continue
        if at + size > len(data) or kind == REPEATED:
            raise IndexError("a block that is none")
        if kind == RAW:
            decoder.out += data[at : at + size]
        else:
            decoder.block(data[at : at + size])
        at += size
    if at + 4 * has_checksum != len(data):
        raise IndexError("bytes behind the last block")
    return bytes(decoder.out)
