#!/usr/bin/env bash
# Checks that the library, the program, the tests and the benchmarks compile for Windows and macOS, and the library with the Python
# module too: tests/other_systems.sh [TARGET...]
#
# Nothing is linked or run. The standard library of a target is rustup's (`rustup target add TARGET`) or made of its sources, with
# the compiler that .ci/debian_rust finds. The C of zstd and lz4 is compiled by CC_... where that is set, by MinGW's gcc for Windows
# (Debian: gcc-mingw-w64-x86-64), and otherwise not at all: `true` stands in for the compiler, for a check takes no objects.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
targets=("$@")
[ ${#targets[@]} -gt 0 ] || targets=(x86_64-pc-windows-gnu x86_64-apple-darwin aarch64-apple-darwin)
export CARGO_INCREMENTAL=0 CARGO_PROFILE_DEV_DEBUG=false
# A Python of the target is not needed for what works with all from 3.10 on.
export PYO3_NO_PYTHON=1
for target in "${targets[@]}"; do
    name=${target//-/_}
    c_compiler="CC_$name" archiver="AR_$name"
    if [ -z "${!c_compiler:-}" ]; then
        case $target in
        *-windows-gnu) found=$(command -v "${target%%-*}-w64-mingw32-gcc" "${target%%-*}-w64-mingw32-gcc-posix" | head -n 1) || found= ;;
        *) found= ;;
        esac
        if [ -n "$found" ]; then
            export "$c_compiler=$found"
        else
            echo "$target: no C compiler, so C is not compiled"
            export "$c_compiler=true" "$archiver=true"
            # Where Apple's headers are is asked of a program that macOS alone has.
            case $target in *-apple-*) export SDKROOT=/ ;; esac
        fi
    fi
    # What runs while it compiles need not be fast.
    options=(--locked --target "$target" --target-dir target/other --config 'profile.dev.package."*".opt-level=0')
    if rustup target list --installed 2>/dev/null | grep -qx "$target"; then
        unset RUSTC RUSTC_BOOTSTRAP
    elif RUSTC=$(.ci/debian_rust); then
        # RUSTC_BOOTSTRAP: to build the standard library is not among what is stable.
        export RUSTC RUSTC_BOOTSTRAP=1
        options+=(-Zbuild-std)
    else
        echo "skipped: $target, for there is no standard library for it; rustup target add $target"
        continue
    fi
    cargo check "${options[@]}" --all-targets
    cargo check "${options[@]}" --lib --features python
    echo "$target: compiles"
done
