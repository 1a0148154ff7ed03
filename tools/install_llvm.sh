#!/bin/sh
# Bring the LLVM that Mitsuba 3 compiles with when it is measured: older ones fail on newer processors.
set -eu
. "$(dirname "$0")/apt.sh"
echo "LLVM is missing, or old: installing it for Mitsuba 3" >&2
apt_install libllvm19
