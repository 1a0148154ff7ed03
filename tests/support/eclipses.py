"""A moon that may stand between a sphere and the Sun, and the shadows that it may cast; without GL."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import views
from glrender import Pose, frames
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.brdf import Lambert
from glrender.view.occluders import casters
from glrender.view.view import view_bodies

LAW, SUN_RAD = Lambert(normal_albedo=0.3), SUN_RADIUS_M / AU_M
FOCAL_PX = 400.0


def eclipsed(place_m, radius_m, phase_deg=0.0, sun_radius_rad=0.0):
    """A sphere of 100 m and a moon at a place [m]: along the Sun, and aside; the casters on the sphere."""
    bodies = [views.sphere(LAW, 4, 100.0, "body"), views.sphere(LAW, 4, radius_m, "moon")]
    scene = views.scene(bodies, [views.camera(64, FOCAL_PX)], sun_disc=sun_radius_rad > 0.0)
    state = views.state(phase_deg, bodies=("body", "moon"))
    aside_x, aside_y, sunward = frames.sun_from_body(state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m))
    along, x, y = place_m
    state = replace(state, bodies={**state.bodies, "moon": Pose(
        r_inertial_m=along * sunward + x * aside_x + y * aside_y)})
    seen = view_bodies(state, scene.cameras[0], scene.hulls)
    return casters(seen[0], seen, scene.hulls, sun_radius_rad), seen[0], scene, state
