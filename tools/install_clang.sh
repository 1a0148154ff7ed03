#!/bin/sh
# Bring clang with libFuzzer, which guides the fuzzer of the C client by coverage. Without it the test goes on, blindly.
set -eu
. "$(dirname "$0")/apt.sh"

works() {
    folder=$(mktemp -d)
    echo 'int LLVMFuzzerTestOneInput(const char *d, unsigned long n) { return d && n > (1ul << 40); }' >"$folder/a.c"
    clang -fsanitize=fuzzer,address,undefined "$folder/a.c" -o "$folder/a" 2>/dev/null && is=0 || is=1
    rm -rf "$folder"
    return $is
}

works && exit 0
echo "clang with libFuzzer is missing: installing it for the fuzzer of the C client" >&2
apt_install clang libclang-rt-dev || apt_install clang "libclang-rt-14-dev" || true
works || echo "without clang the C client's replies are fuzzed without coverage's guidance" >&2
