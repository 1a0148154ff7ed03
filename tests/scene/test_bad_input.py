"""What a wrong scene, state or request is told: the field, the rule, the value; and that it is never rendered."""

from __future__ import annotations

import numpy as np
import pytest
import views
from glrender import (
    Body,
    ConfigError,
    DeviceError,
    PinholeCamera,
    Pose,
    Renderer,
    Scene,
    SceneError,
    Shape,
    ShapeError,
    State,
    generate,
    load_scene,
)
from glrender.brdf import Lambert
from glrender.scene.tolerance import LEAST
from scipy.spatial import ConvexHull

GREY = Lambert(normal_albedo=0.2)


@pytest.fixture(scope="module")
def renderer():
    with Renderer(views.scene([views.sphere(GREY, 3)], [views.camera()])) as renderer:
        yield renderer


def good_state():
    return views.state().to_dict()


def changed(path, value):
    """The state dictionary with the entry at a dotted path replaced, or removed for None."""
    state = good_state()
    *parents, last = path.split(".")
    table = state
    for key in parents:
        table = table[key]
    if value is None:
        del table[last]
    else:
        table[last] = value
    return state


@pytest.mark.parametrize("path, value, message", [
    ("t_s", float("nan"), "state.t_s: must be a finite number, got nan"),
    ("t_s", "now", "state.t_s: must be a finite number, got 'now'"),
    ("r_sun_inertial_m", [1.0, 2.0], r"state.r_sun_inertial_m: must have shape \(3,\)"),
    ("r_sun_inertial_m", [1.0, 2.0, float("inf")], "state.r_sun_inertial_m: must be finite"),
    ("spacecraft.q_from_inertial", [1.0, 0.2, 0.0, 0.0],
     "state.spacecraft.q_from_inertial: norm must be 1 within 0.001, is 1.0198.*normalise"),
    ("spacecraft.q_from_inertial", [0.0, 0.0, 0.0, 0.0], "norm must be 1"),
    ("bodies.body.q_from_inertial", [1, 0, 0], r"state.bodies.body.q_from_inertial: must have shape \(4,\)"),
    ("spacecraft.r_inertial_m", [0, -1e25, 0], "r_inertial_m: must be within 1e\\+16 m, got .*1e\\+25"),
    ("r_sun_inertial_m", [1e308, 1e308, 0], "state.r_sun_inertial_m: must be within 1e\\+16 m, got .*1e\\+308"),
    ("spacecraft.r_inertial_m", [True, -600, False], "state.spacecraft.r_inertial_m: must be 3 numbers, got .True"),
    ("spacecraft.r_inertial_m", ["0", "-600", "0"], "state.spacecraft.r_inertial_m: must be 3 numbers, got .'0'"),
    ("bodies.body.r_inertial_m", [0, 0, 10**400], "state.bodies.body.r_inertial_m: must be 3 numbers"),
    ("bodies.body.r_inertial_m", [0, 0, None], "state.bodies.body.r_inertial_m: must be"),
    ("bodies.body.r_inertial_m", None, "state.bodies.body.r_inertial_m: missing"),
    ("bodies.body.mass_kg", 1.0, "state.bodies.body.mass_kg: unknown key"),
    ("spacecraft", None, "state.spacecraft: missing"),
    ("bodies", [1], "state.bodies: must map body names to poses"),
    ("light", 1, "state.light: unknown key; known keys are bodies, date_tdb, r_sun_inertial_m, spacecraft, t_s"),
])
def test_a_wrong_state_names_field_rule_and_value(path, value, message):
    with pytest.raises(ConfigError, match=message):
        State.from_dict(changed(path, value))


def test_a_state_survives_the_round_trip():
    state = good_state()
    assert State.from_dict(state).to_dict() == state


def test_a_quaternion_of_rounded_digits_is_renormalised():
    state = changed("spacecraft.q_from_inertial", [0.70710678, 0.0, 0.70710678, 0.0])
    assert abs(np.linalg.norm(State.from_dict(state).spacecraft.q_from_inertial) - 1.0) < 1e-15


def render(renderer, **changes):
    state = views.state()
    fields = {"r_sun_inertial_m": state.r_sun_inertial_m, "spacecraft": state.spacecraft, "bodies": state.bodies}
    return renderer.render(State(**{**fields, **changes}))


def test_unknown_and_missing_bodies(renderer):
    pose = Pose(r_inertial_m=np.zeros(3))
    with pytest.raises(SceneError, match="state.bodies.ryugu: unknown body; the scene has body"):
        render(renderer, bodies={"body": pose, "ryugu": pose})
    with pytest.raises(SceneError, match="state.bodies.body: missing"):
        render(renderer, bodies={})


