#!/usr/bin/env bash
# Bits a point of the geometry (all but intensities) for largest errors from 2 mm to 50 mm, and exactly; and
# the largest error found: the table in docs/guide.md. For each folder of scans that is named.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
cargo build --release --quiet
program=target/release/lidarpc
stream=$(mktemp --suffix .lpc)
trap 'rm -f "$stream"' EXIT
for folder in "$@"; do
    for error in exact 2mm 5mm 10mm 20mm 50mm; do
        bound=()
        [ "$error" = exact ] || bound=(--max-error "$error")
        "$program" encode "$folder" -o "$stream" --level 9 --force --quiet "${bound[@]}"
        "$program" stats "$stream" --against "$folder" | awk -v name="$(basename "$folder") $error" '
            /^max error/ { max = $3 }
            /^bits a point/ { bits = $4 }
            /^intensity/ { intensity = $5 }
            END { printf "%s: %.2f bits a point, largest error %s m\n", name, bits - intensity, max }'
    done
done
