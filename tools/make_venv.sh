#!/bin/sh
# Make the virtual environment with all that the demo and the tests need: make_venv.sh PYTHON VENV
set -eu
python=$1 venv=$2

if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    echo "glrender needs Python 3.11 or later as '$python'; name another: make PYTHON=python3.12 ..." >&2
    exit 1
fi
if ! "$python" -m venv --clear "$venv" >/dev/null 2>&1; then
    echo "Python's venv, a package of its own on Debian and Ubuntu, is missing: installing it" >&2
    . "$(dirname "$0")/apt.sh"
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    apt_install "python$version-venv" || apt_install python3-venv
    "$python" -m venv --clear "$venv"
fi
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -e '.[test]'
# Loops are compiled now, not at the first start.
"$venv/bin/python" -c 'import glrender.renderer' || echo "rays and areas are not here (above)" >&2
