"""Section 8.14 of FORMAT.md: residuals by an image coder, here JPEG."""

from container import Reader
from errors import NotHere, Refused

JPEG, JPEG_2000 = 64, 65

# ITU-T T.81, tables K.3, K.5 and K.1: lengths of codes and their values, and quantisation steps.
DC_LENGTHS = (0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0)
DC_VALUES = bytes(range(12))
AC_LENGTHS = (0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125)
AC_VALUES = bytes.fromhex(
    "01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738"
    "393a434445464748494a535455565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5"
    "a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa"
)
QUANTISATION = (
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51, 87, 80, 62,
    18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
)  # fmt: skip


def _zigzag():
    """The place of each coefficient, in the order in which they are coded."""
    cells = [(y, x) for y in range(8) for x in range(8)]
    cells.sort(key=lambda c: (c[0] + c[1], c[0] if (c[0] + c[1]) % 2 else c[1]))
    return [8 * y + x for y, x in cells]


ZIGZAG = _zigzag()


def _codes(lengths, values):
    """Values by (length, code)."""
    table = {}
    code = at = 0
    for length, n in enumerate(lengths, 1):
        for _ in range(n):
            table[length, code] = values[at]
            at += 1
            code += 1
        code <<= 1
    return table


DC = _codes(DC_LENGTHS, DC_VALUES)
AC = _codes(AC_LENGTHS, AC_VALUES)


def wrap32(v):
    return (v + 0x80000000 & 0xFFFFFFFF) - 0x80000000


def inverse(c, bias, shift):
    c0, c1, c2, c3, c4, c5, c6, c7 = c
    e = (c2 + c6) * 2217
    e2 = e - c6 * 7567
    e3 = e + c2 * 3135
    d0 = c0 + c4 << 12
    d1 = c0 - c4 << 12
    x0, x3 = d0 + e3 + bias, d0 - e3 + bias
    x1, x2 = d1 + e2 + bias, d1 - e2 + bias
    o = (c7 + c3 + c5 + c1) * 4816
    a = o - (c7 + c1) * 3685
    b = o - (c5 + c3) * 10497
    f = (c7 + c3) * 8034
    g = (c5 + c1) * 1597
    o0 = c7 * 1223 + a - f
    o1 = c5 * 8410 + b - g
    o2 = c3 * 12586 + b - f
    o3 = c1 * 6149 + a - g
    sums = x0 + o3, x1 + o2, x2 + o1, x3 + o0, x3 - o0, x2 - o1, x1 - o2, x0 - o3
    return [wrap32(v) >> shift for v in sums]


class ScanBits:
    def __init__(self, data):
        self.data = data
        self.at = 0
        self.value = 0
        self.left = 0

    def bit(self):
        if self.left == 0:
            if self.at >= len(self.data):
                raise Refused("an image ends early")
            self.value = self.data[self.at]
            self.at += 1
            if self.value == 255:
                if self.data[self.at : self.at + 1] != b"\0":
                    raise Refused("a marker in an image")
                self.at += 1
            self.left = 8
        self.left -= 1
        return self.value >> self.left & 1

    def symbol(self, table):
        code = 0
        for length in range(1, 17):
            code = code << 1 | self.bit()
            if (length, code) in table:
                return table[length, code]
        raise Refused("an image has a code that is none")

    def signed(self, n):
        v = 0
        for _ in range(n):
            v = v << 1 | self.bit()
        return v if n == 0 or v >> (n - 1) else v - (1 << n) + 1


def jpeg(data, rows, columns):
    quality = data[0]
    if not 1 <= quality <= 100:
        raise Refused("an impossible quality")
    factor = 5000 // quality if quality < 50 else 200 - 2 * quality
    steps = [min(max((e * factor + 50) // 100, 1), 255) for e in QUANTISATION]
    bits = ScanBits(data[1:])
    samples = [[0] * columns for _ in range(rows)]
    last = 0
    for top in range(0, rows, 8):
        for left in range(0, columns, 8):
            block = [0] * 64
            last += bits.signed(bits.symbol(DC))
            block[0] = wrap32(last * steps[0])
            k = 1
            while k < 64:
                symbol = bits.symbol(AC)
                run, size = symbol >> 4, symbol & 15
                if size == 0 and run < 15:
                    break
                k += run
                if k > 63:
                    raise Refused("a block has too many coefficients")
                place = ZIGZAG[k]
                block[place] = bits.signed(size) * steps[place]
                k += 1
            by_column = [inverse(block[x::8], 512, 10) for x in range(8)]
            for y in range(min(8, rows - top)):
                row = inverse([column[y] for column in by_column], 66048 + (128 << 17), 17)
                for x in range(min(8, columns - left)):
                    samples[top + y][left + x] = min(max(row[x], 0), 255) - 128
    return samples


def cut(v):
    return min(max(v, -0x80000000), 0x7FFFFFFF)


def residuals(coder, payload, rows, columns):
    """The residual of each cell."""
    reader = Reader(payload)
    passes = reader.varint()
    if passes > 8:
        raise Refused("too many passes")
    found = [[0] * columns for _ in range(rows)]
    for _ in range(passes):
        centre = reader.svarint()
        step = reader.varint()
        image = reader.take(reader.varint())
        if cut(centre) != centre or step >> 32:
            raise Refused("an impossible pass")
        if not image:
            samples = [[0] * columns for _ in range(rows)]
        elif coder == JPEG:
            samples = jpeg(image, rows, columns)
        else:
            raise NotHere("images by JPEG 2000")
        for own, of_pass in zip(found, samples):
            for column, sample in enumerate(of_pass):
                own[column] = cut(own[column] + cut(centre + step * sample))
    reader.end()
    return found
