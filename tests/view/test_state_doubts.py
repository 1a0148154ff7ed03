"""Limits of what a state may say without a warning, and of what it may say at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import ConfigError, Pose
from glrender.base.plausible import FASTEST_CRAFT_RAD_S
from glrender.brdf import Lambert
from glrender.view.plausible import state_doubts

GREY = Lambert(normal_albedo=0.2)


@pytest.mark.parametrize("within_share, codes", [(-0.1, []), (0.007, []), (0.015, ["overlap"])])
def test_bodies_that_touch_are_apart_and_others_overlap(within_share, codes):
    """Spheres, the smaller of 20 m, within each other by a share of that: its facets have 0.3 % less than it."""
    bodies = [views.sphere(GREY, 5, name="large"), views.sphere(GREY, 5, radius_m=20.0, name="small")]
    hulls = {body.name: body.hull for body in bodies}
    radii_m = [hull.solid_radius_m for hull in hulls.values()]
    apart_m = sum(radii_m) - within_share * min(radii_m)
    state = views.state(bodies=("large", "small"), range_m=1e4)
    state = replace(state, bodies={**state.bodies, "small": Pose(r_inertial_m=[0.0, apart_m, 0.0],
                                                                 q_from_inertial=[1.0, 0.0, 0.0, 0.0])})
    assert [doubt.code for doubt in state_doubts(state, hulls)] == codes


@pytest.mark.parametrize("times, is_doubted", [(7.0, False), (14.0, True)])
def test_a_spacecraft_may_turn_some_times_faster_than_what_it_passes(times, is_doubted):
    """Past a body at 100 m and 100 m/s the line of sight turns by 1 rad/s, above what is usual of a spacecraft."""
    body = views.sphere(GREY, 1, radius_m=1.0)
    state = views.state(range_m=100.0)
    rate_rad_s = 1.0
    assert rate_rad_s > FASTEST_CRAFT_RAD_S
    moving = replace(state.spacecraft, v_inertial_m_s=[100.0 / times, 0.0, 0.0],
                     angular_velocity_rad_s=[0.0, rate_rad_s, 0.0])
    found = state_doubts(replace(state, spacecraft=moving), {"body": body.hull})
    assert bool(found) == is_doubted


def test_a_pose_turns_at_most_160_times_a_second():
    """Beyond it degrees were given, or a rate per day."""
    pose = {"r_inertial_m": np.zeros(3), "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}
    Pose(**pose, angular_velocity_rad_s=[0.0, 0.0, 150.0 * 2.0 * np.pi])
    with pytest.raises(ConfigError, match="angular_velocity_rad_s: must be within 1000 rad/s"):
        Pose(**pose, angular_velocity_rad_s=[0.0, 0.0, 170.0 * 2.0 * np.pi])
