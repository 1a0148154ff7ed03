"""The closest approach is where and when it was asked for, at the asked side of the Sun."""

from __future__ import annotations

import numpy as np
import orbits
import pytest
from glrender import ConfigError
from glrender.base.constants import GM_SUN_M3_S2
from glrender.scenario import Encounter, Epoch, Kepler
from missing import needed_module
from orbits import DATE
from scipy.optimize import brentq

SIDES = [{"side": "terminator"}, {"side": "sunlit"}, {"side": "dark"}, {"phase_angle_deg": 70.0},
         {"phase_angle_deg": 70.0, "over": "south"}]
DISTANCE_M = 2e5


def encounter(**fields):
    return Encounter(**{"body": "didymos", "body_trajectory": orbits.didymos(), "distance_m": DISTANCE_M,
                        "relative_velocity_m_s": 1e4, "date": DATE, "duration_s": 600.0, **fields})


def phase_deg(made):
    r, r_body = made.closest_approach[0], made.body_trajectory.at(made.date, np.zeros(1))[0][0]
    return np.degrees(np.arccos(-r @ r_body / np.linalg.norm(r) / np.linalg.norm(r_body)))


@pytest.mark.parametrize("velocity_m_s, duration_s", [(50.0, 600.0), (50.0, 2 * 86400.0), (1e3, 7200.0), (1e4, 600.0),
                                                      (1e4, 86400.0)])
@pytest.mark.parametrize("side", SIDES, ids=str)
def test_the_motion_is_that_of_two_orbits_integrated(velocity_m_s, duration_s, side):
    """DOP853 of both orbits about the Sun over the whole duration: within 1 mm of 1 m that was asked for."""
    made = encounter(relative_velocity_m_s=velocity_m_s, duration_s=duration_s, **side)
    times = np.linspace(0.0, duration_s, 41)
    r, _ = made.at(made.start, times)
    (r_body,), (v_body,) = made.body_trajectory.at(DATE, np.zeros(1))
    r0, v0 = made.closest_approach
    for half in (slice(0, 20), slice(21, 41)):
        truth = orbits.integrated_pair(r_body, v_body, r_body + r0, v_body + v0, times[half] - 0.5 * duration_s)
        np.testing.assert_allclose(r[half], truth, atol=1e-3)


@pytest.mark.parametrize("velocity_m_s", [50.0, 1e3, 1e4])
@pytest.mark.parametrize("side", SIDES, ids=str)
def test_the_closest_approach_is_where_and_when_it_was_asked_for(velocity_m_s, side):
    """By SPICE's two-body propagation of both orbits: to 1 m and 1 ms, from the root of r . v."""
    spice = needed_module("spiceypy", "pip install -e '.[test]'")
    made = encounter(relative_velocity_m_s=velocity_m_s, **side)
    (r_body,), (v_body,) = made.body_trajectory.at(DATE, np.zeros(1))
    r0, v0 = made.closest_approach

    def relative(dt_s):
        states = [spice.prop2b(GM_SUN_M3_S2 / 1e9, np.concatenate([r, v]) / 1e3, dt_s) * 1e3
                  for r, v in ((r_body, v_body), (r_body + r0, v_body + v0))]
        return states[1] - states[0]

    when = brentq(lambda dt: relative(dt)[:3] @ relative(dt)[3:], -10.0, 10.0, xtol=1e-9)
    assert abs(when) < 1e-3
    np.testing.assert_allclose(np.linalg.norm(relative(when)[:3]), DISTANCE_M, atol=1.0)
    np.testing.assert_allclose(np.linalg.norm(relative(when)[3:]), velocity_m_s, rtol=1e-6)
    # And so in what the product gives, also of the whole: no other time is nearer.
    times = made.duration_s * np.linspace(0.0, 1.0, 2001)
    ranges = np.linalg.norm(made.at(made.start, times)[0], axis=1)
    assert np.argmin(ranges) == 1000 and abs(ranges[1000] - DISTANCE_M) < 1e-9