def test_unknown_camera_product_and_arguments(renderer):
    state = views.state()
    with pytest.raises(SceneError, match="camera: unknown camera, got 'wac'; the scene has navcam"):
        renderer.render(state, camera="wac")
    with pytest.raises(ConfigError, match=r"products\[1\]: must be one of .*, got 'depth'"):
        renderer.render(state, products=["range", "depth"])
    for value in (0.0, -1.0, 2.0, float("nan"), "low", 1e-308, 5e-324):
        with pytest.raises(ConfigError, match="max_error"):
            renderer.render(state, max_error=value)
    assert renderer.render(state, max_error=LEAST).plan.predicted_error > LEAST
    for value in (0, 17, 1.5):
        with pytest.raises(ConfigError, match="samples: must be an integer between 1 and 16"):
            renderer.render(state, samples=value)


def test_what_is_no_state_scene_law_or_list_is_refused(renderer):
    state = views.state()
    with pytest.raises(ConfigError, match="state: must be a State, got .*State.from_dict"):
        renderer.render(state.to_dict())
    with pytest.raises(ConfigError, match="products: must be names of products, got None"):
        renderer.render(state, products=None)
    with pytest.raises(ConfigError, match="scene: must be a Scene, got None"):
        Renderer(None)
    for label in ("bodies", "cameras"):
        fields = {"bodies": renderer.scene.bodies, "cameras": renderer.scene.cameras, label: None}
        with pytest.raises(ConfigError, match=f"{label}: must be a sequence of .*, got None"):
            Scene(**fields)


def test_a_closed_renderer_says_so():
    renderer = Renderer(views.scene([views.sphere(GREY, 1)], [views.camera()]))
    renderer.close()
    renderer.close()
    with pytest.raises(DeviceError, match="this renderer is closed"):
        renderer.render(views.state())
    with pytest.raises(DeviceError, match="this renderer is closed"):
        renderer.evaluate_brdf(GREY, *np.eye(3)[None, :1].repeat(3, axis=0))


@pytest.mark.parametrize("changes, message", [
    ({"law": "lambert"}, "law: must be a law of glrender.brdf, got 'lambert'"),
    ({"to_camera": np.ones((2, 3))}, r"to_camera: must have shape \(3, 3\), as to_sun, got \(2, 3\)"),
    ({"normal": [0.0, 0.0, 1.0]}, r"normal: must be \(N, 3\) finite numbers"),
    ({"to_sun": np.full((3, 3), np.nan)}, r"to_sun: must be \(N, 3\) finite numbers"),
    ({"to_sun": "x"}, r"to_sun: must be \(N, 3\) numbers")])
def test_evaluate_brdf_refuses_what_is_no_set_of_vectors(renderer, changes, message):
    fields = {"law": GREY, "to_sun": np.ones((3, 3)), "to_camera": np.ones((3, 3)), "normal": np.ones((3, 3))}
    with pytest.raises(ConfigError, match=message):
        renderer.evaluate_brdf(**{**fields, **changes})


def test_a_missing_texture_names_its_field(tmp_path):
    generate.icosphere(radius_m=1.0, subdivisions=1).to_file(tmp_path / "s.obj")
    with pytest.raises(ShapeError, match=r"^albedo_texture: texture cannot be read: .*none\.png"):
        Body.from_file(tmp_path / "s.obj", name="b", length_unit="m", brdf=GREY,
                       albedo_texture=tmp_path / "none.png")


@pytest.mark.parametrize("albedo_map", [np.zeros((0, 5)), np.zeros(4), -np.ones((2, 2)), "grey", [[1.0], [1.0, 2.0]]])
def test_an_albedo_map_that_is_no_image_is_refused(albedo_map):
    sphere = generate.icosphere(radius_m=1.0, subdivisions=1)
    shape = Shape.from_arrays(sphere.vertices_m, sphere.facets, uv=np.zeros((80, 3, 2)))
    with pytest.raises(ConfigError, match="albedo_map: must be a 2-D array"):
        Body(name="body", shape=shape, brdf=GREY, albedo_map=albedo_map)


@pytest.mark.parametrize("value, is_too_bright", [(1.0 / 0.3, False), (140.0, True)])
def test_a_map_of_numbers_up_to_255_is_warned_of(value, is_too_bright):
    """Such albedos count as 1: a white body, without a word else."""
    sphere = generate.icosphere(radius_m=1.0, subdivisions=1)
    shape = Shape.from_arrays(sphere.vertices_m, sphere.facets, uv=np.zeros((80, 3, 2)))
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.299), albedo_map=np.full((2, 2), value))
    text = "the albedo map times normal_albedo is 41.9 on average, where more than 1 counts as 1; albedo_texture_gain"
    assert any(text in each for each in body.shape.report.warnings) == is_too_bright


