#!/usr/bin/env bash
# Holds what the program does on another machine, under qemu-user, to what it does on this one: every golden stream
# decodes to the same bytes, and the test data and a simulated VLP-16 encode to the same streams.
#
#     tests/other_machines.sh aarch64-unknown-linux-gnu qemu-aarch64-static
#
# Needs the standard library of that target (`rustup target add TARGET`, or OTHER_RUSTC=... with one that has it), qemu-user, and
# a C compiler for it, which CC_... and CARGO_TARGET_..._LINKER name (Debian: gcc-aarch64-linux-gnu, qemu-user-static).
# The sysroot that qemu needs is QEMU_LD_PREFIX (Debian: /usr/aarch64-linux-gnu).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
target=$1
qemu=$2
cargo build --release --locked
here=target/release/lidarpc
RUSTC=${OTHER_RUSTC:-rustc} cargo build --release --locked --target "$target" --target-dir target/other \
    --config 'profile.release.lto="off"' --config profile.release.codegen-units=16
there="$qemu target/other/$target/release/lidarpc"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

failed=0
differ() {
    echo "DIFFERS: $*"
    failed=1
}
"$here" synth -o "$work/vlp16" --scanner vlp16 --frames 2 --quiet
for stream in testdata/golden/*.lpc; do
    "$here" decode "$stream" -o "$work/here" --force --quiet
    $there decode "$stream" -o "$work/there" --force --quiet
    diff -r "$work/here" "$work/there" >/dev/null || differ "decoding $stream"
    rm -r "$work/here" "$work/there"
done
echo "golden streams: $(ls testdata/golden/*.lpc | wc -l) decoded on both"
for folder in testdata/drive "$work/vlp16"; do
    for level in 1 2 3 6 7 8 9; do
        "$here" encode "$folder" -o "$work/here.lpc" --level $level --force --quiet
        $there encode "$folder" -o "$work/there.lpc" --level $level --force --quiet
        cmp -s "$work/here.lpc" "$work/there.lpc" || differ "encoding $(basename "$folder") at level $level"
        $there verify "$work/here.lpc" --against "$folder" --quiet || differ "verifying $(basename "$folder")"
    done
done
exit $failed
