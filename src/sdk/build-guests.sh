#!/usr/bin/env bash
# Builds the components of prebuilt/ from their sources:
#
#     src/sdk/build-guests.sh [--compare]
#
# Needs clang with lld, and cargo with the target wasm32-unknown-unknown (`rustup target add wasm32-unknown-unknown`). RUSTC,
# and what else cargo reads from the environment, hold for the components alone: where a compiler has no such target, cargo builds the
# standard library with CARGO_UNSTABLE_BUILD_STD=std,panic_abort and RUSTC_BOOTSTRAP=1.
# ENCODE names a program that makes components of modules; without it the crate `holdpoint-builder` is built for that.
#
# With --compare nothing is written: what was built is held against prebuilt/SHA256SUMS. Equal compilers give equal bytes
# wherever the sources lie; prebuilt/COMPILERS says which those are, and with others the script ends with 3 and says so.
set -euo pipefail
export LC_ALL=C CARGO_TERM_COLOR=never
cd "$(dirname "$0")"
sdk="$PWD"
target="${CARGO_TARGET_DIR:-$sdk/../../target}/guests"
rustc="${RUSTC:-rustc}"
out="$(mktemp -d)"
trap 'rm -rf "$out"' EXIT

# What is built with: of a compiler with another name or number, other bytes are expected.
compilers() {
    # A standard library that is built along has other bytes than one that comes with the compiler.
    echo "rustc $("$rustc" --version --verbose | sed -n 's/^release: //p;s/^commit-hash: //p' | paste -sd' ')"
    echo "LLVM $("$rustc" --version --verbose | sed -n 's/^LLVM version: //p')"
    echo "std ${CARGO_UNSTABLE_BUILD_STD:-of the compiler}"
    clang --version | head -1
}

sysroot="$("$rustc" --print sysroot)"
library="$(realpath "$sysroot/lib/rustlib/src/rust" 2>/dev/null || echo /none)"
flags=(-Clink-arg=-zstack-size=65536)
# No place shows in the bytes: of two that fit, the later is taken.
for place in "${CARGO_HOME:-$HOME/.cargo}=/cargo" "$sysroot=/rust" "$library=/rust" "$target=/target" \
    "$(realpath ..)=/src" "$sdk=/src/sdk"; do
    flags+=("--remap-path-prefix=$place")
done
# Encoded, for a place may have a space in its name.
CARGO_ENCODED_RUSTFLAGS="$(IFS=$'\x1f'; echo "${flags[*]}")"
export CARGO_ENCODED_RUSTFLAGS
cargo build --locked --release --target wasm32-unknown-unknown --target-dir "$target" \
    -p controllers -p faults -p template
built="$target/wasm32-unknown-unknown/release"
clang @templates/c/compile_flags.txt -Ic templates/c/grasp.c c/holdpoint_skill.c -o "$target/template-c.wasm"

encode() {
    if [ -n "${ENCODE:-}" ]; then "$ENCODE" "$@"; return; fi
    env -u RUSTC -u RUSTC_BOOTSTRAP -u RUSTFLAGS -u CARGO_ENCODED_RUSTFLAGS -u CARGO_UNSTABLE_BUILD_STD -u LD_LIBRARY_PATH \
        cargo run --quiet --locked -p holdpoint-builder --example encode -- "$@"
}
(cd ../.. && encode "$built/controllers.wasm" "$out/controllers.wasm" "$built/faults.wasm" "$out/faults.wasm" \
    "$built/template.wasm" "$out/template-rust.wasm" "$target/template-c.wasm" "$out/template-c.wasm")

if [ "${1:-}" = --compare ]; then
    if ! diff prebuilt/COMPILERS <(compilers); then
        echo "other compilers than those of prebuilt/COMPILERS: the bytes are not compared" >&2
        exit 3
    fi
    (cd "$out" && sha256sum --check "$sdk/prebuilt/SHA256SUMS")
else
    mkdir -p prebuilt
    cp "$out"/*.wasm prebuilt/
    compilers > prebuilt/COMPILERS
    (cd prebuilt && sha256sum -- *.wasm | tee SHA256SUMS)
fi
