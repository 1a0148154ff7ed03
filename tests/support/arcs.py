"""An arc of views about a body, for photogrammetry."""

from __future__ import annotations

import numpy as np
from glrender import Body, PinholeCamera, Pose, Scene, State, frames
from glrender.brdf import Lambert
from glrender_camera import CameraModel

SIZE_PX = 256
RANGE_M = 3000.0
STEP_DEG = 7.0
N_FRAMES = 10


def state(turn_deg, sun_deg=-50.0, spin_deg=0.0):
    """A camera above the equator at a longitude, that looks at the body's middle; the Sun at another."""
    def at(length_m, angle_deg, up_m):
        return np.array([length_m * np.cos(np.radians(angle_deg)), length_m * np.sin(np.radians(angle_deg)), up_m])

    place_m, half = at(RANGE_M, turn_deg, 300.0), np.radians(spin_deg) / 2.0
    return State(t_s=float(turn_deg), r_sun_inertial_m=at(2e11, sun_deg, 5e10), bodies={
        "body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=[np.cos(half), 0.0, 0.0, -np.sin(half)])},
        spacecraft=Pose(r_inertial_m=place_m, q_from_inertial=frames.look_at(place_m, np.zeros(3), [0.0, 0.0, 1.0])))


def scene(shape):
    camera = PinholeCamera(name="navcam", width_px=SIZE_PX, height_px=SIZE_PX, focal_length_px=1152.0,
                           model=CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": 5e-5}))
    return Scene(bodies=[Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.06))], cameras=[camera])