@pytest.mark.parametrize("r_m", [[0.0, 0.0, 0.0], [0.0, 99.0, 0.0], [50.0, 50.0, -50.0]])
def test_a_camera_inside_a_body_is_refused(renderer, r_m):
    with pytest.raises(SceneError, match="the camera must be outside body 'body'"):
        render(renderer, spacecraft=Pose(r_inertial_m=r_m))


def test_a_camera_in_the_neck_is_outside(renderer):
    """Inside the hull, outside the body: rendered, not refused; and inside the body by a metre: refused."""
    shape = views.binary(3, 4)
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=GREY)], [views.camera()])) as renderer:
        centres = shape.vertices_m[shape.facets].mean(axis=1)
        planes = ConvexHull(shape.vertices_m).equations
        depth = (planes[:, :3] @ centres.T + planes[:, 3:]).max(axis=0)
        deepest = int(np.argmin(depth))
        assert depth[deepest] < -3.0, "the neck is deep enough for a camera"
        for height_m, is_refused in ((1.0, False), (-1.0, True)):
            r = centres[deepest] + height_m * shape.facet_normals[deepest]
            if is_refused:
                with pytest.raises(SceneError, match="outside body"):
                    render(renderer, spacecraft=Pose(r_inertial_m=r))
            else:
                assert render(renderer, spacecraft=Pose(r_inertial_m=r)).plan.bodies[0].is_visible


def test_a_sun_inside_a_body_is_refused(renderer):
    with pytest.raises(SceneError, match="state.r_sun_inertial_m: must be outside body 'body'"):
        render(renderer, r_sun_inertial_m=[10.0, 0.0, 0.0])


@pytest.mark.parametrize("r_m, rule, way_out", [
    ([1.0, 0.0, 0.0], "outside body 'body'", "in au? then write [1.49598e+11, 0, 0]"),
    ([0.6, 0.0, -0.8], "outside body 'body'", "not a direction"),
    ([1.0e3, 0.0, 0.0], "at least a solar radius, 6.957e+08 m, from body 'body'", "not a direction"),
    ([1.5e8, 0.0, 0.0], "at least a solar radius, 6.957e+08 m, from body 'body'", "in km? then write [1.5e+11, 0, 0]")])
def test_a_sun_nearer_than_its_own_radius_is_refused(renderer, r_m, rule, way_out):
    """A direction, astronomical units or kilometres in the place of metres."""
    with pytest.raises(SceneError) as refused:
        render(renderer, r_sun_inertial_m=r_m)
    told = str(refused.value)
    assert told.startswith(f"state.r_sun_inertial_m: must be {rule}") and way_out in told


def test_a_body_too_small_for_float64_pixels_is_refused(renderer):
    """200 m across and f = 1000 px: below 1e-9 px from 2e14 m; above it the flux follows the inverse square."""
    fluxes = []
    for range_m in (1e9, 1e14):
        image = renderer.render(views.state(range_m=range_m))
        fluxes.append(float(image.irradiance_W_m2.sum(dtype=np.float64)) * range_m**2)
    np.testing.assert_allclose(fluxes[1], fluxes[0], rtol=1e-3)
    with pytest.raises(SceneError, match=r"body 'body' must be 1e-09 px across, got .*; it is less at 1e\+15 m"):
        renderer.render(views.state(range_m=1e15))


@pytest.mark.parametrize("changes, message", [
    ({"width_px": 0}, "width_px: must be an integer between 1 and 16384, got 0"),
    ({"width_px": 10.5}, "width_px: must be an integer"),
    ({"height_px": 20000}, "height_px"),
    ({"focal_length_px": 0.0}, "focal_length_px: must be between 0.001 and 1e\\+12, got 0.0"),
    ({"focal_length_px": 1e-300}, "focal_length_px: must be between 0.001 and 1e\\+12, got 1e-300"),
    ({"focal_length_px": 1e160}, "focal_length_px: must be between 0.001 and 1e\\+12, got 1e\\+160"),
    ({"principal_point_px": (1e6, 0.0)}, "principal_point_px: must be within 100000 px"),
    ({"principal_point_px": "ab"}, "principal_point_px: must be 2 numbers, got 'ab'"),
    ({"r_camera_spacecraft_m": (0.0, 1e20, 0.0)}, "r_camera_spacecraft_m: must be within 1e\\+16 m"),
    ({"focal_length_px": float("nan")}, "focal_length_px: must be a finite number"),
    ({"focal_length_px": 10**400}, "focal_length_px: must be a finite number"),
    ({"principal_point_px": (1.0,)}, "principal_point_px"),
    ({"q_camera_from_spacecraft": (1, 1, 0, 0)}, "q_camera_from_spacecraft: norm must be 1"),
    ({"name": ""}, "name: must be a name of 1 to 128 printable characters"),
])
def test_a_wrong_camera_names_its_field(changes, message):
    with pytest.raises(ConfigError, match=message):
        PinholeCamera(**{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 100.0, **changes})


