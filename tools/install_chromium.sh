#!/bin/sh
# Bring Chromium and its driver for the tests of the page of `glrender view`. Where they cannot be had, those
# tests are skipped, loudly.
set -eu
. "$(dirname "$0")/apt.sh"

works() {
    command -v chromium >/dev/null && command -v chromedriver >/dev/null && chromium --version >/dev/null 2>&1
}

works && exit 0
echo "Chromium or its driver is missing: installing them for the tests of the page of glrender view" >&2
apt_install chromium chromium-driver fonts-dejavu-core || true
works && exit 0
echo "CHROMIUM IS NOT HERE: the tests of the page CANNOT RUN; try again with 'make chromium'" >&2
