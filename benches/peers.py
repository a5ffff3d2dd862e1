#!/usr/bin/env python3
"""lidarpc's levels beside other coders, on the same scans in the same run: a table, and a plot of size against speed.

    pip install numpy laspy lazrs DracoPy pcodec
    benches/peers.py FOLDER [--frames 20] [--csv FILE] [--svg FILE]

FOLDER holds KITTI's .bin files (float32 x, y, z, intensity). Times are CPU time, user and system, on one thread, in
milliseconds a frame: of whole programs (lidarpc, zstd, xz) with all that they read and write, of libraries (LAZ, Draco,
pcodec) of the call alone. What comes back is compared with what went in. Coders that are not installed are named and left out.
"""

import argparse
import csv
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
LIDARPC = ROOT / "target/release/lidarpc"


def cpu_of_program(*command):
    """CPU seconds of a program, user and system."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def cpu_of_call(function, *arguments):
    """What a function returns, and the CPU seconds that it took."""
    start = time.process_time()
    result = function(*arguments)
    return result, time.process_time() - start


def bytes_in(folder):
    return sum(path.stat().st_size for path in folder.iterdir())


def by_lidarpc(level):
    def measure(files, work):
        stream, back = work / "drive.lpc", work / "back"
        encode = cpu_of_program(LIDARPC, "-q", "encode", *files, "-o", stream, "--threads", 1, "--level", level)
        decode = cpu_of_program(LIDARPC, "-q", "decode", stream, "-o", back, "--threads", 1)
        same = all((back / file.name).read_bytes() == file.read_bytes() for file in files)
        return stream.stat().st_size, encode, decode, "exact" if same else "DIFFERS"

    return measure


def by_program(program, options, suffix):
    def measure(files, work):
        if not shutil.which(program):
            raise ImportError(f"no program {program}")
        folder = work / "packed"
        shutil.copytree(files[0].parent, folder, ignore=lambda _, names: set(names) - {file.name for file in files})
        encode = cpu_of_program(program, "-q", *options, *sorted(folder.iterdir()))
        for plain in folder.glob("*.bin"):
            plain.unlink()
        size = bytes_in(folder)
        decode = cpu_of_program(program, "-q", "-d", *sorted(folder.glob(f"*{suffix}")))
        same = all((folder / file.name).read_bytes() == file.read_bytes() for file in files)
        return size, encode, decode, "exact" if same else "DIFFERS"

    return measure


def by_library(coder):
    """Measures what makes functions for arrays of points: encode(xyzi) -> bytes, decode(bytes) -> xyzi."""

    def measure(files, _):
        encode_points, decode_points = coder()
        size = encode_time = decode_time = 0
        farthest, is_exact = 0.0, True
        for file in files:
            points = np.fromfile(file, np.float32).reshape(-1, 4)
            packed, seconds = cpu_of_call(encode_points, points)
            encode_time += seconds
            back, seconds = cpu_of_call(decode_points, packed)
            decode_time += seconds
            size += len(packed)
            is_exact &= back.tobytes() == points.tobytes()
            farthest = max(farthest, np.abs(back[:, :3].astype(float) - points[:, :3]).max())
        return size, encode_time, decode_time, "exact" if is_exact else f"within {farthest * 1000:.2f} mm an axis"

    return measure


def laz():
    """Points on a grid of a millimetre; intensities in 16 bits."""
    import io

    import laspy

    def encode(points):
        header = laspy.LasHeader(point_format=0, version="1.2")
        header.scales, header.offsets = [0.001] * 3, [0.0] * 3
        las = laspy.LasData(header)
        las.x, las.y, las.z = points[:, :3].astype(np.float64).T
        las.intensity = np.rint(points[:, 3] * 65535).astype(np.uint16)
        out = io.BytesIO()
        las.write(out, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
        return out.getvalue()

    def decode(packed):
        las = laspy.read(io.BytesIO(packed), laz_backend=laspy.LazBackend.Lazrs)
        intensity = np.asarray(las.intensity) / 65535
        # KITTI's intensities have two digits.
        return np.stack([las.x, las.y, las.z, np.round(intensity, 2)], axis=1).astype(np.float32)

    return encode, decode


def draco():
    """Points in their order, 17 bits an axis: a grid of 1 to 2 mm for what spans 200 m. Intensities are left out."""
    import DracoPy

    def encode(points):
        return DracoPy.encode(points[:, :3], quantization_bits=17, compression_level=7, preserve_order=True)

    def decode(packed):
        positions = np.asarray(DracoPy.decode(packed).points, np.float32)
        return np.concatenate([positions, np.zeros((len(positions), 1), np.float32)], axis=1)

    return encode, decode


def pcodec():
    """Column by column."""
    from pcodec import ChunkConfig, standalone

    def encode(points):
        columns = [standalone.simple_compress(np.ascontiguousarray(column), ChunkConfig(compression_level=8)) for column in points.T]
        return b"".join(len(column).to_bytes(4, "little") + column for column in columns)

    def decode(packed):
        columns = []
        while packed:
            length = int.from_bytes(packed[:4], "little")
            columns.append(standalone.simple_decompress(packed[4 : 4 + length]))
            packed = packed[4 + length :]
        return np.stack(columns, axis=1)

    return encode, decode


CODERS = [
    *((f"lidarpc --level {level}", by_lidarpc(level)) for level in (1, 2, 3, 6, 7, 8, 9)),
    ("zstd -3", by_program("zstd", ["-3"], ".zst")),
    ("zstd -19", by_program("zstd", ["-19"], ".zst")),
    ("xz -9e", by_program("xz", ["-9e", "-T1"], ".xz")),
    ("LAZ", by_library(laz)),
    ("Draco, no intensity", by_library(draco)),
    ("pcodec", by_library(pcodec)),
]


def measure_all(files):
    """Rows of coder, size in % of the files, ms a frame to encode and to decode, what came back."""
    original = sum(file.stat().st_size for file in files)
    for name, measure in CODERS:
        with tempfile.TemporaryDirectory() as work:
            try:
                size, encode, decode, back = measure(files, Path(work))
            except ImportError as missing:
                print(f"skipped: {name}: {missing}", file=sys.stderr)
                continue
        yield name, 100 * size / original, 1000 * encode / len(files), 1000 * decode / len(files), back


def plot(rows, title):
    """Size against the time to encode, as SVG."""
    width, height, left, bottom = 760, 440, 64, 52
    least, most = (math.log10(limit(row[2] for row in rows)) for limit in (min, max))
    least, most = math.floor(least * 2 - 0.2) / 2, math.ceil(most * 2 + 0.2) / 2
    tallest = math.ceil(max(row[1] for row in rows) / 10) * 10

    def place(milliseconds, percent):
        x = left + (math.log10(milliseconds) - least) / (most - least) * (width - left - 24)
        return x, height - bottom - percent / tallest * (height - bottom - 40)

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<text x="{left}" y="24" font-size="15">{title}</text>',
    ]
    for percent in range(0, tallest + 1, 10):
        _, y = place(10**least, percent)
        out.append(f'<line x1="{left}" x2="{width - 24}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end" fill="#555">{percent} %</text>')
    for power in range(math.ceil(least), math.floor(most) + 1):
        x, y = place(10**power, 0)
        out.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="40" y2="{y:.1f}" stroke="#ddd"/>')
        out.append(f'<text x="{x:.1f}" y="{y + 18:.1f}" text-anchor="middle" fill="#555">{10**power} ms</text>')
    middle = (left + width) / 2
    out.append(f'<text x="{middle}" y="{height - 12}" text-anchor="middle" fill="#555">CPU time to encode a scan</text>')
    ours = [place(row[2], row[1]) for row in rows if row[0].startswith("lidarpc")]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in ours)
    out.append(f'<polyline points="{line}" fill="none" stroke="#0a6" stroke-width="2"/>')
    for name, percent, encode, *_ in rows:
        x, y = place(encode, percent)
        is_ours = name.startswith("lidarpc")
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{"#0a6" if is_ours else "#c52"}"/>')
        label = name.removeprefix("lidarpc --level ")
        anchor = ' text-anchor="end"' if x > width - 120 and not is_ours else ""
        x, y = (x - 4, y - 10) if is_ours else (x - 9 if anchor else x + 9, y + 4)
        out.append(f'<text x="{x:.1f}" y="{y:.1f}"{anchor}>{label}</text>')
    if ours:
        x, y = ours[0]
        out.append(f'<text x="{x - 4:.1f}" y="{y + 22:.1f}" fill="#0a6" font-weight="bold">lidarpc, by level</text>')
    return "\n".join([*out, "</svg>", ""])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--csv", type=Path, help="write the table to this file too")
    parser.add_argument("--svg", type=Path, help="write the plot to this file")
    parser.add_argument("--title", default="Size of the files against speed", help="of the plot")
    arguments = parser.parse_args()
    subprocess.run(["cargo", "build", "--release", "--quiet"], cwd=ROOT, check=True)
    files = sorted(arguments.folder.glob("*.bin"))[: arguments.frames]
    if not files:
        sys.exit(f"{arguments.folder}: holds no .bin files")
    rows = []
    print(f"{'coder':<22} {'size':>7} {'encode':>9} {'decode':>9}  comes back")
    for row in measure_all(files):
        rows.append(row)
        print("{:<22} {:>6.2f}% {:>6.1f} ms {:>6.1f} ms  {}".format(*row), flush=True)
    if arguments.csv:
        with open(arguments.csv, "w", newline="") as out:
            csv.writer(out).writerows([("coder", "size_percent", "encode_ms", "decode_ms", "comes_back"), *rows])
    if arguments.svg:
        arguments.svg.write_text(plot(rows, arguments.title))


if __name__ == "__main__":
    main()
