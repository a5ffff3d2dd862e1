#!/usr/bin/env bash
# Keeps of what fuzzing has gathered, by default in fuzz/corpus, some of the fewest inputs that reach all that it reaches, those that are
# small, in fuzz/kept: fuzz/keep.sh [CORPUS]. tests/fuzz.rs replays them, and fuzz/run.sh starts from them.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
corpus=$(realpath "${1:-fuzz/corpus}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export RUSTC_BOOTSTRAP=1
for folder in "$corpus"/*/; do
    target=$(basename "$folder")
    mkdir "$work/$target"
    cargo fuzz run --sanitizer none --no-trace-compares "$target" "$work/$target" "$folder" -- \
        -set_cover_merge=1 -timeout=100 -artifact_prefix="$work/" -max_len=4096
done
unset RUSTC_BOOTSTRAP
LIDARPC_CORPUS=$work cargo test --locked --test fuzz -- --ignored --exact keep --nocapture
