"""Section 3.5 of FORMAT.md: sine, cosine and arctangent as musl and fdlibm compute them, to the last bit."""

import math
import struct
from math import isinf, isnan, nan

from models import f32


def _f64(bits):
    return struct.unpack("<d", struct.pack("<Q", bits))[0]


def _upper(x):
    """The upper 32 bits without the sign."""
    return struct.unpack("<Q", struct.pack("<d", x))[0] >> 32 & 0x7FFFFFFF


S1, S2, S3, S4, S5, S6 = map(
    _f64,
    (0xBFC5555555555549, 0x3F8111111110F8A6, 0xBF2A01A019C161D5, 0x3EC71DE357B1FE7D, 0xBE5AE5E68A2B9CEB, 0x3DE5D93A5ACFD57C),
)
C1, C2, C3, C4, C5, C6 = map(
    _f64,
    (0x3FA555555555554C, 0xBF56C16C16C15177, 0x3EFA01A019CB1590, 0xBE927E4F809C52AD, 0x3E21EE9EBDB4B1C4, 0xBDA8FAE9BE8838D4),
)
P1, P1T = _f64(0x3FF921FB54400000), _f64(0x3DD0B4611A626331)
P2, P2T = _f64(0x3DD0B4611A600000), _f64(0x3BA3198A2E037073)
P3, P3T = _f64(0x3BA3198A2E000000), _f64(0x397B839A252049C1)
INV = _f64(0x3FE45F306DC9C883)
M = 1.5 * 2.0**52


def k_sin(x, y):
    z = x * x
    w = z * z
    r = S2 + z * (S3 + z * S4) + z * w * (S5 + z * S6)
    v = z * x
    return x - ((z * (0.5 * y - v * r) - y) - v * S1)


def k_cos(x, y):
    z = x * x
    w = z * z
    r = z * (C1 + z * (C2 + z * C3)) + w * w * (C4 + z * (C5 + z * C6))
    hz = 0.5 * z
    u = 1 - hz
    return u + (((1 - u) - hz) + (z * r - x * y))


def _medium(x, hi):
    f = (x * INV + M) - M
    r = x - f * P1
    w = f * P1T
    y0 = r - w
    exponent = hi >> 20
    if exponent - (_upper(y0) >> 20) > 16:
        t = r
        w = f * P2
        r = t - w
        w = f * P2T - ((t - r) - w)
        y0 = r - w
        if exponent - (_upper(y0) >> 20) > 49:
            t = r
            w = f * P3
            r = t - w
            w = f * P3T - ((t - r) - w)
            y0 = r - w
    return int(f), y0, (r - y0) - w


def _reduce(x, hi):
    if hi <= 0x400F6A7A and hi & 0xFFFFF == 0x921FB or hi in (0x4012D97C, 0x401921FB) or hi > 0x401C463B:
        return _medium(x, hi)
    k = 1 if hi <= 0x4002D97C else 2 if hi <= 0x400F6A7A else 3 if hi <= 0x4015FDBC else 4
    if x > 0:
        z = x - k * P1
        y0 = z - k * P1T
        return k, y0, (z - y0) - k * P1T
    z = x + k * P1
    y0 = z + k * P1T
    return -k, y0, (z - y0) + k * P1T


def sin(x):
    hi = _upper(x)
    if hi <= 0x3FE921FB:
        if hi < 0x3E500000:
            return x
        z = x * x
        w = z * z
        r = S2 + z * (S3 + z * S4) + z * w * (S5 + z * S6)
        return x + (z * x) * (S1 + z * r)
    n, y0, y1 = _reduce(x, hi)
    n &= 3
    v = k_cos(y0, y1) if n & 1 else k_sin(y0, y1)
    return -v if n & 2 else v


def cos(x):
    hi = _upper(x)
    if hi <= 0x3FE921FB:
        return 1.0 if hi < 0x3E46A09E else k_cos(x, 0.0)
    n, y0, y1 = _reduce(x, hi)
    n &= 3
    v = k_sin(y0, y1) if n & 1 else k_cos(y0, y1)
    return -v if n in (1, 2) else v


ATAN_HI = [_f64(b) for b in (0x3FDDAC670561BB4F, 0x3FE921FB54442D18, 0x3FEF730BD281F69B, 0x3FF921FB54442D18)]
ATAN_LO = [_f64(b) for b in (0x3C7A2B7F222F65E2, 0x3C81A62633145C07, 0x3C7007887AF0CBBD, 0x3C91A62633145C07)]
A = [
    _f64(b)
    for b in (
        0x3FD555555555550D,
        0xBFC999999998EBC4,
        0x3FC24924920083FF,
        0xBFBC71C6FE231671,
        0x3FB745CDC54C206E,
        0xBFB3B0F2AF749A6D,
        0x3FB10D66A0D03D51,
        0xBFADDE2D52DEFD9A,
        0x3FA97B4B24760DEB,
        0xBFA2B4442C6A6C2F,
        0x3F90AD3AE322DA11,
    )
]


def _atan(x):
    """Of x >= 0."""
    hi = _upper(x)
    if hi >= 0x44100000:
        return ATAN_HI[3] + _f64(0x0170000000000000)
    if hi < 0x3FDC0000:
        if hi < 0x3E400000:
            return x
        part = None
    elif hi < 0x3FE60000:
        part = 0
        x = (2 * x - 1) / (2 + x)
    elif hi < 0x3FF30000:
        part = 1
        x = (x - 1) / (x + 1)
    elif hi < 0x40038000:
        part = 2
        x = (x - 1.5) / (1 + 1.5 * x)
    else:
        part = 3
        x = -1 / x
    z = x * x
    w = z * z
    s1 = z * (A[0] + w * (A[2] + w * (A[4] + w * (A[6] + w * (A[8] + w * A[10])))))
    s2 = w * (A[1] + w * (A[3] + w * (A[5] + w * (A[7] + w * A[9]))))
    if part is None:
        return x - x * (s1 + s2)
    return ATAN_HI[part] - (x * (s1 + s2) - ATAN_LO[part] - x)


