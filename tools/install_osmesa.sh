#!/bin/sh
# Bring OSMesa, Mesa's rasteriser without a display server, which tests compare with EGL: install_osmesa.sh GLRENDER
# Mesa 25.1 and later have none: then the tests of it are skipped, loudly.
set -eu
glrender=$1
. "$(dirname "$0")/apt.sh"

works() { "$glrender" doctor 2>/dev/null | grep -q "^ok *OpenGL by osmesa "; }

works && exit 0
echo "OSMesa is missing: installing it for the tests" >&2
apt_install libosmesa6 || true
works && exit 0
echo "OSMESA IS NOT HERE: the tests that compare it with EGL CANNOT RUN; try again with 'make osmesa'" >&2
