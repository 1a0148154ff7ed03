"""Two-body motion against SPICE's own routines, which need no kernels."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import ConfigError
from glrender.base.constants import GM_SUN_M3_S2
from glrender.scenario import Epoch, Kepler, scenario_of_table
from glrender.scenario.kepler import EQUATORIAL_FROM_ECLIPTIC
from missing import needed_module

EPOCH = Epoch.from_et(1e8)
DAYS_S = 86400.0 * np.array([-3000.0, -11.0, 0.0, 1e-5, 7e-3, 35.0, 115.0, 11574.0])
ECCENTRICITIES = [0.0, 0.2, 0.64, 0.97, 0.9999, 1.0001, 1.2, 3.0, 10.0]


@pytest.fixture(scope="module")
def spice():
    return needed_module("spiceypy", "pip install -e '.[test]'")


def orbit(eccentricity, rng, frame="equatorial"):
    periapsis_m = rng.uniform(0.3, 3.0) * 1.5e11
    angles = rng.uniform([0.0, 0.0, 0.0, -3.0], [3.0, 6.0, 6.0, 3.0])
    degrees = dict(zip(["inclination_deg", "longitude_ascending_node_deg", "argument_of_periapsis_deg",
                        "mean_anomaly_deg"], np.degrees(angles), strict=True))
    made = Kepler.from_elements(semi_major_axis_m=periapsis_m / (1.0 - eccentricity), eccentricity=eccentricity,
                                epoch=EPOCH, frame=frame, **degrees)
    return made, [periapsis_m / 1e3, eccentricity, *angles, EPOCH.et_s, GM_SUN_M3_S2 / 1e9]


@pytest.mark.parametrize("eccentricity", ECCENTRICITIES)
def test_elements_are_those_of_conics(spice, rng, eccentricity):
    """spiceypy.conics; 1e-11 is 1.5 m at 1 au, of 1e-5 m that float64 could hold and near-parabolas lose."""
    for _ in range(10):
        made, elements = orbit(eccentricity, rng)
        state = spice.conics(elements, EPOCH.et_s) * 1e3
        np.testing.assert_allclose(made.r_m, state[:3], atol=1e-11 * np.linalg.norm(state[:3]))
        np.testing.assert_allclose(made.v_m_s, state[3:], atol=1e-11 * np.linalg.norm(state[3:]))


@pytest.mark.parametrize("eccentricity", ECCENTRICITIES)
def test_propagation_is_that_of_prop2b(spice, rng, eccentricity):
    """From 8 years before to 32 years after: within 2e-12 of the distance, 0.3 m at 1 au."""
    for _ in range(10):
        made, _ = orbit(eccentricity, rng)
        r, v = made.at(EPOCH, DAYS_S)
        for index, dt in enumerate(DAYS_S):
            state = spice.prop2b(GM_SUN_M3_S2 / 1e9, [*made.r_m / 1e3, *made.v_m_s / 1e3], dt) * 1e3
            np.testing.assert_allclose(r[index], state[:3], atol=2e-12 * np.linalg.norm(state[:3]))
            np.testing.assert_allclose(v[index], state[3:], atol=4e-12 * np.linalg.norm(state[3:]))


@pytest.mark.parametrize("eccentricity", [*ECCENTRICITIES, 1.0, 1.0 - 1e-12, 1.0 + 1e-12])
@pytest.mark.parametrize("frame", ["equatorial", "ecliptic"])
def test_comets_by_their_periapsis_are_those_of_conics(spice, rng, eccentricity, frame):
    """spiceypy.conics, parabolas too, from 8 years before the periapsis to 32 years after it."""
    for _ in range(5):
        q_m, angles = rng.uniform(0.01, 5.0) * 1.5e11, rng.uniform([0.0, 0.0, 0.0], [3.0, 6.0, 6.0])
        names = ("inclination_deg", "longitude_ascending_node_deg", "argument_of_periapsis_deg")
        made = Kepler.from_periapsis(periapsis_distance_m=q_m, eccentricity=eccentricity, periapsis=EPOCH, frame=frame,
                                     **dict(zip(names, np.degrees(angles), strict=True)))
        r, v = made.at(EPOCH, DAYS_S)
        turn = EQUATORIAL_FROM_ECLIPTIC if frame == "ecliptic" else np.eye(3)
        for index, dt in enumerate(DAYS_S):
            state = spice.conics([q_m / 1e3, eccentricity, *angles, 0.0, EPOCH.et_s, GM_SUN_M3_S2 / 1e9],
                                 EPOCH.et_s + dt) * 1e3
            np.testing.assert_allclose(r[index], turn @ state[:3], atol=1e-10 * np.linalg.norm(state[:3]))
            np.testing.assert_allclose(v[index], turn @ state[3:], atol=1e-10 * np.linalg.norm(state[3:]))


def test_a_comets_elements_in_a_scenario_file(tmp_path):
    """C/1995 O1 by q, e and T is at its perihelion distance at that time; what lacks is told."""
    orbit = {"periapsis_distance_m": 1.368e11, "eccentricity": 1.0, "inclination_deg": 89.4,
             "longitude_ascending_node_deg": 282.5, "argument_of_periapsis_deg": 130.6,
             "periapsis_tdb": "1997-04-01T03:20:00"}
    table = {"bodies": [{"name": "comet", "generated": {"kind": "icosphere", "radius_m": 100.0, "subdivisions": 1},
                         "brdf": {"law": "lambert", "normal_albedo": 0.1}, "orbit": orbit}],
             "cameras": [{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 64.0}],
             "trajectory": {"kind": "hovering", "r_hill_m": [1e4, 0.0, 0.0]},
             "time": {"start_tdb": "1997-04-01T03:20:00", "times_s": [0.0]}}
    (state,) = scenario_of_table(table).states()
    np.testing.assert_allclose(np.linalg.norm(state.r_sun_inertial_m), 1.368e11, rtol=1e-12)
    for change, message in (({"periapsis_tdb": None}, "periapsis_tdb: missing; or periapsis_utc"),
                            ({"mean_anomaly_deg": 3.0}, "mean_anomaly_deg: unknown key"),
                            ({"periapsis_distance_m": 0.0}, "periapsis_distance_m: must be > 0")):
        table["bodies"][0]["orbit"] = {key: value for key, value in {**orbit, **change}.items() if value is not None}
        with pytest.raises(ConfigError, match=message):
            scenario_of_table(table)


def test_the_ecliptic_is_spices(spice):
    np.testing.assert_allclose(EQUATORIAL_FROM_ECLIPTIC, spice.pxform("ECLIPJ2000", "J2000", 0.0), atol=1e-15)


def test_a_parabola_falls_from_rest_at_infinity():
    """Closed form of a radial parabola: r = (9 mu t^2 / 2)^(1/3)."""
    r0 = 1e11
    t0 = np.sqrt(2.0 * r0**3 / (9.0 * GM_SUN_M3_S2))
    made = Kepler(r_m=[r0, 0.0, 0.0], v_m_s=[np.sqrt(2.0 * GM_SUN_M3_S2 / r0), 0.0, 0.0], epoch=EPOCH)
    dt = np.array([0.0, 1e5, 1e7, 1e9])
    np.testing.assert_allclose(made.at(EPOCH, dt)[0][:, 0], np.cbrt(4.5 * GM_SUN_M3_S2 * (t0 + dt)**2), rtol=1e-11)


@pytest.mark.parametrize("change, message", [
    ({"eccentricity": 1.0}, "eccentricity: must not be 1, got 1.0; a parabola is given by periapsis_distance_m and"),
    ({"eccentricity": 1.2}, "semi_major_axis_m: must be < 0 for a hyperbola"),
    ({"semi_major_axis_m": -1e11}, "semi_major_axis_m: must be > 0"),
    ({"about": "didymos"}, "gravitational_parameter_m3_s2: missing; of 'didymos': only the Sun's is known"),
    ({"frame": "galactic"}, "frame: must be one of 'ecliptic', 'equatorial'"),
    ({"inclination_deg": float("nan")}, "inclination_deg: must be a finite number"),
])
def test_a_wrong_orbit_is_refused(change, message):
    good = {"semi_major_axis_m": 2e11, "eccentricity": 0.3, "inclination_deg": 3.0, "mean_anomaly_deg": 124.0,
            "longitude_ascending_node_deg": 73.0, "argument_of_periapsis_deg": 319.0, "epoch": EPOCH}
    with pytest.raises(ConfigError) as caught:
        Kepler.from_elements(**{**good, **change})
    assert message in str(caught.value)
