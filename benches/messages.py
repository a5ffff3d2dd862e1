#!/usr/bin/env python3
"""How long a scan takes through `encode - --messages` and back through `decode - --messages`: wall time from the first byte sent to
the last byte received, as a node that publishes messages sees it; and, on Linux, the processor's time, which other programs do not
lengthen.

    benches/messages.py FOLDER [--frames 20] [--levels 1 6] [--program target/release/lidarpc]

Scans are sent one by one, each only when the one before is back, and compared with what was sent. The first scan is listed by
itself, for the scanner is found in it.
"""

import argparse
import statistics
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


class Coder:
    def __init__(self, program, command, *options):
        arguments = [program, command, "-", "-o", "-", "--messages", "--quiet", *options]
        self.process = subprocess.Popen([str(a) for a in arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def cpu(self):
        """Seconds that it has computed, by the clock that Linux has for each process."""
        return time.clock_gettime(~self.process.pid << 3 | 2)

    def send(self, name, data):
        """The message that comes back, and the seconds until it was there: by the clock, and of the processor."""
        start, cpu = time.perf_counter(), self.cpu()
        self.process.stdin.write(f"{name} {len(data)}\n".encode() + data)
        self.process.stdin.flush()
        _, size = self.process.stdout.readline().rsplit(b" ", 1)
        answer = self.process.stdout.read(int(size))
        return answer, (time.perf_counter() - start, self.cpu() - cpu)

    def close(self):
        self.process.stdin.close()
        if self.process.wait():
            raise SystemExit("it failed")


def row(level, what, seconds, share):
    (first, _), *others = ((1e3 * clock, 1e3 * cpu) for clock, cpu in seconds)
    clock, cpu = zip(*others)
    median, slowest, cpu = statistics.median(clock), max(clock), statistics.median(cpu)
    print(f"{level:>5} {what:<7} {first:>8.1f} {median:>8.1f} {slowest:>8.1f} {cpu:>8.1f} {share:>8}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--levels", type=int, nargs="+", default=[1, 6])
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/lidarpc")
    arguments = parser.parse_args()
    scans = [(path.name, path.read_bytes()) for path in sorted(arguments.folder.iterdir()) if path.is_file()]
    scans = scans[: arguments.frames]
    if len(scans) < 2:
        parser.error("it takes two scans or more")
    print(f"{'level':>5} {'':<7} {'first ms':>8} {'median':>8} {'slowest':>8} {'cpu':>8} {'size':>8}")
    for level in arguments.levels:
        encoder = Coder(arguments.program, "encode", "--level", level)
        decoder = Coder(arguments.program, "decode")
        times = [], []
        size = 0
        for name, data in scans:
            payload, seconds = encoder.send(name, data)
            times[0].append(seconds)
            size += len(payload)
            back, seconds = decoder.send(name, payload)
            times[1].append(seconds)
            if back != data:
                raise SystemExit(f"{name} came back changed")
        encoder.close()
        decoder.close()
        row(level, "encode", times[0], f"{100 * size / sum(len(data) for _, data in scans):.2f} %")
        row(level, "decode", times[1], "")


main()
