"""One frame without a server: a scene file, a state, an irradiance image and the range to every pixel.

    python examples/render_state.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from glrender import Pose, Renderer, State, frames, load_scene

scene = load_scene(Path(__file__).with_name("contact_binary.toml"))
r_spacecraft_m = np.array([2000.0, -3500.0, 800.0])
state = State(
    t_s=0.0,
    r_sun_inertial_m=[1.0e11, -1.5e11, 0.0],
    spacecraft=Pose(r_inertial_m=r_spacecraft_m, q_from_inertial=frames.look_at(r_spacecraft_m, np.zeros(3))),
    bodies={"primary": Pose(r_inertial_m=np.zeros(3)), "moonlet": Pose(r_inertial_m=[0.0, -600.0, 200.0])},
)
with Renderer(scene) as renderer:
    image = renderer.render(state, products=["range", "body_id"])
    frame = scene.camera("navcam").expose(image.irradiance_W_m2, seed=7, exposure_s="auto", roi=image.roi)
sys.stdout.write(f"irradiance {image.irradiance_W_m2.sum():.4g} W/m2 in all, nearest point at "
                 f"{np.nanmin(image.products['range']):.2f} m, predicted error {image.plan.predicted_error:.3f}, "
                 f"frame {frame.dn.shape} {frame.dn.dtype} exposed {frame.exposure_s:.4g} s\n")
