"""Random states: they have the geometry that was asked for, fill it evenly, show something, repeat with the seed."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from glrender import ConfigError, SceneError, frames
from glrender.base.constants import AU_M
from glrender.scenario import RandomStates, scenario_of_table
from glrender.scenario.distributions import distribution
from glrender.scenario.files.keypoint_fields import off_surface, read_keypoints
from glrender.scenario.files.random_fields import with_changes
from glrender.view.view import view_bodies
from scipy import stats
from scipy.spatial.transform import Rotation

BODY = {"name": "moon", "generated": {"kind": "icosphere", "radius_m": 100.0, "subdivisions": 3},
        "brdf": {"law": "lambert", "normal_albedo": 0.2}}
CAMERA = {"name": "navcam", "width_px": 200, "height_px": 200, "focal_length_px": 1000.0,
          "q_camera_from_spacecraft": [0.5, 0.5, -0.5, 0.5], "r_camera_spacecraft_m": [1.0, 2.0, -3.0]}
RANDOM = {"range_m": [1000.0, 3000.0], "phase_angle_deg": [10.0, 90.0], "off_pointing_deg": {"solid_angle": [0.0, 3.0]},
          "frames": 256, "seed": 5}


def made(random=None, body=None, **tables) -> RandomStates:
    given = {key: value for key, value in {**RANDOM, **(random or {})}.items() if value is not None}
    return scenario_of_table(copy.deepcopy({"bodies": [{**BODY, **(body or {})}], "cameras": [CAMERA],
                                            "random": given, **tables}))


def geometry(states, body="moon"):
    """Range [m], phase, off-pointing [deg] of each state, from its camera's place by the mounting."""
    found = []
    for state in states:
        craft_from_inertial, camera_from_craft = (frames.dcm(np.array(q)) for q in (
            state.spacecraft.q_from_inertial, CAMERA["q_camera_from_spacecraft"]))
        r_camera = state.spacecraft.r_inertial_m + craft_from_inertial.T @ CAMERA["r_camera_spacecraft_m"]
        r_body = state.bodies[body].r_inertial_m
        there, sun = r_body - r_camera, state.r_sun_inertial_m - r_body
        boresight = (camera_from_craft @ craft_from_inertial)[2]
        angle = lambda a, b: np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))  # noqa: E731
        found.append((np.linalg.norm(there), angle(-there, sun), angle(boresight, there)))
    return np.array(found).T


def test_the_states_have_the_geometry_that_was_asked_for_each_stratum_once():
    states = made().states()
    range_m, phase, off = geometry(states)
    assert (1000.0 <= range_m).all() and (range_m <= 3000.0).all() and (off <= 3.0 + 1e-6).all()
    for values, low, high in ((range_m, 1000.0, 3000.0), (phase, 10.0, 90.0), (1.0 - np.cos(np.radians(off)), 0.0, (
            1.0 - np.cos(np.radians(3.0))))):
        counts, _ = np.histogram(values, np.linspace(low, high * (1.0 + 1e-12), 257))
        assert (counts == 1).all()


def test_attitudes_and_suns_are_uniform():
    """Axes of the body and directions to the Sun: every component uniform in -1..1 (Archimedes)."""
    states = made({"frames": 2000}).states()
    turned = np.array([frames.dcm(state.bodies["moon"].q_from_inertial) for state in states])
    suns = np.array([state.r_sun_inertial_m for state in states])
    np.testing.assert_allclose(np.linalg.norm(suns, axis=1), AU_M, rtol=1e-12)
    for values in (*turned.reshape(-1, 9).T, *(suns / AU_M).T):
        assert stats.kstest(values, stats.uniform(-1.0, 2.0).cdf).pvalue > 1e-3
    # Angles of uniform rotations have the density (1 - cos) / pi.
    angle = Rotation.from_matrix(turned).magnitude()
    assert stats.kstest(angle, lambda x: (x - np.sin(x)) / np.pi).pvalue > 1e-3


