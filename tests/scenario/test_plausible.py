"""Units within scenario files: a mistake is told under its field with the way out, a real mission is not.

Truth is the same value in another unit: what the way out says is what was right before.
"""

from __future__ import annotations

import json
import re
import tomllib

import numpy as np
import pytest
from glrender import ConfigError, SceneError
from glrender.base.constants import AU_M
from glrender.base.plausible import improbable, kind_of_body
from glrender.scenario import AtRest, Epoch, Kepler, Scenario, Spin, Times, scenario_of_table
from glrender_cli.__main__ import main
from orbits import DIDYMOS

BINARY = DIDYMOS + """
[bodies.spin]
pole_right_ascension_deg = 60.9
pole_declination_deg = -71.7
rotation_period_s = 8136.0
[[bodies]]
name = "dimorphos"
generated = { kind = "icosphere", radius_m = 80.0, subdivisions = 2 }
brdf = { law = "lambert", normal_albedo = 0.15 }
[bodies.orbit]
about = "didymos"
gravitational_parameter_m3_s2 = 36.03
semi_major_axis_m = 1189.0
eccentricity = 0.0
inclination_deg = 168.6
longitude_ascending_node_deg = 50.6
argument_of_periapsis_deg = 0.0
mean_anomaly_deg = 0.0
epoch_tdb = "2022-09-26T00:00:00"
[[cameras]]
name = "navcam"
width_px = 64
height_px = 64
focal_length_px = 300.0
[encounter]
body = "didymos"
distance_m = 4000.0
relative_velocity_m_s = 6000.0
side = "terminator"
date_tdb = "2022-10-11T00:00:00"
duration_s = 6.0
frames = 3
"""
TIME = {"start_tdb": "2022-10-11T00:00:00", "duration_s": 100.0, "frames": 3}
ORBIT, MOON, ENCOUNTER = ("bodies", 0, "orbit"), ("bodies", 1, "orbit"), ("encounter",)
AXIS, PERIOD = (*ORBIT, "semi_major_axis_m"), ("bodies", 0, "spin", "rotation_period_s")
GM = "gravitational_parameter_m3_s2"
COMET = {"eccentricity": 0.4, "inclination_deg": 3.4, "longitude_ascending_node_deg": 73.2,
         "argument_of_periapsis_deg": 319.3, "periapsis_tdb": "2022-10-22T00:00:00"}
PRIMARY, MOONS = "bodies[0].", "bodies[1].orbit."
STATE = {"epoch_tdb": "2020-05-31T00:00:00", "r_m": [2.3e11, 0.0, 0.4e11], "v_m_s": [0.0, 2.3e4, 3e3]}


def changed(*changes):
    """The binary with other values at places; None takes a field away."""
    table = tomllib.loads(BINARY)
    for place, value in changes:
        at = table
        for key in place[:-1]:
            at = at[key]
        if value is None:
            del at[place[-1]]
        else:
            at[place[-1]] = value
    return table


def on_a_trajectory(**fields):
    return changed((ENCOUNTER, None), (("trajectory",), fields), (("time",), TIME))


def of_the_sun(r_m):
    return changed((ORBIT, None), (ENCOUNTER, None), (("sun",), {"r_m": r_m}), (("time",), TIME),
                   (("trajectory",), {"kind": "at_rest", "r_m": [9e3, 0.0, 0.0]}))


def of_the_attitude(**fields):
    return changed((("attitude",), {"mode": "spin", "angular_velocity_rad_s": [0.0, 0.0, 5.0], **fields}))


