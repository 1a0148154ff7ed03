"""Light time and aberration of bodies against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import Pose, State, frames
from glrender.base.constants import AU_M
from glrender.base.errors import SceneError
from glrender.view.light_time import apparent_state

C_M_S = 299792458.0


def state(v_body=(0.0, 0.0, 0.0), v_craft=(0.0, 0.0, 0.0), r_body=(0.0, 0.0, 3e9), **body):
    return State(r_sun_inertial_m=[AU_M, 0.0, 0.0],
                 spacecraft=Pose(r_inertial_m=np.zeros(3), v_inertial_m_s=v_craft),
                 bodies={"body": Pose(r_inertial_m=r_body, v_inertial_m_s=v_body, **body)})


def test_a_body_is_seen_where_it_was_when_its_light_left():
    """Straight motion: it left the place that is seen as long ago as light takes from there, 1e-12 of the range."""
    for v in ([2e4, 1e4, -3e4], [-0.3 * C_M_S, 0.2 * C_M_S, 0.6 * C_M_S], [0.0, 0.0, 0.0]):
        r = np.array([4e8, -2e8, 3e9])
        seen = apparent_state(state(v, r_body=r), aberration=False).bodies["body"].r_inertial_m
        delay_s = np.linalg.norm(seen) / C_M_S
        np.testing.assert_allclose(seen + np.array(v) * delay_s, r, atol=3e-3)
        assert 5.0 < delay_s < 25.0


def test_a_body_is_turned_back_by_its_light_time():
    """At 1e-3 rad/s about its z axis: 0.01 rad at 10 light seconds, 1e-9."""
    seen = apparent_state(state(r_body=(0.0, 0.0, 10.0 * C_M_S), angular_velocity_rad_s=(0.0, 0.0, 1e-3)),
                          aberration=False).bodies["body"]
    turned = frames.dcm(seen.q_from_inertial) @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(turned, [np.cos(0.01), np.sin(0.01), 0.0], atol=1e-9)


def test_a_body_is_aberrated_as_a_star_is():
    """tan(b'/2) = sqrt((1-v/c)/(1+v/c)) tan(b/2), 1e-12 rad, at the same range; the Sun as well."""
    before = state(v_craft=(3e4, 0.0, 0.0))
    after = apparent_state(before, light_time=False)
    seen = after.bodies["body"].r_inertial_m
    beta = 3e4 / C_M_S
    expected = 2.0 * np.arctan(np.sqrt((1.0 - beta) / (1.0 + beta)))
    np.testing.assert_allclose(np.arctan2(seen[2], seen[0]), expected, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(seen), 3e9, rtol=1e-12)
    # The Sun is straight ahead.
    np.testing.assert_allclose(after.r_sun_inertial_m, before.r_sun_inertial_m, rtol=1e-12)


def test_a_missing_velocity_is_named():
    nowhere = State(r_sun_inertial_m=[AU_M, 0.0, 0.0], spacecraft=Pose(r_inertial_m=np.zeros(3)),
                    bodies={"body": Pose(r_inertial_m=[0.0, 0.0, 1e6])})
    with pytest.raises(SceneError, match=r"state\.bodies\.body\.v_inertial_m_s: missing"):
        apparent_state(nowhere)
    with pytest.raises(SceneError, match=r"state\.spacecraft\.v_inertial_m_s: missing"):
        apparent_state(nowhere, light_time=False)
    assert apparent_state(nowhere, light_time=False, aberration=False).bodies["body"].r_inertial_m[2] == 1e6