SCENE = """
[[bodies]]
name = "body"
generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 2 }
brdf = { law = "lambert", normal_albedo = 0.2 }
[[cameras]]
name = "navcam"
width_px = 64
height_px = 64
focal_length_px = 100.0
"""


@pytest.mark.parametrize("old, new, message", [
    ("", "", None),
    ("[[bodies]]", "gamma = 2.2\n[[bodies]]", r"scene\.toml\.gamma: unknown key"),
    ("[[bodies]]", "max_error = 0.0\n[[bodies]]", r"scene\.toml\.max_error: must be > 0 and <= 1, got 0.0"),
    ("[[bodies]]", "solar_irradiance_1au_W_m2 = 1e300\n[[bodies]]",
     r"scene\.toml\.solar_irradiance_1au_W_m2: must be between 1e-06 and 1e\+09, got 1e\+300"),
    ("normal_albedo = 0.2", "normal_albedo = 1.2",
     r"bodies\[0\]\.brdf\.normal_albedo: must be between 0 and 1, got 1.2"),
    ("normal_albedo = 0.2", "normal_albedo = 20", r"must be between 0 and 1, got 20; 20 % is 0.2"),
    ('{ law = "lambert", normal_albedo = 0.2 }', '"lambert"', r"\.brdf: must be a table, got 'lambert'; as \{ law = "),
    ("[[cameras]]", "[cameras]", r"cameras: must be a list of tables .*; in a file write \[\[cameras\]\]"),
    ("focal_length_px", "distortion = [0.1, 0.2]\nfocal_length_px", r"distortion: must be a table.*is k1, k2, p1"),
    ("normal_albedo = 0.2", "albedo = 0.2", r"bodies\[0\]\.brdf\.albedo: unknown key; did you mean 'normal_albedo'\?"),
    (", normal_albedo = 0.2", "", r"bodies\[0\]\.brdf\.normal_albedo: missing"),
    ('law = "lambert"', 'law = "phong"', r"bodies\[0\]\.brdf\.law: must be one of .*'lambert'.*got 'phong'"),
    ('law = "lambert", normal_albedo = 0.2', 'preset = "pluto"', r"bodies\[0\]\.brdf\.preset: must be one of .*'eros"),
    ('law = "lambert", normal_albedo = 0.2', 'preset = "eros_550nm"', None),
    ('law = "lambert"', 'preset = "eros_550nm"', r"bodies\[0\]\.brdf\.normal_albedo: unknown key"),
    ('kind = "icosphere"', 'kind = "cube"', r"bodies\[0\]\.generated\.kind: must be one of"),
    ("radius_m = 100.0", "radius_m = -1.0", r"bodies\[0\]\.generated\.radius_m"),
    ("radius_m = 100.0", "radius_m = 1e300", r"generated\.radius_m: must be between 0.001 and 1e\+09, got 1e\+300"),
    ("radius_m = 100.0", "radius_m = 1e-30", r"generated\.radius_m: must be between 0.001 and 1e\+09, got 1e-30"),
    ("generated = ", "shape = 'x.obj'\ngenerated = ", r"bodies\[0\]: needs exactly one of"),
    ("generated = ", "generatd = ", r"bodies\[0\]\.generatd: unknown key"),
    ('generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 2 }', 'shape = "nothing.obj"',
     r"bodies\[0\]\.length_unit: missing.*shape files carry no unit"),
    ('generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 2 }',
     'shape = "nothing.obj"\nlength_unit = "km"', r"bodies\[0\]\.shape.*nothing\.obj"),
    ('generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 2 }',
     'shape = "nothing.obj"\nlength_unit = "mile"', r"bodies\[0\]\.length_unit: must be 'm', 'km' or metres per unit"),
    ('generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 2 }',
     'shape = "nothing.obj"\nlength_unit = 1e300', r"bodies\[0\]\.length_unit: must be between 1e-09 and 1e\+09"),
    ("focal_length_px = 100.0", "focal_length_mm = 100.0", r"cameras\[0\]\.focal_length_mm: unknown key"),
    ("width_px = 64", "width_px = 64.5", r"cameras\[0\]\.width_px: must be an integer"),
    ("[[cameras]]", "[[camera]]", r"scene\.toml\.camera: unknown key"),
    ("[[bodies]]", "[[bodies", "scene.toml: is not TOML"),
])
def test_a_wrong_scene_file_names_the_path_of_the_field(tmp_path, old, new, message):
    file = tmp_path / "scene.toml"
    file.write_text(SCENE.replace(old, new, 1) if old else SCENE)
    if message is None:
        assert load_scene(file).bodies[0].name == "body"
        return
    with pytest.raises(ConfigError, match=message):
        load_scene(file)