def test_sides_and_phase_angles_are_those_asked_for():
    """Sunlit: the least phase that the flight allows; dark: 180 deg less that; terminator: 90 deg."""
    least = phase_deg(encounter(side="sunlit"))
    (r_body,), (v_body,) = orbits.didymos().at(DATE, np.zeros(1))
    # The Sun's direction and the flight's are off the right angle by as much as the pass is off phase 0.
    off = np.degrees(np.arcsin(abs(r_body @ v_body) / np.linalg.norm(r_body) / np.linalg.norm(v_body)))
    np.testing.assert_allclose(least, off, atol=1e-9)
    np.testing.assert_allclose(phase_deg(encounter(side="dark")), 180.0 - least, atol=1e-9)
    np.testing.assert_allclose(phase_deg(encounter(side="terminator")), 90.0, atol=1e-9)
    for asked in (20.0, 70.0, 90.0, 150.0):
        north, south = (encounter(phase_angle_deg=asked, over=over) for over in ("north", "south"))
        np.testing.assert_allclose([phase_deg(north), phase_deg(south)], asked, atol=1e-9)
        assert north.closest_approach[0][2] > 0.0 > south.closest_approach[0][2]


def test_the_direction_of_flight_is_the_one_asked_for():
    direction = np.array([1.0, 2.0, -0.5])
    r, v = encounter(side="terminator", direction=direction).closest_approach
    np.testing.assert_allclose(np.cross(v, direction), 0.0, atol=1e-9)
    np.testing.assert_allclose(r @ v, 0.0, atol=1e-3)


def test_a_slow_pass_is_bent_by_the_bodys_pull():
    """The hyperbola of 67P at 20 km and 1 m/s, in four days; the Sun's tide is within 2 % of its turn."""
    mu, v = 666.0, 1.0
    made = encounter(distance_m=20e3, relative_velocity_m_s=v, duration_s=4e5, side="terminator",
                     gravitational_parameter_m3_s2=mu)
    _, ends = made.at(made.start, np.array([0.0, 4e5]))
    turned = np.arccos(ends[0] @ ends[1] / np.prod(np.linalg.norm(ends, axis=1)))
    conic = Kepler(r_m=[20e3, 0.0, 0.0], v_m_s=[0.0, v, 0.0], epoch=DATE, about="b", gravitational_parameter_m3_s2=mu)
    away = conic.at(DATE, np.array([2e5]))[1][0]
    np.testing.assert_allclose(turned, 2.0 * np.arctan2(-away[0], away[1]), rtol=0.02)
    np.testing.assert_allclose(turned, 2.0 * mu / (20e3 * v**2), rtol=0.2)


@pytest.mark.parametrize("fields, message", [
    ({}, "side: needs exactly one of `side` and `phase_angle_deg`"),
    ({"side": "night"}, "side: must be one of 'sunlit', 'terminator', 'dark', got 'night'"),
    ({"phase_angle_deg": 1.0}, "for this direction of flight, got 1.0; give another `direction`"),
    ({"side": "sunlit", "distance_m": -1.0}, "distance_m: must be > 0"),
    ({"side": "sunlit", "direction": [0.0, 0.0, 0.0]}, "direction: must not be zero"),
    ({"side": "sunlit", "relative_velocity_m_s": 0.1, "gravitational_parameter_m3_s2": 1e4}, "give more than 0.2236"),
])
def test_an_encounter_that_cannot_be_is_refused(fields, message):
    with pytest.raises(ConfigError) as caught:
        encounter(**fields)
    assert message in str(caught.value)


def test_flight_along_the_sun_has_the_terminator_alone():
    sunward = -orbits.didymos().at(DATE, np.zeros(1))[0][0]
    np.testing.assert_allclose(phase_deg(encounter(side="terminator", direction=sunward)), 90.0, atol=1e-6)
    with pytest.raises(ConfigError, match="along the Sun's direction"):
        encounter(side="sunlit", direction=sunward)


def test_the_middle_is_at_the_date():
    assert encounter(side="dark").start == Epoch.from_tdb("2022-10-10T23:55:00")
