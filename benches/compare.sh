#!/usr/bin/env bash
# Sizes and CPU time against zstd and xz, on one core, for each folder of KITTI .bin files named.
# Needs the programs zstd and xz. Usage: benches/compare.sh FOLDER...
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
cargo build --release --quiet
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# CPU seconds of a command, user and system.
cpu() { local TIMEFORMAT='%U %S'; { time "$@" >"$work/out" 2>"$work/err"; } 2>&1 | awk '{ print $1 + $2 }'; }
each() { local folder=$1; shift; for file in "$folder"/*.bin; do "$@" "$file"; done; }
size() { stat -c %s "$1"; }

printf '%-18s %8s %8s %8s %9s %9s %9s %9s %9s\n' folder lidarpc zstd-19 xz-9e enc/zstd dec/enc 'enc ms' 'dec ms' 'zstd ms'
for folder in "$@"; do
    encode=$(cpu target/release/lidarpc -q encode "$folder" -o "$work/drive.lpc" --threads 1 --force)
    decode=$(cpu target/release/lidarpc -q decode "$work/drive.lpc" -o "$work/drive" --threads 1)
    diff -r "$work/drive" "$folder" >&2 && rm -r "$work/drive"
    zstd=$(cpu each "$folder" zstd -19 -q -c) && mv "$work/out" "$work/zstd"
    xz=$(cpu each "$folder" xz -9e -c) && mv "$work/out" "$work/xz"
    original=$(each "$folder" size | awk '{ s += $1 } END { print s }')
    frames=$(find "$folder" -maxdepth 1 -name '*.bin' | wc -l)
    awk -v name="$(basename "$folder")" -v o="$original" -v l="$(size "$work/drive.lpc")" -v z="$(size "$work/zstd")" \
        -v x="$(size "$work/xz")" -v e="$encode" -v d="$decode" -v zt="$zstd" -v n="$frames" 'BEGIN {
        printf "%-18s %7.2f%% %7.2f%% %7.2f%% %9.3f %9.3f %9.0f %9.0f %9.0f\n",
            name, 100 * l / o, 100 * z / o, 100 * x / o, e / zt, d / e, 1e3 * e / n, 1e3 * d / n, 1e3 * zt / n }'
done
