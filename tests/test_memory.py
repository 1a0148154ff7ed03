"""Memory that frames leave to the next ones: page faults, which are the same on a busy machine."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

SCRIPT = """
import resource
import sys
sys.path.insert(0, {tests!r})
import views
from glrender import Body, Renderer, generate
from glrender.brdf import Lambert

shape = generate.gaussian_random_sphere(radius_m=100.0, seed=11, subdivisions=6)
scene = views.scene([Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))], [views.camera(1024, 10000.0)],
                    sun_disc=False)
with Renderer(scene) as renderer:
    def faults(n_frames):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(n_frames):
            renderer.render(views.state(phase_deg=60.0, range_m=4000.0), max_error=0.05)
        return (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / n_frames
    faults(10)
    print(faults(20))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library's malloc")
def test_a_frame_takes_no_memory_that_the_one_before_gave_back(pytestconfig):
    """In a fresh process: one that has freed large arrays does not show it. Pages of 4 KiB."""
    script = SCRIPT.format(tests=str(pytestconfig.rootpath / "tests"))
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300, check=False)
    assert out.returncode == 0, out.stderr
    assert float(out.stdout.split()[-1]) < 100.0, "a frame took so many pages anew"
