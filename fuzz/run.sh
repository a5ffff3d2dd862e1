#!/usr/bin/env bash
# Fuzzes each target for so many seconds (or those named): fuzz/run.sh 900 [TARGET...]
# Needs cargo-fuzz (`cargo install cargo-fuzz`). What is found is in fuzz/artifacts/TARGET; move it to
# fuzz/regressions/TARGET once it is understood, where tests/fuzz.rs replays it.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
seconds=$1
shift
targets=("$@")
[ ${#targets[@]} -gt 0 ] || mapfile -t targets < <(ls fuzz/fuzz_targets | sed 's/\.rs$//')
cargo test --locked --test fuzz -- --ignored write_seeds --quiet
# The stable compiler has all that the fuzzer needs.
export RUSTC_BOOTSTRAP=1
# With no sanitiser and without following each comparison it is several times as fast.
# The C of zstd is not watched: compiled by another compiler than the sanitiser's, it gave a report (a variable
# used after its scope, inside the compressor) that has not come again without.
export CFLAGS="${CFLAGS:-} -fno-sanitize=address"
for target in "${targets[@]}"; do
    cargo fuzz run --sanitizer "${FUZZ_SANITIZER:-none}" --no-trace-compares "$target" -- -max_total_time="$seconds" -rss_limit_mb=2048 -timeout=20 -max_len=65536 -print_final_stats=1
done
