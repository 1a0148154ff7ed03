#!/bin/sh
# Bring Mitsuba 3, the other path tracer that tests check the backend raytrace with: install_mitsuba.sh PYTHON, that of
# glrender's environment. Where it cannot be had, those tests are skipped, loudly.
set -eu
python=$1

works() { "$python" -c 'import mitsuba' 2>/dev/null; }

works && exit 0
echo "Mitsuba 3 is missing: installing the extra 'peers' for the tests of the backend raytrace" >&2
"$python" -m pip install --quiet --disable-pip-version-check --retries 5 -e '.[peers]' || true
works && exit 0
echo "MITSUBA 3 IS NOT HERE: tests/engines/rays/test_raytrace_mitsuba.py CANNOT RUN; try again with 'make mitsuba'" >&2
