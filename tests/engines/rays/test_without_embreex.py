"""Machines for which embreex has no wheel (Linux on ARM): OpenGL draws, and what needs rays says so."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

_DRAWS = """
import sys
sys.modules["embreex"] = None
import views
from glrender import ConfigError, DeviceError, Renderer, open_renderer
from glrender.brdf import Lambert

scene = views.scene([views.sphere(Lambert(normal_albedo=0.2))], [views.camera()])
with Renderer(scene) as renderer:
    assert renderer.info["engines"] == ("raster",)
    image = renderer.render(views.state())
    assert {window.engine for window in image.plan.windows} == {"raster"} and image.irradiance_W_m2.any()
    for error, draw in ((ConfigError, lambda: renderer.render(views.state(), engine="rays")),
                        (DeviceError, lambda: open_renderer(scene, "raytrace"))):
        try:
            draw()
        except error as found:
            print(found)
"""


def test_opengl_draws_and_rays_are_refused_by_name():
    told = subprocess.run([sys.executable, "-c", _DRAWS], cwd=Path(__file__).parents[2] / "support",
                          capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    assert told.stdout.splitlines() == [
        "engine: must be one of raster, got 'rays'",
        "rays need embreex, which has no wheel for every machine: pip install embreex"]
