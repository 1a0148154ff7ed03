#!/bin/sh
# Bring what is missing of Mesa's EGL and OSMesa: install_opengl.sh GLRENDER
# One that works is enough; in CI both are wanted, because a test compares them.
set -eu
glrender=$1
. "$(dirname "$0")/apt.sh"

works() { "$glrender" doctor 2>/dev/null | grep -q "^ok *OpenGL by $1 "; }

found=
works egl || { echo "EGL does not work here: installing Mesa" >&2
    apt_install libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri || true; }
works egl && found=egl
if [ -z "$found" ] || [ "${CI:-}" = true ]; then
    # Mesa 25.1 and later have no OSMesa: then EGL has to do.
    works osmesa || apt_install libosmesa6 2>/dev/null || true
    works osmesa && found="$found osmesa"
fi
if [ -z "$found" ]; then
    "$glrender" doctor >&2 || true
    exit 1
fi
