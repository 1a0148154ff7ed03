#!/bin/sh
# Bring Blender for the backend cycles and its tests: install_blender.sh PYTHON, that of glrender's environment.
# PyPI's bpy (0.4 GB) fits one Python and holds NumPy below 2, so it gets an environment of its own. Where it
# cannot be had, the tests that need it are skipped, loudly.
set -eu
. "${0%/*}/apt.sh"
glrender_python=$1

works() {
    "$glrender_python" - <<'PYTHON' 2>/dev/null
from glrender.engines.cycles.process import BlenderProcess
blender = BlenderProcess()
print(f"Blender {blender.version} is here")
blender.close()
PYTHON
}

works && exit 0
venv=$("$glrender_python" -c 'from glrender.engines.cycles import finder; print(finder.own_python().parent.parent)')
echo "Blender is missing: installing PyPI's bpy into $venv for the backend cycles" >&2
for python in "$glrender_python" python3.11 python3.13; do
    command -v "$python" >/dev/null || continue
    "$python" -m venv --clear "$venv" || continue
    if "$venv/bin/python" -m pip install --no-compile --quiet --disable-pip-version-check --retries 5 'bpy>=4.2'; then
        works && exit 0
        # Blender opens no window, but needs the libraries for one.
        apt_install libegl1 libgl1 libsm6 libxfixes3 libxi6 libxkbcommon0 libxrender1 libxt6 libxxf86vm1 || true
        works && exit 0
    fi
done
rm -rf "$venv"
echo "BLENDER IS NOT HERE: the tests of the backend cycles CANNOT RUN; set GLRENDER_BLENDER, or try again with" \
     "'make blender'" >&2
