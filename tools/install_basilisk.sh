#!/bin/sh
# Bring Basilisk, whose attitudes tests/system/test_attitudes.py reads: install_basilisk.sh PYTHON, that of glrender's
# environment. PyPI's bsk (70 MB) holds Pillow below ours, so it gets an environment of its own; what is tried there needs
# NumPy alone of all that bsk asks for. In CI it must be there; elsewhere those tests are skipped, loudly.
set -eu
glrender_python=$1
venv=$("$glrender_python" -c 'from glrender.base.disk_cache import cache_folder; print(cache_folder() / "basilisk")')

works() { "$venv/bin/python" -c 'from Basilisk.utilities import RigidBodyKinematics' 2>/dev/null; }

works && exit 0
echo "Basilisk is missing: installing PyPI's bsk into $venv for the tests of docs/conventions.md" >&2
if "$glrender_python" -m venv --clear "$venv"; then
    pip="$venv/bin/python -m pip install --quiet --disable-pip-version-check --retries 5"
    { $pip numpy && $pip --no-deps 'bsk>=2.8'; } || true
    works && exit 0
fi
rm -rf "$venv"
echo "BASILISK IS NOT HERE: what it says of attitudes CANNOT BE TRIED; try again with 'make basilisk'" >&2
[ "${CI:-}" != true ]
