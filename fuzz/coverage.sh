#!/usr/bin/env bash
# Lines of the library that the tests of damaged, forged and odd input reach, file by file: fuzz/coverage.sh [CORPUS]
# With CORPUS, a folder with a folder of inputs for each fuzz target, those too. Needs llvm-profdata and llvm-cov of the compiler's
# LLVM (`rustc -vV` says which), in LLVM_BIN if not on the path; Debian: llvm-22, LLVM_BIN=/usr/lib/llvm-22/bin.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export LIDARPC_CORPUS=${1:+$(realpath "$1")}
tools=${LLVM_BIN:+$LLVM_BIN/}
target=target/coverage
export CARGO_INCREMENTAL=0 CARGO_PROFILE_DEV_DEBUG=line-tables-only
export RUSTFLAGS="-C instrument-coverage" LLVM_PROFILE_FILE="$PWD/$target/profiles/%m-%p.profraw"
rm -rf "$target/profiles"
tests=(--test fuzz --test all)
cargo test --locked --target-dir "$target" --test fuzz
cargo test --locked --target-dir "$target" --test all -- hostile:: damage:: golden::
"${tools}llvm-profdata" merge -sparse "$target"/profiles/*.profraw -o "$target/all.profdata"
mapfile -t programs < <(cargo test --locked --target-dir "$target" "${tests[@]}" --no-run --message-format=json |
    sed -n 's/.*"executable":"\([^"]*\)".*"test":true.*/\1/p; s/.*"test":true.*"executable":"\([^"]*\)".*/\1/p' | sort -u)
"${tools}llvm-cov" report --instr-profile "$target/all.profdata" "${programs[0]}" "${programs[@]/#/--object=}" \
    --ignore-filename-regex '/(\.cargo|rustc|rustup|tests|fuzz)/|src/(cli|study|python|wasm|recordings)' --show-region-summary=false \
    --show-branch-summary=false