# What is written, the field that is told, whether it is refused, and the value that was right.
MISTAKES = {
    "axis in au": (changed((AXIS, 1.644)), PRIMARY + "orbit.semi_major_axis_m", True, 2.4594e11),
    "axis in km": (changed((AXIS, 2.4596e8)), PRIMARY + "orbit.semi_major_axis_m", True, 2.4596e11),
    "hyperbola in au": (changed((AXIS, -1.272), ((*ORBIT, "eccentricity"), 1.2)), PRIMARY + "orbit.semi_major_axis_m",
                        True, -1.9029e11),
    "perihelion in au": (changed((ORBIT, {**COMET, "periapsis_distance_m": 1.01})),
                         PRIMARY + "orbit.periapsis_distance_m", True, 1.51094e11),
    "craft's perihelion in km": (on_a_trajectory(kind="kepler", **COMET, periapsis_distance_m=1.5e8),
                                 "trajectory.periapsis_distance_m", True, 1.5e11),
    "place in au": (changed((ORBIT, {**STATE, "r_m": [1.5, 0.0, 0.3]})), PRIMARY + "orbit.r_m", True, 2.244e11),
    "place in km": (changed((ORBIT, {**STATE, "r_m": [2.3e8, 0.0, 0.4e8]})), PRIMARY + "orbit.r_m", True, 2.3e11),
    "velocity in km/s": (changed((ORBIT, {**STATE, "v_m_s": [0.0, 23.0, 3.0]})), PRIMARY + "orbit.v_m_s", False, 0.0),
    "Sun as a direction": (of_the_sun([1.0, 0.0, 0.0]), "sun.r_m", True, AU_M),
    "Sun in km": (of_the_sun([1.5e8, 0.0, 0.0]), "sun.r_m", True, 1.5e11),
    "far Sun in km": (of_the_sun([7.8e8, 0.0, 0.0]), "sun.r_m", False, 7.8e11),
    "encounter in km": (changed(((*ENCOUNTER, "distance_m"), 4.0)), "encounter.distance_m", True, 4000.0),
    "circle in km": (on_a_trajectory(kind="circular", radius_m=10.0, plane="ecliptic", **{GM: 36.0}),
                     "trajectory.radius_m", True, 10000.0),
    "hover in km": (on_a_trajectory(kind="hovering", r_hill_m=[10.0, 1.0, 0.0]), "trajectory.r_hill_m", True, 10000.0),
    "rest in km": (on_a_trajectory(kind="at_rest", r_m=[10.0, 1.0, 0.0]), "trajectory.r_m", True, 10000.0),
    "GM in km3/s2": (on_a_trajectory(kind="circular", radius_m=1e4, plane="ecliptic", **{GM: 36e-9}),
                     f"trajectory.{GM}", False, 36.0),
    "mass for GM": (changed(((*MOON, GM), 5.4e11)), MOONS + GM, False, 36.0412),
    "moon in km": (changed(((*MOON, "semi_major_axis_m"), 1.189)), MOONS + "semi_major_axis_m", False, 1189.0),
    "period in h": (changed((PERIOD, 2.26)), PRIMARY + "spin.rotation_period_s", False, 8136.0),
    "retrograde in h": (changed((PERIOD, -2.26)), PRIMARY + "spin.rotation_period_s", False, -8136.0),
    "craft in deg/s": (of_the_attitude(), "attitude.angular_velocity_rad_s", False, 0.0),
    "rigid body in deg/s": (of_the_attitude(mode="rigid_body", inertia_kg_m2=[1.0, 2.0, 2.5]),
                            "attitude.angular_velocity_rad_s", False, 0.0),
    "disturbed in deg/s": (of_the_attitude(offset_deg=[0.1, 0.0, 0.0]), "attitude.angular_velocity_rad_s", False, 0.0),
    "body in deg/s": (changed((("bodies", 0, "spin"), None), (("bodies", 0, "attitude"), {
        "mode": "spin", "angular_velocity_rad_s": [0.0, 0.0, 0.2]})), PRIMARY + "attitude.angular_velocity_rad_s",
                      False, 0.0),
}


def told(table):
    """The sentences of a table that is read and checked, and whether it was refused."""
    try:
        return scenario_of_table(table).check(), False
    except ConfigError as error:
        return [str(error).removeprefix("scenario.")], True


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_under_its_field(name):
    table, field, is_refused, right = MISTAKES[name]
    sentences, refused = told(table)
    (sentence,) = [text for text in sentences if "no body is in the field" not in text]
    assert refused == is_refused and sentence.startswith(f"{field}: "), sentence
    written = re.search(r"then write (\[[^]]*\]|[-+.\de]+)", sentence)[1]
    np.testing.assert_allclose(np.atleast_1d(json.loads(written))[0], right, rtol=1e-4)


@pytest.mark.parametrize("elements", [
    {"semi_major_axis_m": 350.0, "eccentricity": 0.9, "mean_anomaly_deg": 175.0, "epoch_tdb": "2022-10-11T00:00:00"},
    {"periapsis_distance_m": 20.0, "eccentricity": 1.4, "periapsis_tdb": "2022-10-22T00:00:00"}])
def test_an_orbit_that_leads_into_its_body_is_read(elements):
    """An impactor's, or a hop's: the size of an orbit is no place. The warning stays."""
    table = on_a_trajectory(kind="kepler", about="didymos", inclination_deg=10.0, longitude_ascending_node_deg=0.0,
                            argument_of_periapsis_deg=0.0, **{GM: 36.0}, **elements)
    scenario = scenario_of_table(table)
    (sentence,) = [str(doubt) for doubt in scenario.doubts]
    assert sentence.startswith(f"trajectory.{next(iter(elements))}: is likely more than 39"), sentence


def test_the_binary_itself_is_likely():
    assert told(tomllib.loads(BINARY)) == ([], False)


def test_an_error_that_comes_of_a_doubt_names_its_field():
    """An orbit of 5.2 au in km is 0.005 au wide, so that the body is within the Sun; the field is told with it."""
    with pytest.raises(SceneError, match=r"is inside the Sun .*; bodies\[0\]\.orbit\.semi_major_axis_m: is likely"):
        scenario_of_table(changed((AXIS, 7.8e8))).check()
    fast = scenario_of_table(changed(((*ENCOUNTER, "relative_velocity_m_s"), 6e6)))
    with pytest.raises(ConfigError, match=r"encounter\.relative_velocity_m_s: .* in mm/s\? then write 6000"):
        fast.states()


