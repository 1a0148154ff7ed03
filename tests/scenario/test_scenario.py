"""Scenarios joined to states, read from TOML, and checked before a frame is drawn."""

from __future__ import annotations

import copy
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import orbits
import pytest
from glrender import ConfigError, Renderer, SceneError, State, frames, generate
from glrender.base.constants import AU_M
from glrender.scenario import (
    AtRest,
    Encounter,
    Epoch,
    Fixed,
    Kepler,
    Linear,
    OfFunction,
    Scenario,
    Times,
    load_scenario,
    scenario_of_table,
)
from orbits import DATE, DIDYMOS

EXAMPLE = Path(__file__).parents[2] / "examples" / "scenarios" / "comet_flyby.toml"
ISSUE = DIDYMOS + """
[[cameras]]
name = "navcam"
width_px = 256
height_px = 256
focal_length_px = 30000.0
[encounter]
body = "didymos"
distance_m = 200000.0
relative_velocity_m_s = 10000.0
side = "terminator"
date_tdb = "2022-10-11T00:00:00"
duration_s = 600.0
frames = 601
sampler = "linear"
"""


def table():
    return tomllib.loads(ISSUE)


def hovering():
    """A body that the Sun stands 1 au beside, no calendar."""
    made = table()
    del made["encounter"], made["bodies"][0]["orbit"]
    return {**made, "sun": {"r_m": [AU_M, 0.0, 0.0]}, "trajectory": {"kind": "at_rest", "r_m": [0.0, -9000.0, 0.0]},
            "time": {"duration_s": 10.0, "frames": 3}}


def test_the_encounter_of_a_file():
    """t_s from the start, the middle frame at the closest approach, the body at the origin, the camera at the body."""
    scenario = scenario_of_table(table())
    states = scenario.states()
    assert len(states) == 601 and scenario.start == Epoch.from_tdb("2022-10-10T23:55:00")
    assert [states[k].t_s for k in (0, 300, 600)] == [0.0, 300.0, 600.0] and scenario.epochs()[300] == DATE
    ranges = [np.linalg.norm(state.spacecraft.r_inertial_m) for state in states]
    assert np.argmin(ranges) == 300
    np.testing.assert_allclose(ranges[300], 2e5, atol=1e-6)
    r_body, v_body = (part[0] for part in orbits.didymos().at(DATE, np.zeros(1)))
    for state in (states[300],):
        np.testing.assert_array_equal(state.bodies["didymos"].r_inertial_m, np.zeros(3))
        np.testing.assert_allclose(state.r_sun_inertial_m, -r_body, rtol=1e-12)
        np.testing.assert_allclose(state.bodies["didymos"].v_inertial_m_s, v_body, rtol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(state.spacecraft.v_inertial_m_s - v_body), 1e4, rtol=1e-9)
        seen = frames.dcm(state.spacecraft.q_from_inertial) @ -state.spacecraft.r_inertial_m
        np.testing.assert_allclose(seen, [0.0, 0.0, 2e5], atol=1e-6)
    assert scenario.check() == []
    assert State.from_dict(states[7].to_dict()).to_dict() == states[7].to_dict()


def test_a_state_moves_on_at_its_rates():
    """What a pose says of itself a second later is what the scenario says, but for accelerations."""
    scenario = scenario_of_table(table())
    now, later = scenario.states(np.array([250.0, 250.01]))
    moved = now.after(0.01)
    step = moved.bodies["didymos"].r_inertial_m
    np.testing.assert_allclose(moved.spacecraft.r_inertial_m - step, later.spacecraft.r_inertial_m, atol=1e-6)
    np.testing.assert_allclose(moved.spacecraft.q_from_inertial, later.spacecraft.q_from_inertial, atol=1e-7)


