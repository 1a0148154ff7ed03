#!/bin/sh
# Bring an OpenGL that draws without a display, Mesa's EGL or else OSMesa: install_opengl.sh GLRENDER
set -eu
glrender=$1
. "$(dirname "$0")/apt.sh"

works() { "$glrender" doctor 2>/dev/null | grep -q "^ok *OpenGL by $1 "; }

works egl && exit 0
echo "EGL does not work here: installing Mesa" >&2
apt_install libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri || true
works egl && exit 0
works osmesa || apt_install libosmesa6 || true
works osmesa && exit 0
"$glrender" doctor >&2 || true
exit 1
