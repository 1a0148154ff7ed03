#!/bin/sh
# Bring what peers need when they are measured: a new LLVM for Mitsuba 3, which newer processors want, and libusb for
# Open3D, which opens no device.
set -eu
. "$(dirname "$0")/apt.sh"
echo "LLVM or libusb is missing, or old: installing them for Mitsuba 3 and Open3D" >&2
apt_install libusb-1.0-0 libllvm19 || apt_install libusb-1.0-0 libllvm18 || apt_install libusb-1.0-0 libllvm17
