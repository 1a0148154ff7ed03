"""Beliefs: what is believed differs from the truth by what was asked, and by nothing else."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from glrender import ConfigError, Pose, Scene, Shape, State, frames, generate
from glrender.brdf.presets import PRESETS
from glrender.scenario import (
    Belief,
    BodyBelief,
    CameraBelief,
    Epoch,
    RandomStates,
    Spin,
    load_believed_scene,
    load_scenario,
    scenario_of_table,
)
from glrender.scenario.attitude import Geometry
from glrender.scenario.belief.decimation import decimated
from glrender_cli.__main__ import main
from missing import needed_module
from scipy.spatial import Delaunay, cKDTree

PAGE = Path(__file__).parents[2] / "docs" / "scenario.md"
SCENARIO = """
[[bodies]]
name = "itokawa"
generated = { kind = "contact_binary", radius_m = 250.0, seed = 3, subdivisions = 3 }
brdf = { law = "hapke", single_scattering_albedo = 0.4, b = 0.3, c = 1.0, roughness_deg = 20.0 }
[[bodies]]
name = "moonlet"
generated = { kind = "icosphere", radius_m = 40.0, subdivisions = 3 }
brdf = { law = "lambert", normal_albedo = 0.2 }
trajectory = { kind = "at_rest", r_m = [900.0, 0.0, 0.0] }
[[cameras]]
name = "navcam"
width_px = 128
height_px = 96
focal_length_px = 400.0
distortion = { k1 = -0.1 }
[trajectory]
kind = "at_rest"
r_m = [0.0, -4000.0, 0.0]
[time]
times_s = [0.0, 60.0]
[sun]
r_m = [1.0e11, -1.0e11, 0.0]
"""


@pytest.fixture
def table():
    needed_module("fast_simplification", "pip install -e '.[test]'")
    return tomllib.loads(SCENARIO)


def turned(right_ascension_deg, declination_deg, meridian_deg):
    """Attitude by the IAU's angles."""
    spin = Spin.about_pole(pole_right_ascension_deg=right_ascension_deg, pole_declination_deg=declination_deg,
                           prime_meridian_deg=meridian_deg, rate_deg_day=700.0)
    where = {"body": np.zeros((1, 3))}
    return spin.at(Geometry(start=Epoch(0.0), t_s=np.zeros(1), r_m=where, v_m_s=where), "body")[0][0]


def believed(q, **differences):
    return BodyBelief(**differences).pose(Pose(r_inertial_m=[1.0, 2.0, 3.0], q_from_inertial=q))


def test_the_pole_and_the_phase_are_off_as_the_iaus_angles_are():
    """A declination and a prime meridian that are larger, exactly; along right ascension an arc of a great circle."""
    q = turned(40.0, 25.0, 70.0)
    np.testing.assert_allclose(frames.dcm(believed(q, spin_phase_offset_deg=7.0).q_from_inertial),
                               frames.dcm(turned(40.0, 25.0, 77.0)), atol=1e-12)
    np.testing.assert_allclose(frames.dcm(believed(q, pole_offset_deg=[0.0, 3.0]).q_from_inertial),
                               frames.dcm(turned(40.0, 28.0, 70.0)), atol=1e-12)
    east = np.array([-np.sin(np.radians(40.0)), np.cos(np.radians(40.0)), 0.0])
    pole, found = (frames.dcm(x)[2] for x in (q, believed(q, pole_offset_deg=[2.0, 0.0]).q_from_inertial))
    np.testing.assert_allclose(found, np.cos(np.radians(2.0)) * pole + np.sin(np.radians(2.0)) * east, atol=1e-12)
    np.testing.assert_allclose(believed(q, r_offset_m=[0.0, 5.0, 0.0]).r_inertial_m, [1.0, 7.0, 3.0])


def test_a_tenth_of_the_facets_keeps_the_surface(table):
    """Its vertices are on the true surface to the spacing of that one's, it is closed, and of the same bytes."""
    shape = generate.contact_binary(radius_m=250.0, seed=3, subdivisions=5)
    fewer = decimated(shape, 0.1)
    assert 0.098 < len(fewer.facets) / len(shape.facets) <= 0.1
    assert fewer.report.is_watertight and fewer.report.n_shells == 1
    distance_m, _ = cKDTree(shape.vertices_m).query(fewer.vertices_m)
    assert distance_m.max() < np.sqrt(shape.facet_areas_m2.max())
    np.testing.assert_allclose(fewer.report.volume_m3, shape.report.volume_m3, rtol=1e-9)
    np.testing.assert_array_equal(decimated(shape, 0.1).vertices_m, fewer.vertices_m)
    assert decimated(shape, 1.0) is shape


