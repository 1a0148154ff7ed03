"""Equal requests give equal bytes: in fresh processes, whatever is kept on disk, beside whatever load."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

SUPPORT = Path(__file__).parents[1] / "support"
FRAMES = """
import hashlib, sys
sys.path.insert(0, sys.argv[1])
import views
from glrender import Body, Renderer, generate
from glrender.brdf import Hapke

law = Hapke(single_scattering_albedo=0.4, b=0.3, c=0.5, roughness_deg=20.0)
shape = generate.contact_binary(radius_m=100.0, seed=2, subdivisions=5)
with Renderer(views.scene([Body(name="body", shape=shape, brdf=law)], [views.camera(128, 1000.0)])) as renderer:
    for options in ({"max_error": 0.05}, {"max_error": 0.02}, {"max_error": 0.005},
                    {"max_error": 0.02, "engine": "rays"}, {"max_error": 0.02, "engine": "raster"}):
        for phase_deg, range_m in ((60.0, 2000.0), (110.0, 2000.0), (60.0, 60_000.0)):
            image = renderer.render(views.state(phase_deg=phase_deg, range_m=range_m), **options)
            window, = image.plan.windows
            print(options, phase_deg, range_m, window.engine, window.by_centroids, window.predicted_error.hex(),
                  hashlib.sha256(image.irradiance_W_m2.tobytes()).hexdigest())
"""


def test_two_fresh_processes_draw_the_same_bytes(tmp_path):
    """One with an empty folder of tables, one with none that can be written, and a third process that keeps a core."""
    load = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        folders = (tmp_path / "cache", Path("/proc/none"))
        runs = [subprocess.Popen([sys.executable, "-c", FRAMES, str(SUPPORT)], stdout=subprocess.PIPE,
                                 stderr=subprocess.PIPE, text=True, env={**os.environ, "GLRENDER_CACHE": str(folder)})
                for folder in folders]
        told = [run.communicate(timeout=240) for run in runs]
    finally:
        load.kill()
        load.wait()
    assert [run.returncode for run in runs] == [0, 0], told
    one, other = (lines.splitlines() for lines, _ in told)
    assert len(one) == 15 and one == other
    assert all(any(f" {engine} " in line for line in one) for engine in ("coverage True", "coverage False", "rays",
                                                                        "raster"))
    assert list((tmp_path / "cache").iterdir()), "the one keeps its tables, the other has none"
