#!/usr/bin/env python3
"""Nanoseconds a point that a further frame takes to encode and to decode, on one thread: the processor's time of a drive made of a
folder's scans several times over, less that of half of it. What is done once, such as the fit, is in neither.

    benches/per_point.py FOLDER... [--levels 1 6] [--frames 24] [--program target/release/lidarpc]

The least of three runs. Scans of two scanners can be compared so, whatever their size.
"""

import argparse
import json
import resource
import shutil
import subprocess
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def processor_time(*command):
    """Seconds of the processor that a command takes, user and system."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(program, drive, level, work):
    """Seconds to encode and to decode a drive, and its points."""
    stream, back = work / "drive.lpc", work / "back"
    encode, decode = [], []
    for _ in range(3):
        group = ["--gop", 24, "--level", level]
        encode.append(processor_time(program, "-q", "encode", drive, "-o", stream, "--threads", 1, "--force", *group))
        decode.append(processor_time(program, "-q", "decode", stream, "-o", back, "--threads", 1))
        shutil.rmtree(back)
    stats = subprocess.run([program, "stats", stream, "--json"], check=True, capture_output=True).stdout
    return min(encode), min(decode), json.loads(stats)["points"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--levels", nargs="+", type=int, default=[1, 6])
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/lidarpc")
    options = parser.parse_args()
    print(f"{'folder':28} level  encode  decode")
    for folder in options.folders:
        scans = sorted(path for path in folder.iterdir() if path.is_file())
        times = max(1, options.frames // len(scans))
        with tempfile.TemporaryDirectory() as work:
            work = Path(work)
            drives = [(work / str(times), times), (work / str(2 * times), 2 * times)]
            for drive, count in drives:
                drive.mkdir()
                for turn in range(count):
                    for scan in scans:
                        shutil.copy(scan, drive / f"{turn:03}-{scan.name}")
            for level in options.levels:
                half, whole = (measured(options.program, drive, level, work) for drive, _ in drives)
                points = whole[2] - half[2]
                encode, decode = (1e9 * (whole[part] - half[part]) / points for part in range(2))
                print(f"{folder.name:28} {level:5} {encode:7.0f} {decode:7.0f}", flush=True)


if __name__ == "__main__":
    main()