def test_few_facets_keep_volume_and_centre_of_volume():
    """Those of a ball away from the origin, in closed form; of a sheet, which has none, the surface stays in place."""
    ball = generate.icosphere(radius_m=100.0, subdivisions=4)
    ball = Shape.from_arrays(ball.vertices_m + [500.0, -300.0, 200.0], ball.facets)
    fewer = decimated(ball, 0.02)
    corner = fewer.vertices_m[fewer.facets] - [500.0, -300.0, 200.0]
    sixfold = np.linalg.det(corner)
    np.testing.assert_allclose(sixfold.sum() / 6.0, 4.0 / 3.0 * np.pi * 100.0**3, rtol=5e-3)
    assert np.linalg.norm((corner.sum(axis=1) * sixfold[:, None]).sum(axis=0) / (4.0 * sixfold.sum())) < 1e-6
    xy = np.stack(np.meshgrid(np.linspace(-50.0, 50.0, 21), np.linspace(-50.0, 50.0, 21)), axis=-1).reshape(-1, 2)
    sheet = decimated(Shape.from_arrays(np.c_[xy, np.full(len(xy), 7.0)], Delaunay(xy).simplices), 0.1)
    np.testing.assert_allclose(sheet.vertices_m[:, 2], 7.0, rtol=1e-12)


def test_a_scenario_says_what_is_believed(table, tmp_path):
    generate.icosphere(radius_m=0.26, subdivisions=3).to_file(tmp_path / "other.obj")
    table["belief"] = {
        "bodies": {"itokawa": {"shape": "other.obj", "length_unit": "km", "brdf": {"preset": "eros_550nm"}},
                   "moonlet": {"facets": 0.5, "albedo_factor": 1.5, "r_offset_m": [10.0, 0.0, 0.0]}},
        "cameras": {"navcam": {"focal_length_factor": 1.01, "principal_point_offset_px": [0.5, -0.25],
                               "distortion": {}}},
        "spacecraft": {"r_offset_m": [100.0, 0.0, 0.0], "attitude_offset_deg": [0.0, 0.0, 0.1]}}
    scenario = scenario_of_table(table, folder=tmp_path)
    scene = scenario.belief.scene(scenario.scene)
    itokawa, moonlet = scene.bodies
    assert len(itokawa.shape.facets) == 20 * 4**3 and abs(itokawa.hull.radius_m - 260.0) < 1.0
    assert itokawa.brdf == PRESETS["eros_550nm"].law != scenario.scene.bodies[0].brdf
    assert len(moonlet.shape.facets) == 10 * 4**3 and moonlet.brdf.normal_albedo == pytest.approx(0.3)
    camera = scene.cameras[0]
    assert camera.focal_length_px == pytest.approx(404.0) and camera.distortion is None
    np.testing.assert_allclose(camera.principal_point_px, (64.0, 47.25))
    state = scenario.states()[0]
    estimate = Pose(r_inertial_m=[1.0, 2.0, 3.0])
    held = scenario.belief.state(state, estimate)
    np.testing.assert_allclose(held.bodies["moonlet"].r_inertial_m, [910.0, 0.0, 0.0])
    assert held.spacecraft is estimate
    told = "\n".join(scenario.belief.told(scenario.scene))
    assert "focal_length_factor 1.01" in told and "another of 1280 facets" in told and "attitude_offset_deg" in told


def test_without_a_belief_the_truth_is_believed(table):
    scenario = scenario_of_table(table)
    scene = scenario.belief.scene(scenario.scene)
    assert scene.bodies == scenario.scene.bodies and scene.cameras[0].distortion == scenario.scene.cameras[0].distortion
    assert scenario.belief.told(scenario.scene) == []


def test_random_states_have_a_belief_too(table):
    del table["trajectory"], table["time"], table["sun"]
    table |= {"random": {"range_m": 3000.0, "frames": 2}, "belief": {"bodies": {"moonlet": {"facets": 0.5}}}}
    made = scenario_of_table(table)
    assert isinstance(made, RandomStates) and made.setting.belief.bodies["moonlet"].facets == 0.5