PI = _f64(0x400921FB54442D18)
PI_LO = _f64(0x3CA1A62633145C07)


def atan2(y, x):
    if isnan(x) or isnan(y):
        return nan
    if isinf(x) or isinf(y):
        return math.atan2(y, x)  # a multiple of a quarter of pi
    if x == 1.0:
        return -_atan(-y) if struct.pack("<d", y)[7] >> 7 else _atan(y)
    m = struct.pack("<d", y)[7] >> 7 | struct.pack("<d", x)[7] >> 6 & 2
    if y == 0:
        return (y, y, PI, -PI)[m]
    if x == 0:
        return -PI / 2 if m & 1 else PI / 2
    hx = _upper(x)
    hy = _upper(y)
    if hx + (64 << 20) < hy:
        return -PI / 2 if m & 1 else PI / 2
    if m & 2 and hy + (64 << 20) < hx:
        z = 0.0
    else:
        z = _atan(abs(y / x))
    if m == 0:
        return z
    if m == 1:
        return -z
    if m == 2:
        return PI - (z - PI_LO)
    return (z - PI_LO) - PI


# In float32


def _f32(bits):
    return struct.unpack("<f", struct.pack("<I", bits))[0]


def _bits(x):
    return struct.unpack("<I", struct.pack("<f", x))[0]


FS = [_f32(b) for b in (0xBE2AAAAB, 0x3C088889, 0xB9500D01, 0x3638EF1B, 0xB2D72F34, 0x2F2EC9D3)]
FC = [_f32(b) for b in (0x3D2AAAAB, 0xBAB60B61, 0x37D00D01, 0xB493F27C, 0x310F74F6, 0xAD47D74E)]
FINV, FP1, FP1T, FP2, FP2T = map(_f32, (0x3F22F984, 0x3FC90F80, 0x37354443, 0x37354400, 0x2E85A308))


def _sin_near(x, y=None):
    z = f32(x * x)
    v = f32(z * x)
    r = FS[5]
    for s in (FS[4], FS[3], FS[2], FS[1]):
        r = f32(s + f32(z * r))
    if y is None:
        return f32(x + f32(v * f32(FS[0] + f32(z * r))))
    inner = f32(f32(0.5 * y) - f32(v * r))
    return f32(x - f32(f32(f32(z * inner) - y) - f32(v * FS[0])))


def _cos_near(x, y):
    z = f32(x * x)
    r = FC[5]
    for c in (FC[4], FC[3], FC[2], FC[1], FC[0]):
        r = f32(c + f32(z * r))
    r = f32(z * r)
    bits = _bits(abs(x))
    half = f32(0.5 * z)
    correction = f32(f32(z * r) - f32(x * y))
    if bits < 0x3E99999A:
        return f32(1 - f32(half - correction))
    q = 0.28125 if bits > 0x3F480000 else _f32(bits - 0x01000000)
    return f32(f32(1 - q) - f32(f32(half - q) - correction))


def _exponent(x):
    return _bits(x) >> 23 & 255


def sin_cos_f32(x):
    """`sinf(x)` and `cosf(x)`."""
    if x <= _f32(0x3F490FD8):
        return _sin_near(x), _cos_near(x, 0.0)
    n = int(f32(f32(x * FINV) + 0.5))
    f = f32(n)
    head = f32(x - f32(f * FP1))
    tail = f32(f * FP1T)
    y0 = f32(head - tail)
    if _exponent(x) - _exponent(y0) > 8:
        t = head
        w = f32(f * FP2)
        head = f32(t - w)
        tail = f32(f32(f * FP2T) - f32(f32(t - head) - w))
        y0 = f32(head - tail)
    y1 = f32(f32(head - y0) - tail)
    s = _sin_near(y0, y1)
    c = _cos_near(y0, y1)
    return ((s, c), (c, -s), (-s, -c), (-c, s))[n & 3]


# Of glibc

GS = [_f64(b) for b in (0xBFC555545995A603, 0x3F81107605230BC4, 0xBF2994EB3774CF24)]
GC = [_f64(b) for b in (0xBFDFFFFFFD0C621C, 0x3FA55553E1068F19, 0xBF56C087E89A359D, 0x3EF99343027BF8C3)]
GQ, GH = _f64(0x41645F306DC9C883), _f64(0x3FF921FB54442D18)


def _top(x):
    return _bits(x) >> 20 & 0x7FF


def _glibc(x, k):
    n = 0 if _top(x) < 0x3F4 else (int(x * GQ) + (1 << 23)) >> 24
    r = x - n * GH
    z = r * r
    if (n + k) % 2 == 0:
        y = -r if n & 3 in (1, 2) else r
        w = y * z
        return f32((y + w * GS[0]) + w * z * (GS[1] + z * GS[2]))
    g = -1.0 if n & 2 else 1.0
    w = z * z
    return f32((g * (1 + z * GC[0]) + w * (g * GC[1])) + w * z * (g * (GC[2] + z * GC[3])))


def glibc_sinf(x):
    return x if _top(x) < 0x398 else _glibc(x, 0)


def glibc_cosf(x):
    return 1.0 if _top(x) < 0x398 else _glibc(x, 1)


def old_sinf(x):
    return f32(x - x * x * x / 6) if abs(x) < 1 / 32 else f32(sin(x))


def old_cosf(x):
    return f32(1 - x * x / 2) if abs(x) < 1 / 32 else f32(cos(x))