def test_the_same_seed_gives_the_same_states_and_another_range_changes_no_other_number():
    first, again, other = made().states(), made().states(), made({"seed": 6}).states()
    assert [state.to_dict() for state in first] == [state.to_dict() for state in again]
    assert first[0].to_dict() != other[0].to_dict()
    nearer = made({"range_m": [500.0, 600.0]}).states()
    np.testing.assert_array_equal([state.bodies["moon"].q_from_inertial for state in first],
                                  [state.bodies["moon"].q_from_inertial for state in nearer])


def test_more_frames_of_sobol_leave_the_first_as_they_are():
    few, many = (made({"sampler": "sobol", "frames": frames_}).states() for frames_ in (10, 300))
    assert [state.to_dict() for state in few] == [state.to_dict() for state in many[:10]]


def test_the_roll_is_that_of_pointing():
    """With the Sun up at roll 0: at 90 degrees it is turned on to the image's left or right, always the same."""
    for roll, expected in ((0.0, [0.0, -1.0]), (90.0, [1.0, 0.0])):
        random = made({"roll_deg": roll, "up": "sun", "off_pointing_deg": 0.0, "frames": 5})
        for state in random.states():
            view = view_bodies(state, random.camera, random.scene.hulls)[0]
            sun = (view.camera_from_body @ view.sun_direction_body)[:2]
            np.testing.assert_allclose(np.abs(sun / np.linalg.norm(sun) @ expected), 1.0, atol=1e-9)


def test_a_spin_gives_phases_about_the_pole():
    spin = {"pole_right_ascension_deg": 30.0, "pole_declination_deg": 60.0, "rotation_period_s": 1000.0}
    random = made({"sun_direction": [1.0, 0.0, 0.0], "sun_distance_au": 2.0}, {"spin": spin})
    states = random.states()
    pole = np.array([frames.dcm(state.bodies["moon"].q_from_inertial)[2] for state in states])
    expected = [np.cos(np.pi / 3) * np.cos(np.pi / 6), np.cos(np.pi / 3) * np.sin(np.pi / 6), np.sin(np.pi / 3)]
    np.testing.assert_allclose(pole, np.tile(expected, (len(states), 1)), atol=1e-12)
    times = np.array([state.t_s for state in states])
    assert (np.histogram(times, np.linspace(0.0, 1000.0, 257))[0] == 1).all()
    np.testing.assert_allclose([state.r_sun_inertial_m for state in states], np.tile([2.0 * AU_M, 0.0, 0.0], (256, 1)))


def test_an_orbit_tells_the_sun_and_the_phase_holds():
    orbit = {"semi_major_axis_m": 2.4596e11, "eccentricity": 0.3839, "inclination_deg": 3.408,
             "longitude_ascending_node_deg": 73.2, "argument_of_periapsis_deg": 319.3, "mean_anomaly_deg": 124.6,
             "epoch_tdb": "2020-05-31T00:00:00"}
    states = made({"time_s": [0.0, 6e7]}, {"orbit": orbit}, time={"start_tdb": "2020-05-31T00:00:00"}).states()
    distance = np.array([np.linalg.norm(state.r_sun_inertial_m) for state in states])
    assert np.ptp(distance) > 0.7 * 2.0 * 0.3839 * 2.4596e11
    _, phase, _ = geometry(states)
    assert (np.histogram(phase, np.linspace(10.0, 90.0, 257))[0] == 1).all()