def test_the_believed_state_knows_nothing_of_the_true_spacecraft(table):
    """Two truths that differ in the spacecraft's pose alone give one belief."""
    belief, estimate = Belief(bodies={"itokawa": BodyBelief(spin_phase_offset_deg=3.0)}), Pose(r_inertial_m=[9.0, 0, 0])
    here, there = (State(r_sun_inertial_m=[1.5e11, 0.0, 0.0], bodies={"itokawa": Pose(r_inertial_m=[0, 0, 0])},
                         spacecraft=Pose(r_inertial_m=[x, 0.0, 0.0])) for x in (1e3, 2e3))
    assert belief.state(here, estimate).to_dict() == belief.state(there, estimate).to_dict()


@pytest.mark.parametrize("belief, told", [
    ({"bodies": {"itokowa": {}}}, "belief.bodies.itokowa: unknown key; did you mean 'itokawa'?"),
    ({"cameras": {"nav": {}}}, "belief.cameras.nav: unknown key; did you mean 'navcam'?"),
    ({"bodies": {"itokawa": {"facet": 0.1}}}, "belief.bodies.itokawa.facet: unknown key; did you mean 'facets'?"),
    ({"body": {}}, "belief.body: unknown key; did you mean 'bodies'?"),
    ({"bodies": {"itokawa": {"facets": 0.0}}}, "belief.bodies.itokawa.facets: must be a share > 0 and <= 1, got 0.0"),
    ({"bodies": {"itokawa": {"facets": float("nan")}}}, "belief.bodies.itokawa.facets: must be a finite number"),
    ({"bodies": {"itokawa": {"albedo_factor": -1.0}}}, "belief.bodies.itokawa.albedo_factor: must be > 0, got -1.0"),
    ({"bodies": {"itokawa": {"pole_offset_deg": 2.0}}}, "belief.bodies.itokawa.pole_offset_deg: must be 2 numbers"),
    ({"bodies": {"itokawa": {"shape": "none.obj"}}}, "belief.bodies.itokawa.length_unit: missing"),
    ({"bodies": {"itokawa": {"shape": "none.obj", "length_unit": "m"}}}, "belief.bodies.itokawa.shape"),
    ({"cameras": {"navcam": {"focal_length_factor": 0}}}, "belief.cameras.navcam.focal_length_factor: must be > 0"),
    ({"cameras": {"navcam": {"distortion": {"k9": 1.0}}}}, "belief.cameras.navcam.distortion.k9: unknown key"),
    ({"spacecraft": {"attitude_offset_deg": [0.0, 200.0, 0.0]}}, "belief.spacecraft.attitude_offset_deg: must be"),
])
def test_beliefs_in_what_is_not_there_are_refused(table, belief, told):
    with pytest.raises(ConfigError) as error:
        scenario_of_table({**table, "belief": belief})
    assert told in str(error.value)


def test_what_cannot_be_believed_of_a_scene_is_refused(table):
    scene = scenario_of_table(table).scene
    for belief, told in ((Belief(bodies={"itokawa": BodyBelief(albedo_factor=3.0)}), "bodies.itokawa.single_scatt"),
                         (Belief(bodies={"moonlet": BodyBelief(facets=1e-6)}), "bodies.moonlet.facets: must leave 4"),
                         (Belief(cameras={"nacvam": CameraBelief()}), "did you mean 'navcam'?")):
        with pytest.raises(ConfigError, match=told):
            belief.scene(scene)


@pytest.mark.parametrize("made, field, value, rule", [
    (Belief, "bodies", {"binary": 3}, "bodies.binary: must be a BodyBelief, got 3; leave out for the true one"),
    (Belief, "bodies", {"binary": CameraBelief()}, "bodies.binary: must be a BodyBelief, got "),
    (Belief, "bodies", None, "bodies: must be a Mapping, got None; give names, each with its BodyBelief"),
    (Belief, "cameras", {"navcam": None}, "cameras.navcam: must be a CameraBelief, got None; leave out"),
    (Belief, "spacecraft", None, "spacecraft: must be a SpacecraftBelief, got None; leave out"),
    (CameraBelief, "distortion", 3, "distortion: must be a BrownConrady, got 3; `BrownConrady\\(\\)` has none"),
    (BodyBelief, "shape", 3, "shape: must be a Shape, got 3; leave out for the true one")])
def test_a_belief_of_another_type_is_refused(made, field, value, rule):
    with pytest.raises(ConfigError, match=f"^{rule}"):
        made(**{field: value})


