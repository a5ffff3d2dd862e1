#!/usr/bin/env bash
# Size and CPU time at each level, and those of zstd -3 and -19 in the same run, on one core: BENCHMARKS.md's table.
# The best of three runs each, or of RUNS; of levels 1 to 9, or of LEVELS. Needs the program zstd. Usage: benches/levels.sh FOLDER...
# With TIMES=3 a drive is made of each folder's scans three times over, so that the fit is shared by as many frames.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
cargo build --release --quiet
work=$(mktemp -d)
runs=${RUNS:-3}
trap 'rm -rf "$work"' EXIT

# CPU seconds of a command, user and system: the least of some runs.
cpu() { local TIMEFORMAT='%U %S'; { time "$@" >"$work/out" 2>"$work/err"; } 2>&1 | awk '{ print $1 + $2 }'; }
least() { local runs=$1; shift; for _ in $(seq "$runs"); do cpu "$@"; done | sort -g | head -1; }
row() { awk -v n="$1" -v w="$2" -v s="$3" -v o="$4" -v e="$5" -v d="$6" -v f="$7" 'BEGIN {
    printf "%-18s %-8s %7.2f%% %9.1f %9.1f\n", n, w, 100 * s / o, 1e3 * e / f, 1e3 * d / f }'; }
size() { cat "$@" | wc -c; }

printf '%-18s %-8s %8s %9s %9s\n' folder coder size 'enc ms' 'dec ms'
for folder in "$@"; do
    name=$(basename "$folder")
    if [ "${TIMES:-1}" -gt 1 ]; then
        rm -rf "$work/scans"
        mkdir "$work/scans"
        for time in $(seq "$TIMES"); do
            for scan in "$folder"/*.bin; do cp "$scan" "$work/scans/$time-$(basename "$scan")"; done
        done
        folder=$work/scans
    fi
    frames=$(find "$folder" -maxdepth 1 -name '*.bin' | wc -l)
    original=$(size "$folder"/*.bin)
    for level in ${LEVELS:-1 2 3 6 7 8 9}; do
        encode=$(least "$runs" target/release/lidarpc -q encode "$folder" -o "$work/drive.lpc" --threads 1 --force --level $level)
        decode=$(least "$runs" target/release/lidarpc -q decode "$work/drive.lpc" -o "$work/drive" --threads 1 --force)
        diff -r "$work/drive" "$folder" >&2
        row "$name" "level $level" "$(size "$work/drive.lpc")" "$original" "$encode" "$decode" "$frames"
        rm -r "$work/drive"
    done
    for level in 3 19; do
        mkdir "$work/packed" "$work/back"
        encode=$(least $((level == 3 ? runs : 1)) zstd -$level -q -f --output-dir-flat "$work/packed" "$folder"/*.bin)
        decode=$(least "$runs" zstd -d -q -f --output-dir-flat "$work/back" "$work"/packed/*.zst)
        row "$name" "zstd -$level" "$(size "$work"/packed/*)" "$original" "$encode" "$decode" "$frames"
        rm -r "$work/packed" "$work/back"
    done
done
