#!/bin/sh
# Bring systemd-analyze, which a test checks the service's unit with; nothing of systemd is started. Where it cannot be
# had, that test is skipped, loudly.
set -eu
. "$(dirname "$0")/apt.sh"

works() { command -v systemd-analyze >/dev/null; }

works && exit 0
echo "systemd-analyze is missing: installing systemd for the test of the service's unit" >&2
apt_install systemd || true
works && exit 0
echo "SYSTEMD-ANALYZE IS NOT HERE: the service's unit CANNOT BE CHECKED; try again with 'make systemd'" >&2