@pytest.mark.parametrize("side, phase_deg", [("sunlit", 3.571), ("terminator", 90.0), ("dark", 176.429)])
def test_the_drawn_body_is_lit_from_the_asked_side(side, phase_deg):
    """Flux of a Lambert sphere: 2 / 3 pi albedo phi(phase) of its disc; and its disc is in the middle of the image."""
    made = table()
    made["encounter"]["side"] = side
    made["attitude"] = {"mode": "target", "up": "sun"}
    made["bodies"][0]["generated"]["subdivisions"] = 5
    scenario = scenario_of_table(made)
    (state,) = scenario.states(np.array([300.0]))
    with Renderer(scenario.scene) as renderer:
        image = renderer.render(state, max_error=0.005).irradiance_W_m2
    phase = np.radians(phase_deg)
    law = (np.sin(phase) + (np.pi - phase) * np.cos(phase)) / np.pi
    sun = 1360.8 * (AU_M / np.linalg.norm(state.r_sun_inertial_m))**2
    expected = sun * (400.0 / 2e5)**2 * (2.0 / 3.0 * 0.2) * law
    # A crescent of 3.6 deg is 0.06 pixels wide.
    np.testing.assert_allclose(image.sum(), expected, rtol=0.01 if side != "dark" else 0.2)
    rows = np.arange(256) - 127.5
    row = (image.sum(axis=1) * rows).sum() / image.sum()
    # Light comes from above; the centre of brightness of a crescent is near its limb, 60 pixels up.
    assert {"sunlit": -3.0 < row < 0.0, "terminator": -50.0 < row < -20.0, "dark": row < -30.0}[side], row


def test_the_papers_flyby_of_67p():
    """25 frames in 15 lines of TOML: 3.6 au from the Sun, 20 km away at the nearest, terminator in view."""
    lines = [line for line in EXAMPLE.read_text().splitlines() if line and not line.startswith("#")]
    assert len(lines) <= 15
    scenario = load_scenario(EXAMPLE)
    states = scenario.states()
    assert len(states) == 25 and scenario.check() == []
    middle = states[12]
    r, sun = middle.spacecraft.r_inertial_m, middle.r_sun_inertial_m
    np.testing.assert_allclose(np.linalg.norm(r), 20e3, atol=1e-6)
    np.testing.assert_allclose(r @ sun / np.linalg.norm(r) / np.linalg.norm(sun), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(sun) / AU_M, 3.59, atol=0.02)
    turned = [state.bodies["67p"].q_from_inertial for state in (states[0], states[-1])]
    angle = 2.0 * np.arccos(abs(turned[0] @ turned[1]))
    np.testing.assert_allclose(angle, 2.0 * np.pi * 6.0 / 44650.0, rtol=1e-6)


def test_places_keep_their_digits_far_from_the_sun():
    """What is about one body is not the difference of two orbits of 1e11 m: exact to 1e-9 m."""
    moon = Kepler(r_m=[1200.0, 0.0, 0.0], v_m_s=[0.0, 0.17, 0.0], epoch=DATE, about="didymos",
                  gravitational_parameter_m3_s2=34.9)
    scenario = Scenario(trajectories={"didymos": orbits.didymos(), "dimorphos": moon,
                                      "spacecraft": OfFunction(function=lambda t: [0.0, 0.0, 5000.0 + 0.5 * t],
                                                               about="dimorphos")},
                        origin="didymos", start=DATE, sampler=Linear(duration_s=100.0, frames=5))
    state = scenario.states()[-1]
    np.testing.assert_array_equal(state.bodies["dimorphos"].r_inertial_m, moon.at(DATE, np.array([100.0]))[0][0])
    offset = state.spacecraft.r_inertial_m - state.bodies["dimorphos"].r_inertial_m
    np.testing.assert_allclose(offset, [0.0, 0.0, 5050.0], atol=1e-9)
    relative = state.spacecraft.v_inertial_m_s - state.bodies["dimorphos"].v_inertial_m_s
    np.testing.assert_allclose(relative, [0.0, 0.0, 0.5], atol=1e-9)


def test_hovering_and_circling():
    """Sunward at phase 0 for a month; a terminator orbit at phase 90 and constant range."""
    made = table()
    del made["encounter"]
    made["trajectory"] = {"kind": "hovering", "r_m": [1.0, 2.0, 3.0]}
    with pytest.raises(ConfigError, match=r"scenario.trajectory.r_m: unknown key; known keys are about, r_hill_m"):
        scenario_of_table(made)
    made["trajectory"] = {"kind": "hovering", "r_hill_m": [20e3, 0.0, 0.0]}
    made["time"] = {"start_utc": "2022-10-11T00:00:00", "duration_s": 30 * 86400.0, "frames": 3}
    for state in scenario_of_table(made).states():
        r, sun = state.spacecraft.r_inertial_m, state.r_sun_inertial_m
        np.testing.assert_allclose(r / 20e3, sun / np.linalg.norm(sun), atol=1e-12)
    made["trajectory"] = {"kind": "circular", "radius_m": 10e3, "plane": "terminator",
                          "gravitational_parameter_m3_s2": 35.0}
    made["time"]["duration_s"] = 3600.0
    for state in scenario_of_table(made).states():
        r, sun = state.spacecraft.r_inertial_m, state.r_sun_inertial_m
        np.testing.assert_allclose(np.linalg.norm(r), 10e3, rtol=1e-9)
        # The Sun moves 0.04 deg in an hour.
        assert abs(np.degrees(np.arccos(r @ sun / 10e3 / np.linalg.norm(sun))) - 90.0) < 0.05