def test_a_file_gives_the_believed_scene_alone(table, tmp_path, capsys):
    path = tmp_path / "approach.toml"
    path.write_text(SCENARIO + "[belief.bodies.itokawa]\nfacets = 0.1\n")
    scene = load_believed_scene(path)
    assert isinstance(scene, Scene)
    assert 0.09 < len(scene.bodies[0].shape.facets) / len(load_scenario(path).scene.bodies[0].shape.facets) <= 0.1
    assert main(["check", str(path)]) == 0
    assert "belief of body itokawa: facets 0.1" in capsys.readouterr().out
    path.write_text(SCENARIO)
    with pytest.raises(ConfigError, match="approach.toml.belief: missing"):
        load_believed_scene(path)
    with pytest.raises(ConfigError, match="^nope.toml: cannot be read"):
        load_believed_scene("nope.toml")


def test_the_pages_belief_is_one(table):
    (printed,) = re.findall(r"## Belief.*?```toml\n(.*?)```", PAGE.read_text(), re.S)
    belief = scenario_of_table({**table, **tomllib.loads(printed)}).belief
    assert belief.bodies["itokawa"].facets == 0.1 and belief.cameras["navcam"].focal_length_factor == 1.002


def test_a_room_of_fewer_facets_is_one_of_the_same_size():
    """A ball's volume, negative as its facets face inward; a believed file of a room is one where it says so."""
    needed_module("fast_simplification", "pip install \"glrender[belief]\"")
    ball = generate.icosphere(radius_m=5.0, subdivisions=4)
    fewer = decimated(Shape.from_arrays(ball.vertices_m, ball.facets[:, ::-1], inside=True), 0.25)
    assert fewer.inside and len(fewer.facets) <= 0.25 * len(ball.facets)
    np.testing.assert_allclose(fewer.report.volume_m3, -4.0 / 3.0 * np.pi * 125.0, rtol=0.01)
    np.testing.assert_allclose(np.linalg.norm(fewer.vertices_m, axis=1), 5.0, rtol=0.03)


def test_a_believed_room_and_believed_ground_have_a_scene_files_fields(tmp_path):
    """The file of a room with `inside`; terrain of fewer posts about the same site, whose heights are a plane's."""
    rasterio = needed_module("rasterio", "pip install \"glrender[terrain]\"")
    ball, moon_m = generate.icosphere(radius_m=5.0, subdivisions=2), 1_737_400.0
    Shape.from_arrays(ball.vertices_m, ball.facets[:, ::-1], inside=True).to_file(tmp_path / "room.obj")
    with rasterio.open(tmp_path / "map.tif", "w", driver="GTiff", width=80, height=80, count=1, dtype="float32",
                       crs=rasterio.CRS.from_string(f"+proj=eqc +R={moon_m} +units=m"),
                       transform=rasterio.transform.from_origin(-400.0, 400.0, 10.0, 10.0)) as made:
        made.write(np.tile(np.arange(80, dtype=np.float32), (80, 1)), 1)
    brdf = "brdf = {law = 'lambert', normal_albedo = 0.1}"
    ground = "terrain = {heights = 'map.tif', site_deg = [0.0, 0.0], rings = [[200.0, POSTS]]}"
    (tmp_path / "scene.toml").write_text(
        f"cameras = [{{name = 'c', width_px = 8, height_px = 8, focal_length_px = 20.0}}]\n"
        f"[[bodies]]\nname = 'room'\nshape = 'room.obj'\nlength_unit = 'm'\ninside = true\n{brdf}\n"
        f"[[bodies]]\nname = 'ground'\n{ground.replace('POSTS', '10.0')}\n{brdf}\n")
    belief = (f"scene = 'scene.toml'\n[belief.bodies.room]\nshape = 'room.obj'\nlength_unit = 'm'\ninside = true\n"
              f"[belief.bodies.ground]\n{ground.replace('POSTS', '50.0')}\n")
    (tmp_path / "belief.toml").write_text(belief)
    room, terrain = (body.shape for body in load_believed_scene(tmp_path / "belief.toml").bodies)
    assert room.inside and len(terrain.facets) == 2 * 8 * 8
    x, y, z = terrain.vertices_m.T
    # A metre for ten, above a sphere.
    np.testing.assert_allclose(z, 0.1 * x - (x * x + y * y) / (2.0 * moon_m), atol=0.01)
    for wrong, rule in (("orthophoto = 'map.tif'", "terrain.orthophoto: is a texture, and believed shapes have none"),
                        ("ring = 3", "terrain.ring: unknown key")):
        (tmp_path / "wrong.toml").write_text(belief.replace("heights = 'map.tif'", f"heights = 'map.tif', {wrong}"))
        with pytest.raises(ConfigError, match=rf"belief.bodies.ground.{rule}"):
            load_believed_scene(tmp_path / "wrong.toml")