def test_views_without_anything_to_see_are_rejected_and_told():
    random = made({"off_pointing_deg": [0.0, 20.0], "phase_angle_deg": [0.0, 180.0], "frames": 100})
    states = random.states()
    assert len(states) == 100 and set(random.rejected) == {"out of the field", "nothing lit"}
    for state in states:
        assert view_bodies(state, random.camera, random.scene.hulls)[0].is_visible
    told, = [text for text in random.check() if "rejected" in text]
    share = random.rejected.total() / (100 + random.rejected.total())
    assert f"{share:.1%} of {100 + random.rejected.total()} views were rejected: " in told
    whole = made({"off_pointing_deg": [0.0, 8.0], "in_field": "whole"})
    assert all(view_bodies(state, whole.camera, whole.scene.hulls)[0].is_whole for state in whole.states())


@pytest.mark.parametrize("random, message", [
    ({"off_pointing_deg": [30.0, 60.0]}, r"random\.off_pointing_deg: leaves 0 of .* out of the field.*5\.71 deg"),
    ({"phase_angle_deg": 179.99}, r"random\.phase_angle_deg: leaves 0 .* nothing lit.*lower its upper end"),
    ({"range_m": [99.55, 99.56]}, r"random\.range_m: leaves \d+ .* inside a body.*raise its lower end")])
def test_ranges_that_show_nothing_are_given_up_with_the_range_to_change(random, message):
    with pytest.raises(SceneError, match=message):
        made({**random, "frames": 1000}).states()


@pytest.mark.parametrize("random, message", [
    ({"rang_m": [1.0, 2.0]}, r"random\.rang_m: unknown key; did you mean 'range_m'\? known"),
    ({"sampler": "latin_hypercub"}, r"random\.sampler: must be one of .*; did you mean 'latin_hypercube'\?"),
    ({"range_m": {"log_unifrm": [1e3, 2e3]}}, r"range_m\.log_unifrm: unknown key; did you mean 'log_uniform'\?"),
    ({"range_m": None}, r"random\.range_m: missing"),
    ({"range_m": [50.0, 300.0]}, r"random\.range_m: must be above 9\d.*'moon' is larger.*reaches 100 m"),
    ({"range_m": [1e3, 1e17]}, r"random\.range_m: must rise and be between 0\.001 and 1e\+16"),
    ({"range_m": [3e3, 1e3]}, r"random\.range_m: must rise"), ({"range_m": "far"}, r"random\.range_m: must be numbers"),
    ({"phase_angle_deg": [0.0, 200.0]}, r"random\.phase_angle_deg: must rise and be between 0 and 180"),
    ({"attitude": "own"}, r"random\.attitude: needs the spin"), ({"attitude": "any"}, r"random\.attitude: must be one"),
    ({"sun_direction": "own"}, r"random\.sun_direction: needs an orbit"),
    ({"body": "sun"}, r"random\.body: must be one"),
    ({"camera": "wide"}, "wide"), ({"frames": 0}, r"random\.frames: must be an integer"),
    ({"range_m": {"normal": [2e3, -1.0]}}, r"random\.range_m: must be a mean .* and a deviation > 0"),
    ({"up": "left"}, r"random\.up: must be one of 'north'")])
def test_what_is_wrong_is_told_with_its_field(random, message):
    with pytest.raises(ConfigError, match=message):
        made(random)


def test_tables_that_do_not_go_with_random_are_refused():
    for tables, message in (({"trajectory": {}}, "needs exactly one of"),
                            ({"attitude": {"mode": "target"}}, "attitude: is given as well as"),
                            ({"time": {"duration_s": 5.0}}, "time: is given as well as")):
        with pytest.raises(ConfigError, match=message):
            made(**tables)
    with pytest.raises(ConfigError, match="sun_distance_au: is given by"):
        made({"sun_distance_au": 1.0}, sun={"r_m": [1e11, 0.0, 0.0]})


@pytest.mark.parametrize("value, scipys", [
    ([2.0, 6.0], stats.uniform(2.0, 4.0)), ({"log_uniform": [2.0, 6.0]}, stats.loguniform(2.0, 6.0)),
    ({"normal": [2.0, 3.0]}, stats.truncnorm(-2.0 / 3.0, 98.0 / 3.0, 2.0, 3.0))])
