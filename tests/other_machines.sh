#!/usr/bin/env bash
# Holds what the program does on another machine, under qemu-user, to what it does on this one: every golden stream
# decodes to the same bytes, and the test data and a simulated VLP-16 encode to the same streams.
#
#     tests/other_machines.sh aarch64-unknown-linux-gnu qemu-aarch64-static
#
# Needs qemu-user, a C compiler for the target, which CC_... and CARGO_TARGET_..._LINKER name, and its standard library: rustup's
# (`rustup target add TARGET`), or made of its sources with the compiler that OTHER_RUSTC or else .ci/debian_rust names. The
# sysroot that qemu needs is QEMU_LD_PREFIX. HERE names a program of this machine, if one is built already. In Debian:
#
#     aarch64-unknown-linux-gnu qemu-aarch64-static    gcc-aarch64-linux-gnu qemu-user-static    /usr/aarch64-linux-gnu
#     s390x-unknown-linux-gnu qemu-s390x-static        gcc-s390x-linux-gnu qemu-user-static      /usr/s390x-linux-gnu    big-endian
#
# The same processor with fewer vector units: x86_64-unknown-linux-gnu "qemu-x86_64-static -cpu Haswell" (AVX2, no AVX-512) or Nehalem.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
target=$1
qemu=$2
# Builds that are made sooner; what they compute is the same.
export CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16
here=${HERE:-target/other/release/lidarpc}
[ -n "${HERE:-}" ] || cargo build --release --locked --target-dir target/other
options=()
if ! rustup target list --installed 2>/dev/null | grep -qx "$target"; then
    OTHER_RUSTC=${OTHER_RUSTC:-$(.ci/debian_rust)} || { echo "no compiler for $target; rustup target add $target" && exit 1; }
    if [ ! -d "$("$OTHER_RUSTC" --print sysroot)/lib/rustlib/$target/lib" ]; then
        # RUSTC_BOOTSTRAP: to build the standard library is not among what is stable.
        export RUSTC_BOOTSTRAP=1
        options+=(-Zbuild-std)
    fi
fi
RUSTC=${OTHER_RUSTC:-rustc} cargo build --release --locked --target "$target" --target-dir target/other "${options[@]}"
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
    { $there decode "$stream" -o "$work/there" --force --quiet && diff -r "$work/here" "$work/there" >/dev/null; } ||
        differ "decoding $stream"
    rm -rf "$work/here" "$work/there"
done
echo "golden streams: $(ls testdata/golden/*.lpc | wc -l) decoded on both"
for folder in testdata/drive "$work/vlp16"; do
    for level in 1 2 3 6 7 8 9; do
        "$here" encode "$folder" -o "$work/here.lpc" --level $level --force --quiet
        $there encode "$folder" -o "$work/there.lpc" --level $level --force --quiet || true
        cmp -s "$work/here.lpc" "$work/there.lpc" || differ "encoding $(basename "$folder") at level $level"
        $there verify "$work/here.lpc" --against "$folder" --quiet || differ "verifying $(basename "$folder")"
    done
done
exit $failed