def test_attitudes_of_a_file():
    """Each mode of the spacecraft and of a body, read as its class has it."""
    made = table()
    made["cameras"][0]["q_camera_from_spacecraft"] = [0.5, 0.5, 0.5, 0.5]
    made["attitude"] = {"mode": "nadir", "offset_deg": [0.0, 1.0, 0.0],
                        "jitter": {"frequency_hz": [1.0, 2.0], "density_rad2_hz": [1e-16, 1e-16], "seed": 1}}
    made["bodies"][0]["spin"] = {"pole_right_ascension_deg": 0.0, "pole_declination_deg": 90.0,
                                 "prime_meridian_deg": 10.0, "rotation_period_s": 3600.0,
                                 "epoch_tdb": "2022-10-11T00:00:00"}
    (state,) = scenario_of_table(made).states(np.array([300.0]))
    to_camera = frames.dcm([0.5, 0.5, 0.5, 0.5]) @ frames.dcm(state.spacecraft.q_from_inertial)
    seen = to_camera @ -state.spacecraft.r_inertial_m
    np.testing.assert_allclose(seen[:2] / seen[2], [-np.tan(np.radians(1.0)), 0.0], atol=1e-7)
    x = frames.dcm(state.bodies["didymos"].q_from_inertial).T @ [1.0, 0.0, 0.0]
    # W counts from the ascending node of the equator, 90 deg on from the pole's right ascension.
    np.testing.assert_allclose(np.degrees(np.arctan2(x[1], x[0])), 100.0, atol=1e-9)

    rates = [0.0, 1e-3, 2e-3]
    made["attitude"] = {"mode": "spin", "angular_velocity_rad_s": rates}
    made["bodies"][0]["attitude"] = {"mode": "rigid_body", "inertia_kg_m2": [2.0, 2.5, 3.0],
                                     "angular_velocity_rad_s": rates}
    del made["bodies"][0]["spin"]
    first, last = scenario_of_table(made).states(np.array([0.0, 600.0]))
    np.testing.assert_allclose(first.spacecraft.q_from_inertial, [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(last.spacecraft.q_from_inertial[0], np.cos(0.3 * np.sqrt(5.0)), atol=1e-12)
    w = last.bodies["didymos"].angular_velocity_rad_s
    np.testing.assert_allclose([2.0, 2.5, 3.0] @ w**2, [2.0, 2.5, 3.0] @ np.square(rates), rtol=1e-8)
    assert np.abs(w - rates).max() > 1e-4

    made["attitude"] = {"mode": "rigid_body", "inertia_kg_m2": [1.0, 3.0, 3.5], "gravity_gradient_m3_s2": 1e12,
                        "angular_velocity_rad_s": [0.0, 0.0, 0.0]}
    assert np.linalg.norm(scenario_of_table(made).states()[-1].spacecraft.angular_velocity_rad_s) > 1e-4


def test_a_binary_circles_and_eclipses():
    """Dimorphos about Didymos in 11.9 h; in the ecliptic it passes the Sun's line, so it is shaded once a turn."""
    made = table()
    del made["encounter"]
    radius_m, mu = 1190.0, 35.4
    moon = {"name": "dimorphos", "generated": {"kind": "icosphere", "radius_m": 80.0, "subdivisions": 2},
            "brdf": {"law": "lambert", "normal_albedo": 0.2},
            "trajectory": {"kind": "circular", "about": "didymos", "radius_m": radius_m, "plane": "ecliptic",
                           "gravitational_parameter_m3_s2": mu}}
    period_s = 2.0 * np.pi * np.sqrt(radius_m**3 / mu)
    made |= {"bodies": [*made["bodies"], moon], "trajectory": {"kind": "hovering", "r_hill_m": [9e3, 2e3, 5e3]},
             "time": {"start_utc": "2022-10-11T00:00:00", "duration_s": period_s, "frames": 201}}
    scenario = scenario_of_table(made)
    assert scenario.check() == []
    states = scenario.states()
    r = np.array([state.bodies["dimorphos"].r_inertial_m for state in states])
    np.testing.assert_allclose(r[-1], r[0], atol=1e-3)
    to_sun = np.array([state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m) for state in states])
    along = np.einsum("ij,ij->i", r, to_sun)
    shaded = (along < 0.0) & (np.linalg.norm(r - along[:, None] * to_sun, axis=1) < 400.0 - 80.0)
    # The chord of the shadow over the orbit.
    np.testing.assert_allclose(shaded.mean(), np.arcsin(320.0 / radius_m) / np.pi, atol=0.011)


def test_no_calendar_is_needed_where_nothing_moves_by_it():
    scenario = scenario_of_table(hovering())
    assert scenario.start is None and scenario.epochs() == [] and scenario.check() == []
    state = scenario.states()[2]
    assert state.t_s == 10.0
    np.testing.assert_array_equal(state.r_sun_inertial_m, [AU_M, 0.0, 0.0])


def test_a_scene_file_may_stand_beside(tmp_path):
    """`scene` names it, and its bodies get their orbits by name."""
    made = table()
    scene, _, encounter = ISSUE.partition("[encounter]")
    orbit = scene[scene.index("[bodies.orbit]"):scene.index("[[cameras]]")]
    (tmp_path / "scene.toml").write_text(scene.replace(orbit, ""))
    head = 'scene = "scene.toml"\n[[bodies]]\nname = "didymos"'
    (tmp_path / "s.toml").write_text(f"{head}\n{orbit}[encounter]{encounter}")
    one, other = load_scenario(tmp_path / "s.toml").states()[5], scenario_of_table(made).states()[5]
    assert one.to_dict() == other.to_dict()
    (tmp_path / "s.toml").write_text((tmp_path / "s.toml").read_text().replace('"didymos"\n', '"moon"\n', 1))
    with pytest.raises(ConfigError, match=r"s.toml.bodies\[0\].name: must be one of 'didymos', got 'moon'"):
        load_scenario(tmp_path / "s.toml")


@pytest.mark.parametrize("sampler, times_s", [
    ({"sampler": "exponential", "slow_motion": 2.0, "frames": 3}, [0.0, 300.0, 600.0]),
    ({"sampler": "equal_turns", "frames": 3}, [0.0, 300.0, 600.0]),
    ({"rate_hz": 0.005}, [0.0, 200.0, 400.0, 600.0]),
    ({"epochs_tdb": ["2022-10-11T00:00:00", "2022-10-11T00:00:01.5"]}, [300.0, 301.5]),
    ({"times_s": [1.0, 2.5]}, [1.0, 2.5]),
])
def test_times_of_an_encounter_in_their_own_table(sampler, times_s):
    """[time] in place of `frames` in [encounter]; the encounter gives the duration."""
    made = table()
    del made["encounter"]["frames"], made["encounter"]["sampler"]
    times = [state.t_s for state in scenario_of_table({**made, "time": sampler}).states()]
    np.testing.assert_allclose(times, times_s, atol=1e-9)


def spoilt(path, value):
    made, keys = copy.deepcopy(table()), path.split(".")
    place = made
    for key in keys[:-1]:
        place = place[int(key)] if key.isdigit() else place.setdefault(key, {})
    if value is None:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    return made


@pytest.mark.parametrize("path, value, message", [
    ("encounter.distance", 1.0, "scenario.encounter.distance: unknown key; did you mean 'distance_m'? known keys are"),
    ("encounter.distance_m", -1.0, "scenario.encounter.distance_m: must be > 0, got -1.0"),
    ("encounter.distance_m", None, "scenario.encounter.distance_m: missing"),
    ("encounter.date_tdb", None, "scenario.encounter.date_tdb: missing; or date_utc, or date_et_s"),
    ("encounter.date", "2022-10-11", "scenario.encounter.date: has no time scale"),
    ("encounter.body", "moon", "scenario.encounter.body: must be one of 'didymos', got 'moon'"),
    ("encounter.frames", 0, "scenario.encounter.frames: must be an integer between 1 and"),
    ("encounter.frames", None, "scenario.time.frames: missing"),
    ("encounter.sampler", "quadratic", "scenario.encounter.sampler: must be one of 'linear', 'exponential'"),
    ("encounter", None, "scenario.encounter: needs exactly one of [encounter], [trajectory] and [random]"),
    ("bodies.0.orbit.eccentricity", 1.5, "scenario.bodies[0].orbit.semi_major_axis_m: must be < 0 for a hyperbola"),
    ("bodies.0.orbit.epoch_tdb", None, "scenario.bodies[0].orbit.epoch_tdb: missing; or epoch_utc"),
    ("bodies.0.orbit", None, "scenario.bodies[0].orbit: missing: nothing gives the Sun's place; give an orbit"),
    ("bodies.0.name", "sun", "scenario.bodies[0].name: must be another name in a scenario, got 'sun'"),
    ("bodies.0.spin", {"pole_declination_deg": 3.0}, "scenario.bodies[0].spin.pole_right_ascension_deg: missing"),
    ("bodies.0.colour", "red", "scenario.bodies[0].colour: unknown key"),
    ("time.start_tdb", "2022-10-11", "scenario.encounter.date_tdb: gives the start, so [time] must not"),
    ("time.start", "2022-10-11", "scenario.time.start: has no time scale"),
    ("time.epochs_tdb", [], "scenario.time.epochs_tdb: must be a list that is not empty"),
    ("time.epochs_utc", ["yesterday"], "scenario.time.epochs_utc[0]: must be a date"),
    ("attitude", {"mode": "target", "target": "moon"}, "scenario.attitude.target: must be one of 'sun', 'didymos'"),
    ("attitude", {"mode": "look"}, "scenario.attitude.mode: must be one of 'target', 'nadir', 'fixed'"),
    ("attitude", {"mode": "fixed", "q_from_inertial": [1, 1, 0, 0]}, "scenario.attitude.q_from_inertial: norm"),
    ("attitude", {"mode": "spice", "frame": "J2000"}, "scenario.attitude: needs [spice] with its kernels"),
    ("attitude", {"mode": "target", "camera": "wide"}, "scenario.attitude.camera: unknown camera, got 'wide'"),
    ("movie", {}, "scenario.movie: unknown key"),
    ("sun", {"r_m": [1e11, 0.0, 0.0]}, "scenario.sun: is given as well as an orbit about the Sun"),
    ("output", 3, "scenario.output: must be a table, got 3"),
])
def test_a_wrong_field_is_told_by_its_path(path, value, message):
    with pytest.raises(ConfigError) as caught:
        scenario_of_table(spoilt(path, value))
    assert message in str(caught.value)


def _leaves(value, path=()):
    if path:
        yield path
    for key, entry in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from _leaves(entry, (*path, key))


def _everything():
    """A table with most of the fields that there are."""
    made = table()
    made["encounter"] |= {"frames": 3, "over": "south", "direction": [1.0, 2.0, 3.0],
                          "gravitational_parameter_m3_s2": 1.0, "sampler": "exponential", "slow_motion": 2.0}
    made["attitude"] = {"mode": "target", "target": "didymos", "up": [0.0, 1.0, 0.0], "roll_deg": 3.0,
                        "offset_deg": [1.0, 2.0, 3.0], "camera": "navcam",
                        "jitter": {"frequency_hz": [1.0, 2.0], "density_rad2_hz": [1e-9, 1e-9], "seed": 3, "lines": 5}}
    made["bodies"][0]["spin"] = {"pole_right_ascension_deg": 1.0, "pole_declination_deg": 3.0, "rate_deg_day": 700.0,
                                 "prime_meridian_deg": 3.0, "epoch_tdb": "2000-01-01"}
    return made


BAD = ["x", -1.5, 0, float("nan"), 1e308, 1e-320, [], {}, True, None, ["a", "b", "c"], [0, 0, 0], [1e200] * 3, 10**400]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bad", BAD, ids=lambda bad: repr(bad)[:12])
def test_a_senseless_value_is_refused_or_used_but_never_crashes(bad):
    """In each field of a scenario: a ConfigError, or states."""
    for path in [path for path in _leaves(_everything()) if path[0] not in ("cameras", "max_error")]:
        made = _everything()
        if path[0] == "bodies" and (len(path) < 3 or path[2] not in ("orbit", "spin")):
            continue
        place = made
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = bad
        try:
            scenario_of_table(made).states()
        except ConfigError as error:
            assert error.path.startswith(("scenario", "trajectories", "attitudes")) and ".." not in error.path, error


def test_a_spacecraft_inside_a_body_is_told_before_a_frame():
    """Below a vertex of the icosphere, 400 m away, where its facets are 398.2 m away."""
    made = hovering()
    made["trajectory"]["r_m"] = (399.0 * generate.icosphere(radius_m=1.0, subdivisions=3).vertices_m[0]).tolist()
    with pytest.raises(SceneError, match=r"spacecraft: is inside 'didymos' \(frame 0, t_s = 0\)"):
        scenario_of_table(made).check()


def test_a_body_inside_the_sun_is_told():
    scenario = scenario_of_table(hovering())
    sun = OfFunction(function=lambda t_s: [1e8, 0.0, 0.0], about="didymos")
    with pytest.raises(SceneError, match=r"bodies.didymos: is inside the Sun \(frame 0"):
        replace(scenario, trajectories={**scenario.trajectories, "sun": sun}).check()


def test_the_sun_in_the_field_and_empty_frames_are_warned_of():
    made = hovering()
    made["trajectory"]["r_m"] = [-9000.0, 30.0, 0.0]
    (told,) = scenario_of_table(made).check()
    assert told == ("camera 'navcam': the Sun is in the field, behind the target, in 3 frames (0 to 2): bodies "
                    "show their dark sides; check the side of the trajectory")
    made["trajectory"]["r_m"] = [0.0, -9000.0, 0.0]
    made["attitude"] = {"mode": "fixed", "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}
    (told,) = scenario_of_table(made).check()
    assert "no body is in the field in 3 frames (0 to 2), the whole sequence: check [attitude]" in told


def test_trajectories_that_do_not_meet_are_refused():
    sampler = Times(times_s=[0.0])
    sun, craft = AtRest(r_m=[AU_M, 0, 0], about="a"), AtRest(r_m=[1e3, 0, 0], about="a")
    assert Scenario(trajectories={"sun": sun, "spacecraft": craft}, origin="a", sampler=sampler).states()
    for paths, message in (
            ({"spacecraft": craft}, "trajectories.sun: missing"),
            ({"sun": sun}, "trajectories.spacecraft: missing"),
            ({"sun": sun, "spacecraft": AtRest(r_m=[1, 0, 0], about="b")}, "trajectories.b: missing; nothing"),
            ({"sun": sun, "spacecraft": craft, "a": AtRest(r_m=[1, 0, 0], about="spacecraft")}, "a circle")):
        with pytest.raises(ConfigError, match=message):
            Scenario(trajectories=paths, origin="a", sampler=sampler)
    with pytest.raises(ConfigError, match="attitudes.moon: must be of the spacecraft or a body"):
        Scenario(trajectories={"sun": sun, "spacecraft": craft}, origin="a", sampler=sampler,
                 attitudes={"moon": Fixed()})


def test_an_orbit_without_a_start_asks_for_one():
    craft = Encounter(body="didymos", body_trajectory=orbits.didymos(), distance_m=2e5, relative_velocity_m_s=1e4,
                      date=DATE, duration_s=600.0, side="dark")
    scenario = Scenario(trajectories={"didymos": orbits.didymos(), "spacecraft": craft}, origin="didymos",
                        sampler=Linear(duration_s=600.0, frames=3))
    with pytest.raises(ConfigError, match="time.start_tdb: missing: an orbit, a spin or a kernel needs the date"):
        scenario.states()


def test_a_file_that_is_none_is_told(tmp_path):
    with pytest.raises(ConfigError, match="none.toml: cannot be read: No such file"):
        load_scenario(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("[encounter")
    with pytest.raises(ConfigError, match="bad.toml: is not TOML"):
        load_scenario(tmp_path / "bad.toml")


@pytest.mark.parametrize("wrong, right", [("randm", "random"), ("encountr", "encounter"), ("tajectory", "trajectory"),
                                          ("atitude", "attitude"), ("bodys", "bodies"), ("spise", "spice")])
def test_a_misspelt_table_is_answered_with_those_of_scenarios(wrong, right):
    with pytest.raises(ConfigError, match=f"scenario.{wrong}: unknown key; did you mean '{right}'") as caught:
        scenario_of_table({"bodies": [], "cameras": [], wrong: {}})
    assert "encounter" in str(caught.value) and "sun_disc" in str(caught.value)
