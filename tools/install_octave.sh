#!/bin/sh
# Bring what the tests of clients/simulink need: GNU Octave with instrument-control, and a C compiler.
# Where they cannot be had, those tests are skipped, loudly.
set -eu
. "$(dirname "$0")/apt.sh"

works() {
    for program in mkoctfile gnuplot gs cc c++; do
        command -v $program >/dev/null || return 1
    done
    octave-cli -q --no-history --no-init-file --eval 'pkg load instrument-control' >/dev/null 2>&1
}

works && exit 0
echo "GNU Octave, its mkoctfile, gnuplot, Ghostscript or a C compiler is missing: installing them" >&2
# It draws the tutorial's pictures with gnuplot, in a font that it looks for by name.
apt_install octave octave-dev octave-instrument-control gcc g++ libc6-dev gnuplot-nox ghostscript fonts-freefont-otf ||
    true
works && exit 0
echo "OCTAVE IS NOT HERE: the tests of clients/simulink CANNOT RUN; try again with 'make octave'" >&2
