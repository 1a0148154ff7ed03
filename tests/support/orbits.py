"""Two-body truths that share no line with the product, and the orbit of a body to fly by."""

from __future__ import annotations

import numpy as np
from glrender.base.constants import GM_SUN_M3_S2
from glrender.scenario import Epoch, Kepler
from scipy.integrate import solve_ivp

DATE = Epoch.from_tdb("2022-10-11T00:00:00")
DIDYMOS = """
[[bodies]]
name = "didymos"
generated = { kind = "icosphere", radius_m = 400.0, subdivisions = 3 }
brdf = { law = "lambert", normal_albedo = 0.2 }
[bodies.orbit]
semi_major_axis_m = 2.4596e11
eccentricity = 0.3839
inclination_deg = 3.408
longitude_ascending_node_deg = 73.2
argument_of_periapsis_deg = 319.3
mean_anomaly_deg = 124.6
epoch_tdb = "2020-05-31T00:00:00"
"""


def didymos() -> Kepler:
    """Didymos about the Sun, as in SISPO's definition.json."""
    return Kepler.from_elements(
        semi_major_axis_m=2.4596e11, eccentricity=0.3839, inclination_deg=3.408, longitude_ascending_node_deg=73.2,
        argument_of_periapsis_deg=319.3, mean_anomaly_deg=124.6, epoch=Epoch.from_tdb("2020-05-31T00:00:00"))


def integrated_pair(r_body, v_body, r_craft, v_craft, times_s):
    """Relative positions (N, 3) [m] of two bodies that fall about the Sun, at times (N,) [s] of one sign, ascending."""
    def rates(t, y):
        r = y.reshape(4, 3)
        return np.concatenate([r[1], -GM_SUN_M3_S2 * r[0] / np.linalg.norm(r[0])**3,
                               r[3], -GM_SUN_M3_S2 * r[2] / np.linalg.norm(r[2])**3])

    sign = -1.0 if times_s[0] < 0.0 else 1.0
    ordered = np.sort(np.abs(times_s))
    solved = solve_ivp(lambda t, y: sign * rates(t, y), (0.0, ordered[-1]),
                       np.concatenate([r_body, v_body, r_craft, v_craft]), method="DOP853", rtol=3e-14, atol=1e-9,
                       t_eval=ordered)
    relative = (solved.y[6:9] - solved.y[:3]).T
    return relative if sign > 0.0 else relative[::-1]


def small_orbit() -> Kepler:
    """An eccentric orbit about Didymos, twelve hours long."""
    return Kepler(r_m=[1200.0, 300.0, 500.0], v_m_s=[-0.02, 0.11, 0.12], epoch=DATE, about="didymos",
                  gravitational_parameter_m3_s2=35.0)
