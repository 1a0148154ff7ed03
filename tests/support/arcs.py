"""An arc of views about a body, for photogrammetry."""

from __future__ import annotations

import numpy as np
from glrender import Body, PinholeCamera, Pose, Scene, State, frames
from glrender.brdf import Lambert
from glrender_camera import CameraModel
from glrender_navigation import Camera
from glrender_photogrammetry import PosedFrame

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


def ball_frames(radius_m, material):
    """Three frames of a ball with Lommel and Seeliger's law in closed form, times a material by the place (..., 3)."""
    camera = Camera(width_px=256, height_px=256, focal_length_px=1000.0)
    sun, found = np.array([0.6, 0.0, 0.8]), []
    for k, angle in enumerate(np.radians([-20.0, 0.0, 20.0])):
        back = np.array([np.cos(angle), np.sin(angle), 0.0])
        axes, place_m = np.array([[-back[1], back[0], 0.0], [0.0, 0.0, -1.0], -back]), 10.0 * radius_m * back
        y, x = np.indices((256, 256))
        ray = camera.direction(np.stack([x, y], axis=-1)) @ axes
        middle = -(ray @ place_m)
        under = middle**2 - (99.0 * radius_m**2)
        up = (place_m + (middle - np.sqrt(np.maximum(under, 0.0)))[..., None] * ray) / radius_m
        mu0, mu = np.maximum(up @ sun, 0.0), np.abs((up * ray).sum(axis=-1))
        image = np.where(under > 0.0, material(up) * mu0 / np.maximum(mu0 + mu, 1e-9), 0.0)
        found.append(PosedFrame(name=str(k), image=image, camera=camera, body="ball", camera_from_body=axes,
                                r_camera_body_m=place_m, sun_direction_body=sun))
    return found
