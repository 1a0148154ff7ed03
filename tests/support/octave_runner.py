"""GNU Octave for tests: found, or told loudly what is missing. `make test` installs it (tools/install_octave.sh)."""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

import serving
from missing import missing

REPOSITORY = Path(__file__).parents[2]
SIMULINK = REPOSITORY / "clients" / "simulink"
MARK = "GLRENDER CHECKED"
REMEDY = "sh tools/install_octave.sh brings it"
# With a camera of one byte a pixel.
SCENE = serving.SCENE + """
[[cameras]]
name = "byte"
width_px = 48
height_px = 40
focal_length_px = 200.0
[cameras.model]
exposure_s = 0.01
optics = { aperture_diameter_m = 0.01, psf_sigma_px = 0.5 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.006, bit_depth = 8, \
read_noise_electrons = 10.0 }
"""


@cache
def _octave():
    octave = shutil.which("octave-cli")
    if octave is None:
        return None
    # Without a display and without the user's settings.
    probe = subprocess.run([octave, "-q", "--no-history", "--no-init-file", "--eval", "pkg load instrument-control"],
                           capture_output=True, timeout=60)
    return octave if probe.returncode == 0 else None


def octave(script, *arguments, timeout=300, paths=(), environment=()):
    """Run tests/clients/octave/<script>; it must end with rc 0 and say its mark. Returns what it said."""
    program = _octave()
    if program is None:
        missing("GNU OCTAVE WITH INSTRUMENT-CONTROL", REMEDY)
    folders = [SIMULINK, REPOSITORY / "tests" / "clients" / "octave", *paths]
    run = subprocess.run([program, "-q", "--no-history", "--no-init-file",
                          *(word for folder in folders for word in ("--path", str(folder))),
                          str(REPOSITORY / "tests" / "clients" / "octave" / script), *map(str, arguments)],
                         capture_output=True, text=True, timeout=timeout, env={**os.environ, **dict(environment)})
    assert run.returncode == 0 and MARK in run.stdout, f"rc {run.returncode}\n{run.stdout}\n{run.stderr}"
    return run.stdout


def mkoctfile():
    """Octave's compiler of MEX functions."""
    if shutil.which("mkoctfile") is None:
        missing("OCTAVE'S MKOCTFILE (octave-dev)", REMEDY)


def compiler():
    """A C compiler with the address and undefined-behaviour sanitizers."""
    program = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
    if program is None:
        missing("A C COMPILER", REMEDY)
    return program
