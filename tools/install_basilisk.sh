#!/bin/sh
# Bring Basilisk with its image processing, which takes its images from glrender in tests/vizard, and whose attitudes
# tests/system/test_attitudes.py reads: install_basilisk.sh PYTHON, that of glrender's environment. bsk holds Pillow
# below ours, so it gets an environment of its own (650 MB). Where it cannot be had, those tests are skipped,
# loudly.
set -eu
glrender_python=$1
venv=$("$glrender_python" -c 'from glrender.base.disk_cache import cache_folder; print(cache_folder() / "basilisk")')

works() { "$venv/bin/python" -c 'from Basilisk.utilities import vizSupport; from Basilisk.fswAlgorithms import limbFinding' \
    2>/dev/null; }

works && exit 0
echo "Basilisk is missing: installing bsk and bsk-opnav into $venv for the tests" >&2
if "$glrender_python" -m venv --clear "$venv"; then
    pip="$venv/bin/python -m pip install --no-compile --quiet --disable-pip-version-check --retries 5"
    $pip 'bsk[opnav]>=2.12' || true
    works && exit 0
fi
rm -rf "$venv"
echo "BASILISK IS NOT HERE: what it says of attitudes, and its flights on our images, CANNOT BE TRIED; try again with 'make basilisk'" >&2