def test_bodies_that_overlap_in_frames_are_told_under_what_places_them():
    """430 m apart, of 400 and 80 m; and a body of a table that passes through the other."""
    sentences, _ = told(changed(((*MOON, "semi_major_axis_m"), 430.0)))
    assert sentences == ["bodies[1].orbit: bodies 'didymos' and 'dimorphos' are likely apart, and overlap in 3 of 3 "
                         "frames: the distance of their centres [m], got 430; in km? positions are in metres"]
    assert told(changed(((*MOON, "semi_major_axis_m"), 480.0))) == ([], False)


def test_objects_are_told_as_files_are():
    """The fields of Python's objects, where no file has others."""
    file = scenario_of_table(tomllib.loads(BINARY))
    spin = Spin.about_pole(pole_right_ascension_deg=60.9, pole_declination_deg=-71.7, rotation_period_s=2.26)
    made = Scenario(trajectories=file.trajectories, sampler=file.sampler, origin="didymos", start=file.start,
                    scene=file.scene, attitudes={**file.attitudes, "didymos": spin})
    (sentence,) = made.check()
    assert sentence.startswith("attitudes.didymos.angular_velocity_rad_s: is likely at most 0.06283 rad/s")
    near = Scenario(trajectories={**file.trajectories, "spacecraft": AtRest(r_m=[4.0, 0.0, 0.0], about="didymos")},
                    sampler=Times(times_s=[0.0]), origin="didymos", start=file.start, scene=file.scene)
    with pytest.raises(ConfigError, match=r"^trajectories\.spacecraft\.r_m: must be more than 39\d"):
        near.check()
    elements = {**tomllib.loads(BINARY)["bodies"][0]["orbit"], "semi_major_axis_m": 1.64, "epoch": Epoch(0.0)}
    del elements["epoch_tdb"]
    with pytest.raises(ConfigError, match=r"^semi_major_axis_m: .*got 1\.64; in au\? then write 2\.45"):
        Kepler.from_elements(**elements)
    with pytest.raises(ConfigError, match=r"^r_m: must be more than the Sun's radius"):
        Kepler(r_m=[1.0, 0.2, 0.0], v_m_s=[0.0, 3e4, 0.0], epoch=Epoch(0.0))


# Radius [m] and period of rotation [s], as the asteroid lightcurve database and the missions have them, rounded.
BODIES = {
    "Didymos": (390.0, 8136.0), "Dimorphos": (80.0, 42900.0), "Itokawa": (165.0, 43680.0), "Bennu": (245.0, 15466.0),
    "Ryugu": (450.0, 27480.0), "Eros": (8400.0, 18972.0), "67P": (1700.0, 44650.0), "Vesta": (2.6e5, 19231.0),
    "Haumea": (8e5, 14096.0), "Jupiter": (7e7, 35730.0), "Venus": (6.05e6, -2.1e7), "1998 KY26": (6.0, 321.0),
    "2016 HO3": (25.0, 1680.0), "2014 RC": (6.0, 15.8), "2020 HS7": (3.0, 2.99), "2010 WA": (1.5, 30.9),
    "2000 WH10": (47.0, 80.0), "2001 OE84": (350.0, 1750.0), "2025 MN45": (355.0, 113.0), "Phobos": (11e3, 27554.0)}


@pytest.mark.parametrize("name", BODIES)
def test_real_bodies_turn_at_likely_rates(name):
    radius_m, period_s = BODIES[name]
    kind = kind_of_body(radius_m)
    for field, value in (("rotation_period_s", period_s), ("rate_deg_day", 360.0 * 86400.0 / period_s),
                         ("angular_velocity_rad_s", [0.0, 0.0, 2.0 * np.pi / period_s])):
        assert improbable(kind, {field: value}, "spin") == []
    if radius_m > 50.0 and abs(period_s) < 3.6e5:
        (advice,) = improbable(kind, {"rotation_period_s": period_s / 3600.0}, "spin")
        assert f"in h? then write {period_s:.6g}" in str(advice)


def test_the_command_line_tells_a_scenarios_field_once(tmp_path, capsys):
    """The field of the file, and not that of the state which comes of it."""
    path = tmp_path / "s.toml"
    text = BINARY.replace("8136.0", "2.26") + '\n[attitude]\nmode = "spin"\nangular_velocity_rad_s = [0.0, 0.0, 5.0]\n'
    path.write_text(text)
    for command in (["check", str(path)], ["render", str(path), "--at", "3", "--out", str(tmp_path / "a.npy")]):
        assert main(command) == 0
        said = capsys.readouterr().err
        for field in ("bodies[0].spin.rotation_period_s: ", "attitude.angular_velocity_rad_s: "):
            assert said.count(f"glrender: warning: {field}") == 1, said
        assert "warning: state." not in said


def test_random_states_tell_their_setting():
    random = (("random",), {"range_m": [3e3, 4e3], "frames": 2, "body": "didymos"})
    for period_s, is_told in ((2.26, True), (8136.0, False)):
        sentences, refused = told(changed((ENCOUNTER, None), (PERIOD, period_s), random, (("time",), {
            "start_tdb": TIME["start_tdb"]})))
        assert not refused and any("spin.rotation_period_s: " in text for text in sentences) == is_told