def test_distributions_are_those_of_scipy(value, scipys):
    share = np.linspace(0.01, 0.99, 50)
    np.testing.assert_allclose(distribution(value, 0.0, 100.0).of(share), scipys.ppf(share), rtol=1e-9)


def test_changes_leave_the_rest():
    random = with_changes(made(), frames=3, seed=None, camera=None)
    assert (random.frames, random.seed, len(random.states())) == (3, 5, 3)


def test_keypoints_are_read_and_those_off_the_surface_told(tmp_path):
    (tmp_path / "points.csv").write_text("name, r_x_m, r_y_m, r_z_m\nnorth, 0, 0, 100\nfar, 0, 0, 150\n")
    table = {"bodies": [{**BODY, "keypoints": "points.csv"}], "cameras": [CAMERA], "random": RANDOM}
    random = scenario_of_table(table, folder=tmp_path)
    assert {name: place.tolist() for name, place in random.keypoints["moon"].items()} == {
        "north": [0.0, 0.0, 100.0], "far": [0.0, 0.0, 150.0]}
    told, = off_surface(random.scene, random.keypoints)
    assert "'far' is 50" in told and "'moon'" in told
    (tmp_path / "points.csv").write_text("id,name,r_z_m,Description,r_y_m,r_x_m\n7,a,3,\"a boulder, 12 m\",2,1\n")
    np.testing.assert_array_equal(read_keypoints("points.csv", tmp_path)["a"], [1.0, 2.0, 3.0])
    for text, message in (("name,r_x_m\n", "has no column 'r_y_m'"), ("name,r_x_m,r_y_m,r_z_m\n", "holds no keypoint"),
                          ("name,r_x_m,r_y_m,r_z_m\na,1,2,x\n", "line 2: must have three numbers"),
                          ("name,r_x_m,r_y_m,r_z_m\na,1,2,3\na,1,2,3\n", "must be unique"),
                          ("name,r_x_m,r_y_m,r_z_m\na,1,5,2,3\n", "points.csv:2: must have 4 cells"),
                          ("name,r_x_m,r_y_m,r_z_m,unit\na,1,2,3,km\n", "points.csv.unit: unknown column")):
        (tmp_path / "points.csv").write_text(text)
        with pytest.raises(ConfigError, match=message):
            scenario_of_table(table, folder=tmp_path)


def test_a_companion_goes_round_the_body_at_the_time_of_each_state():
    """A circle of 1000 s: its place is that of Kepler's angle at t_s, whatever the order of the times."""
    mu = (2.0 * np.pi / 1000.0) ** 2 * 500.0**3
    companion = {**BODY, "name": "moonlet", "generated": {"kind": "icosphere", "radius_m": 20.0, "subdivisions": 2},
                 "trajectory": {"kind": "circular", "gravitational_parameter_m3_s2": mu, "radius_m": 500.0,
                                "plane": [1.0, 0.0, 0.0], "epoch_tdb": "2022-01-01T00:00:00"}}
    states = scenario_of_table({"bodies": [BODY, companion], "cameras": [CAMERA],
                                "time": {"start_tdb": "2022-01-01T00:00:00"},
                                "random": {**RANDOM, "time_s": [0.0, 1000.0], "frames": 40}}).states()
    times = np.array([state.t_s for state in states])
    assert (np.diff(times) < 0.0).any() and np.ptp(times) > 900.0
    angle = 2.0 * np.pi * times / 1000.0
    expected = 500.0 * np.stack([np.zeros(40), -np.sin(angle), np.cos(angle)], axis=1)
    np.testing.assert_allclose([state.bodies["moonlet"].r_inertial_m for state in states], expected, atol=1e-6)
    _, phase, off = geometry(states)
    assert (phase >= 10.0 - 1e-6).all() and (phase <= 90.0 + 1e-6).all() and (off <= 3.0 + 1e-6).all()
