#!/bin/sh
# Makes everything.wasm: needs clang and lld with the target wasm32-wasi, its C library and its builtins.
# Debian: clang lld wasi-libc libclang-rt-14-dev-wasm32
set -eu
cd "$(dirname "$0")"
core="$(mktemp)"
trap 'rm -f "$core"' EXIT
clang --target=wasm32-wasi -mexec-model=reactor -Os -Wall -Wl,--strip-all -Wl,-z,stack-size=16384 everything.c -o "$core"
cargo run -q -p holdpoint-component --example encode_guest -- "$core" everything.wasm