def test_a_missing_scene_file_says_so(tmp_path):
    with pytest.raises(ConfigError, match="none.toml: cannot be read: No such file"):
        load_scene(tmp_path / "none.toml")


def test_names_must_be_unique():
    with pytest.raises(ConfigError, match=r"bodies\[1\].name: must be unique, got 'body'"):
        Scene(bodies=[views.sphere(GREY, 1)] * 2, cameras=[views.camera()])
    with pytest.raises(ConfigError, match="cameras: must have at least one member"):
        Scene(bodies=[views.sphere(GREY, 1)], cameras=[])


@pytest.mark.parametrize("name", ["/etc/passwd", "../secret.obj", "sub/x.obj", "..", "."])
def test_a_restricted_scene_reads_only_bare_names_of_its_folder(tmp_path, name):
    table = {"bodies": [{"name": "b", "shape": name, "length_unit": "m",
                         "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
             "cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 10.0}]}
    with pytest.raises(ConfigError, match=r"bodies\[0\]\.shape: must be a bare file name"):
        Scene.from_dict(table, shape_dir=tmp_path, restricted=True)
    with pytest.raises(ConfigError, match="serves no files"):
        Scene.from_dict(table, restricted=True)


@pytest.mark.parametrize("field", ["shape", "albedo_texture"])
@pytest.mark.parametrize("name", ["a\0b.obj", "a" * 5000 + ".obj", "\ud800" * 90 + ".obj"], ids=("NUL", "long", "odd"))
def test_names_that_no_file_system_has_are_refused(tmp_path, field, name):
    generate.icosphere(radius_m=1.0, subdivisions=1).to_file(tmp_path / "s.obj")
    table = {"bodies": [{"name": "b", "shape": "s.obj", "length_unit": "m", field: name,
                         "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
             "cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 10.0}]}
    with pytest.raises(ConfigError, match=rf"bodies\[0\]\.{field}: must be a file name of at most 255 bytes"):
        Scene.from_dict(table, shape_dir=tmp_path, restricted=True)
    with pytest.raises(ConfigError, match=rf"bodies\[0\]\.{field}.*cannot be read"):
        Scene.from_dict(table, shape_dir=tmp_path)


def test_a_restricted_scene_follows_no_link_out(tmp_path):
    folder = tmp_path / "shapes"
    folder.mkdir()
    outside = tmp_path / "outside.obj"
    generate.icosphere(radius_m=1.0, subdivisions=1).to_file(outside)
    (folder / "link.obj").symlink_to(outside)
    (folder / "own.obj").write_bytes(outside.read_bytes())
    table = {"bodies": [{"name": "b", "shape": "link.obj", "length_unit": "m",
                         "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
             "cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 10.0}]}
    with pytest.raises(ConfigError, match="must be a file in the server's shape directory"):
        Scene.from_dict(table, shape_dir=folder, restricted=True)
    table["bodies"][0]["shape"] = "own.obj"
    assert Scene.from_dict(table, shape_dir=folder, restricted=True).bodies[0].name == "b"


def test_pixels_never_hold_nan_whatever_the_state(renderer, rng):
    """Two hundred random states, some on the surface, at grazing light, at opposition: finite, never negative."""
    for _ in range(200):
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        range_m = 100.0 * (1.0 + 10.0 ** rng.uniform(-3, 3))
        state = views.state(phase_deg=rng.choice([0.0, 1e-5, 90.0, 179.9, 180.0, rng.uniform(0, 180)]),
                            range_m=range_m, direction=direction,
                            target=rng.standard_normal(3) * rng.choice([0.0, 100.0, range_m]))
        image = renderer.render(state, samples=1)
        assert np.isfinite(image.irradiance_W_m2).all()
        assert image.irradiance_W_m2.min() >= 0.0
