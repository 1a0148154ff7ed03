"""Rooms and lamps: against rays written here, and the closed forms of a sphere around its lamp."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import (
    Body,
    ConfigError,
    Detail,
    Lamp,
    Noise,
    PinholeCamera,
    Pose,
    Renderer,
    Scene,
    SceneError,
    Shape,
    State,
    frames,
    generate,
    open_renderer,
)
from glrender.brdf import Hapke, Lambert

ALBEDO, INTENSITY_W_SR = 0.15, 3.0
# A corner of the room, the boresight, and a spacecraft that hangs askew.
EYE_M, AIM_M = np.array([-3.0, -2.0, 1.6]), np.array([1.0, 1.0, 1.8])
MOUNT = frames.look_at([0.0, 0.0, 0.0], [0.2, 0.1, 1.0], (0.0, 1.0, 0.0))
OFF_M, LAMP_M = np.array([0.3, -0.2, 0.1]), np.array([0.9, -0.8, 0.9])
SUN_M = [1.5e11, 0.0, 0.0]


def box(low, high, faces_inward=False):
    """Vertices (8, 3) and facets (12, 3) of a box."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    facets = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
                       [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
    return np.array(low) + (np.array(high) - low) * corner, facets[:, ::-1] if faces_inward else facets


def room_with_pillar():
    """A room of 8 x 6 x 5 m that faces inward, and a pillar in it."""
    walls, inner = box([-4.0, -3.0, 0.0], [4.0, 3.0, 5.0], True)
    pillar, outer = box([0.5, 0.5, 0.0], [1.5, 1.5, 4.0])
    return np.concatenate([walls, pillar]), np.concatenate([inner, outer + 8])


def camera(px=64, **options):
    return PinholeCamera(name="c", width_px=px, height_px=px, focal_length_px=0.75 * px, **options)


def scene(shape, *lamps, law=None, **options):
    body = Body(name="room", shape=shape, brdf=law or Lambert(normal_albedo=ALBEDO))
    mounted = camera(q_camera_from_spacecraft=MOUNT, r_camera_spacecraft_m=OFF_M)
    return Scene(**{"bodies": [body], "cameras": [mounted], "lamps": lamps, "max_error": 0.02} | options)


def state(eye_m=EYE_M, aim_m=AIM_M, up=(0.0, 0.0, 1.0), body="room", mount=MOUNT, off_m=OFF_M):
    """The camera, not the spacecraft, at a place and with an aim."""
    q_camera = frames.look_at(eye_m, aim_m, up)
    spacecraft_from_inertial = frames.dcm(mount).T @ frames.dcm(q_camera)
    return State(r_sun_inertial_m=SUN_M, bodies={body: Pose(r_inertial_m=np.zeros(3))}, spacecraft=Pose(
        r_inertial_m=eye_m - spacecraft_from_inertial.T @ off_m,
        q_from_inertial=frames.quaternion(spacecraft_from_inertial)))


def first(corners, start, ray):
    """Facets (N,) and distances (N,) that rays meet first, from either side (Moeller and Trumbore 1997)."""
    best, number = np.full(len(ray), np.inf), np.full(len(ray), -1)
    for k, (a, b, c) in enumerate(corners):
        p = np.cross(ray, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / (p @ (b - a))
            u = np.einsum("ij,ij->i", start - a, p) * scale
            q = np.cross(start - a, b - a)
            v, t = np.einsum("ij,ij->i", ray, q) * scale, q @ (c - a) * scale
        nearer = (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1.0 + 1e-12) & (t > 1e-9) & (t < best)
        best[nearer], number[nearer] = t[nearer], k
    return number, best


def truth(vertices, facets, lamps, law, n=6):
    """Irradiance (H, W) [W/m2] of pixels in the light of lamps, by n x n jittered rays each."""
    corners, pinhole, rng = vertices[facets], camera(), np.random.default_rng(3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    inertial_from_camera = frames.dcm(frames.look_at(EYE_M, AIM_M, (0.0, 0.0, 1.0))).T
    inertial_from_spacecraft = inertial_from_camera @ frames.dcm(MOUNT)
    y, x = (each.ravel() for each in np.mgrid[:64, :64])
    total = np.zeros(64 * 64)
    for k in range(n * n):
        jitter = (np.array([k % n, k // n]) + rng.random((len(x), 2))) / n - 0.5
        ray = np.stack([(x + jitter[:, 0] - 31.5) / 48.0, (y + jitter[:, 1] - 31.5) / 48.0, np.ones(len(x))], axis=1)
        length = np.linalg.norm(ray, axis=1)
        ray = ray / length[:, None] @ inertial_from_camera.T
        number, distance_m = first(corners, np.broadcast_to(EYE_M, ray.shape), ray)
        point, normal = EYE_M + ray * distance_m[:, None], normals[number]
        for lamp in lamps:
            place_m = EYE_M + inertial_from_spacecraft @ (np.array(lamp.r_spacecraft_m) - OFF_M)
            to_lamp = place_m - point
            away_m = np.linalg.norm(to_lamp, axis=1)
            to_lamp /= away_m[:, None]
            cosine = np.einsum("ij,ij->i", normal, to_lamp)
            off_deg = np.degrees(np.arccos(np.clip(-to_lamp @ inertial_from_spacecraft @ lamp.direction, -1.0, 1.0)))
            _, free_m = first(corners, point + 1e-7 * normal, to_lamp)
            is_lit = (cosine > 0.0) & (off_deg <= lamp.half_angle_deg) & (free_m > away_m - 1e-6)
            radiance = law.brdf(to_lamp, -ray, normal) * np.maximum(cosine, 0.0) * lamp.intensity_W_sr / away_m**2
            total += is_lit * radiance / length**3 / pinhole.focal_length_px**2
    return (total / n**2).reshape(64, 64)


def error(found, expected):
    lit = expected > 0.0
    rms = np.sqrt(np.mean((found[lit] - expected[lit]) ** 2)) / expected[lit].mean()
    return rms, found.sum() / expected.sum() - 1.0


@pytest.mark.parametrize("lamps, law", [
    ([Lamp(name="a", intensity_W_sr=INTENSITY_W_SR, r_spacecraft_m=LAMP_M)], Lambert(normal_albedo=ALBEDO)),
    ([Lamp(name="a", intensity_W_sr=INTENSITY_W_SR, r_spacecraft_m=LAMP_M, direction=[0.1, -0.3, 2.0],
           half_angle_deg=15.0)], Lambert(normal_albedo=ALBEDO)),
    ([Lamp(name="a", intensity_W_sr=1.0), Lamp(name="b", intensity_W_sr=5.0, direction=[1.0, 0.0, 0.2],
                                               r_spacecraft_m=LAMP_M, half_angle_deg=90.0)],
     Hapke(single_scattering_albedo=0.4, b=0.3, c=0.5, roughness_deg=15.0))])
def test_a_room_with_a_pillar_by_lamps(lamps, law):
    """RMS within the predicted error and 1 %, flux within a tenth of max_error and 0.2 %; so by raytrace."""
    vertices, facets = room_with_pillar()
    made = scene(Shape.from_arrays(vertices, facets, inside=True), *lamps, law=law)
    expected = truth(vertices, facets, lamps, law)
    assert len(lamps) > 1 or (expected == 0.0).mean() > 0.01
    for backend in ("auto", "raytrace"):
        with open_renderer(made, backend) as renderer:
            image = renderer.render(state())
        rms, flux = error(image.irradiance_W_m2.astype(float), expected)
        assert rms < image.plan.predicted_error + 0.01 and image.plan.predicted_error <= 0.02, backend
        assert abs(flux) < 0.1 * 0.02 + 0.002, backend
        assert not image.warnings


def test_a_sphere_around_its_lamp_is_evenly_bright():
    """Each place has A I / (pi R^2); the plan gives the bound of light between walls, that of all of it here."""
    ball = generate.icosphere(radius_m=5.0, subdivisions=5)
    shape = Shape.from_arrays(ball.vertices_m, ball.facets[:, ::-1], inside=True)
    made = scene(shape, Lamp(name="a", intensity_W_sr=INTENSITY_W_SR), cameras=[camera()])
    with Renderer(made) as renderer:
        image = renderer.render(state(np.zeros(3), [1.0, 0.0, 0.0], mount=[1.0, 0.0, 0.0, 0.0], off_m=np.zeros(3)))
    radiance = ALBEDO / np.pi * INTENSITY_W_SR / 25.0
    np.testing.assert_allclose(image.irradiance_W_m2[32, 32], radiance / 48.0**2, rtol=0.005)
    assert image.plan.left_out == ("room: light between walls, which all together get at most 1/(1 - A) = 1.18 times "
                                   "the light, and dim ones more",)
    assert image.plan.windows[0].why == "rays alone draw lamps"


def test_a_lamp_shines_on_a_night_side_and_behind_the_sun():
    """The light of a lamp and of the Sun add up; a body outside the cone stays dark, without a word of a night side."""
    ball = generate.icosphere(radius_m=5.0, subdivisions=3)
    at = state([20.0, 0.0, 0.0], np.zeros(3), mount=[1.0, 0.0, 0.0, 0.0], off_m=np.zeros(3))
    lamp = Lamp(name="a", intensity_W_sr=100.0)
    light, warned = {}, {}
    for name, lamps, sun in (("both", [lamp], 0.3), ("sun", [], 0.3), ("lamp", [lamp], 1e-6), ("beside", [Lamp(
            name="a", intensity_W_sr=100.0, direction=[0.0, 0.0, -1.0], half_angle_deg=30.0)], 1e-6)):
        made = scene(ball, *lamps, cameras=[camera(32)], solar_irradiance_1au_W_m2=sun, max_error=0.005)
        with Renderer(made) as renderer:
            image = renderer.render(at)
            night = State(r_sun_inertial_m=[-1.5e11, 1e9, 0.0], spacecraft=at.spacecraft, bodies=at.bodies)
            dark = renderer.render(night, max_error=0.02)
        light[name], warned[name] = image.irradiance_W_m2.sum(dtype=float), [each.code for each in dark.warnings]
    np.testing.assert_allclose(light["both"], light["sun"] + light["lamp"], rtol=2e-3)
    assert light["lamp"] > 0.0 and light["beside"] < 1e-4 * light["lamp"]
    assert warned["lamp"] == [] and "night_side" in warned["sun"] and "night_side" not in warned["beside"]


@pytest.mark.parametrize("range_m, angle_deg", [(3e2, 180.0), (3e4, 180.0), (3e4, 170.0), (3e4, 90.0)])
def test_a_far_body_by_a_lamp_has_the_light_that_is_predicted(range_m, angle_deg):
    """Below 4 px: the sum over a convex body's facets, each of one light, by the lamp and by the Sun."""
    ball, albedo, angle = generate.icosphere(radius_m=1.0, subdivisions=5), 0.3, np.radians(angle_deg)
    lamp, au_m = Lamp(name="a", intensity_W_sr=1e9), 149_597_870_700.0
    pinhole = PinholeCamera(name="c", width_px=32, height_px=32, focal_length_px=500.0)
    made = scene(ball, lamp, cameras=[pinhole], law=Lambert(normal_albedo=albedo), solar_irradiance_1au_W_m2=1000.0)
    r_sun = au_m * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    with Renderer(made) as renderer:
        image = renderer.render(State(r_sun_inertial_m=r_sun, spacecraft=Pose(r_inertial_m=np.zeros(3)),
                                      bodies={"room": Pose(r_inertial_m=[0.0, 0.0, range_m])}))
    to_eye_m = -ball.vertices_m[ball.facets].mean(axis=1) - [0.0, 0.0, range_m]
    away_m = np.linalg.norm(to_eye_m, axis=1)
    mu = np.maximum(np.einsum("fx,fx->f", ball.facet_normals, to_eye_m) / away_m, 0.0)
    mu0 = np.maximum(ball.facet_normals @ (r_sun / au_m), 0.0)
    light = mu * lamp.intensity_W_sr / away_m**2 + 1000.0 * mu0
    expected = albedo / np.pi * (light * mu * ball.facet_areas_m2 / away_m**2).sum()
    assert abs(image.irradiance_W_m2.sum(dtype=float) / expected - 1.0) < 0.1 * 0.02
    # Where a crescent has a third of the light its own error is predicted.
    assert (image.plan.predicted_error <= 0.02 and not image.warnings) == (angle_deg != 170.0)


def test_a_camera_outside_a_room_is_warned():
    """Whatever lights it, as the walls' backs hide nothing; not in it, nor outside a ball that has a cave."""
    room, far = Shape.from_arrays(*room_with_pillar(), inside=True), np.array([-20.0, -15.0, 12.0])
    outer, inner = (generate.icosphere(radius_m=radius_m, subdivisions=2) for radius_m in (4.0, 2.0))
    hollow = Shape.from_arrays(np.concatenate([outer.vertices_m, inner.vertices_m]), np.concatenate(
        [outer.facets, inner.facets[:, ::-1] + len(outer.vertices_m)]), inside=True)
    lamp = Lamp(name="a", intensity_W_sr=1.0)
    for shape, lamps, eye_m, is_outside in (
            (room, [lamp], far, True), (room, [], far, True), (room, [lamp], EYE_M, False),
            (hollow, [lamp], far, False), (hollow, [lamp], 0.1 * EYE_M, False)):
        with Renderer(scene(shape, *lamps, max_error=0.2)) as renderer:
            for sun in ([1.5e11, 0.0, 0.0], [1e10, 2e10, 1.5e11]):
                at = state(eye_m, [0.0, 0.0, 2.5 if shape is room else 0.5])
                at = State(r_sun_inertial_m=sun, spacecraft=at.spacecraft, bodies=at.bodies)
                found = [each for each in renderer.render(at).warnings if each.code == "behind_ground"]
                assert bool(found) == is_outside, (eye_m, sun)
                if found:
                    assert "the camera is outside the room room, or in its walls" in found[0].message


def test_a_body_shades_another_from_a_lamp_aside():
    """A lamp 6 m off the camera: a ball that the camera sees past is in the way of the lamp's light."""
    ball = generate.icosphere(radius_m=1.0, subdivisions=3)
    bodies = [Body(name=name, shape=ball, brdf=Lambert(normal_albedo=0.2)) for name in ("near", "far")]
    lamp = Lamp(name="a", intensity_W_sr=10.0, r_spacecraft_m=[6.0, 0.0, 0.0])
    made = Scene(bodies=bodies, cameras=[camera()], lamps=[lamp], solar_irradiance_1au_W_m2=1e-6)
    poses = {"far": Pose(r_inertial_m=[0.0, 0.0, 20.0]), "near": Pose(r_inertial_m=[3.0, 0.0, 10.0])}
    apart = {**poses, "near": Pose(r_inertial_m=[-3.0, 0.0, 10.0])}
    with Renderer(made) as renderer:
        shaded, free = (renderer.render(State(
            r_sun_inertial_m=SUN_M, spacecraft=Pose(r_inertial_m=np.zeros(3)), bodies=each)
        ).irradiance_W_m2[28:36, 28:36].sum() for each in (poses, apart))
    # The Sun has a millionth of a W/m2.
    assert shaded < 1e-4 * free


def test_a_dark_room_is_warned_of_its_lamps():
    """Without a lamp, and out of its cone: never the Sun's place."""
    room = Shape.from_arrays(*room_with_pillar(), inside=True)
    away = Lamp(name="a", intensity_W_sr=1.0, direction=[0.0, 0.0, -1.0], half_angle_deg=10.0)
    for lamps, path, text in (((), "lamps", "no sunlight is on the inside of room; give the scene a lamp"),
                              ((away,), "state.bodies.room", "out of the lamps' cones, ")):
        with Renderer(scene(room, *lamps)) as renderer:
            image = renderer.render(state())
        (found,) = image.warnings
        assert not image.irradiance_W_m2.any() and (found.code, found.path) == ("dark", path) and text in found.message


def test_a_room_of_two_materials(tmp_path):
    """The pillar's facets have a law of their own: as if all were one body, and one sentence on light between walls."""
    vertices, facets = room_with_pillar()
    lines = ["mtllib two.mtl", *(f"v {x} {y} {z}" for x, y, z in vertices)]
    for name, some in (("white", facets[:12]), ("black", facets[12:])):
        lines += [f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in some + 1)]
    (tmp_path / "room.obj").write_text("\n".join(lines))
    (tmp_path / "two.mtl").write_text(f"newmtl white\nKd {ALBEDO} {ALBEDO} {ALBEDO}\nnewmtl black\nKd 0.1 0.1 0.1\n")
    body = Body.from_file(tmp_path / "room.obj", name="room", length_unit="m", inside=True,
                          materials={"black": Lambert(normal_albedo=ALBEDO)})
    lamp = Lamp(name="a", intensity_W_sr=INTENSITY_W_SR, r_spacecraft_m=LAMP_M)
    with Renderer(scene(body.shape, lamp, bodies=[body])) as renderer:
        image = renderer.render(state())
    expected = truth(vertices, facets, [lamp], Lambert(normal_albedo=ALBEDO))
    rms, flux = error(image.irradiance_W_m2.astype(float), expected)
    assert rms < image.plan.predicted_error + 0.01 and abs(flux) < 0.004 and len(image.plan.left_out) == 1


def test_what_draws_no_lamps_is_refused():
    room = Shape.from_arrays(*room_with_pillar(), inside=True)
    made = scene(room, lamp := Lamp(name="a", intensity_W_sr=1.0))
    with Renderer(made) as renderer:
        with pytest.raises(ConfigError, match="engine: must be one of rays, got 'raster'"):
            renderer.render(state(), engine="raster")
        with pytest.raises(ConfigError, match="samples: are drawn by OpenGL, which draws no lamps, got 4; leave"):
            renderer.render(state(), samples=4)
        with pytest.raises(ConfigError, match="derivatives: are of sunlight, and this scene has lamps; leave"):
            renderer.render(state(), derivatives=["sun"])
    detailed = Body(name="room", shape=room, brdf=Lambert(normal_albedo=0.1),
                    detail=Detail(seed=1, noise=Noise(amplitude_m=0.1, longest_m=1.0, shortest_m=0.1)))
    with pytest.raises(ConfigError, match=r"bodies\[0\].detail: goes without lamps.*leave one out"):
        Renderer(Scene(bodies=[detailed], cameras=[camera()], lamps=[lamp]))


@pytest.mark.parametrize("options, message", [
    ({"intensity_W_sr": -1.0}, "intensity_W_sr: must be"), ({"intensity_W_sr": "3"}, "intensity_W_sr: must be"),
    ({"intensity_W_sr": float("nan")}, "intensity_W_sr: must be"), ({}, "intensity_W_sr: missing"),
    ({"half_angle_deg": 91.0}, "half_angle_deg: must be within 0 to 90, or 180 for all round, got 91.0"),
    ({"half_angle_deg": 0.0}, "half_angle_deg: must be within 0 to 90"), ({"half_angle_deg": 200.0}, "half_angle_deg"),
    ({"direction": [0.0, 0.0, 0.0]}, "direction: must not be zero"), ({"direction": [1.0]}, "direction: must have"),
    ({"r_spacecraft_m": [0.0, 0.0, 1e17]}, "r_spacecraft_m: must be within"), ({"name": ""}, "name: must be a name"),
    ({"colour": 3.0}, "colour: unknown key")])
def test_a_wrong_lamp_is_refused_by_its_field(options, message):
    table = {"cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 20.0}],
             "bodies": [{"name": "a", "generated": {"kind": "icosphere", "radius_m": 5.0, "subdivisions": 1},
                         "brdf": {"law": "lambert", "normal_albedo": 0.1}}]}
    right = {"name": "l", "intensity_W_sr": 1.0}
    lamps = Scene.from_dict({**table, "lamps": [{**right, "direction": [0.0, 3.0, 0.0], "half_angle_deg": 90}]}).lamps
    np.testing.assert_array_equal(lamps[0].direction, [0.0, 1.0, 0.0])
    with pytest.raises(ConfigError, match="lamps: must be a list of tables"):
        Scene.from_dict({**table, "lamps": []})
    with pytest.raises(ConfigError, match=r"lamps\[1\].name: must be unique"):
        Scene.from_dict({**table, "lamps": [right, right]})
    wrong = {**right, **options} if options else {"name": "l"}
    with pytest.raises(ConfigError, match=rf"scene.lamps\[1\].{message}"):
        Scene.from_dict({**table, "lamps": [right, wrong]})


def test_a_room_is_as_the_file_has_it_where_a_camera_may_be_inside(tmp_path):
    """By file, scene and arrays; else it is turned outward and no camera may be in it; open or outward it is none."""
    vertices, facets = room_with_pillar()
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in facets + 1]
    (tmp_path / "room.obj").write_text("\n".join(lines))
    brdf = {"law": "lambert", "normal_albedo": 0.1}
    table = {"cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 6.0}],
             "bodies": [{"name": "room", "shape": "room.obj", "length_unit": "m", "inside": True, "brdf": brdf}]}
    for shape in (Shape.from_arrays(vertices, facets, inside=True),
                  Scene.from_dict(table, shape_dir=tmp_path).bodies[0].shape,
                  Body.from_file(tmp_path / "room.obj", length_unit="m", inside=True, name="room",
                                 brdf=Lambert(normal_albedo=0.1)).shape):
        assert shape.inside and shape.report.n_flipped == 0 and shape.report.volume_m3 == pytest.approx(4.0 - 240.0)
    turned = Shape.from_arrays(vertices, facets)
    assert turned.report.n_flipped == 12 and not turned.inside
    with Renderer(scene(turned)) as renderer, pytest.raises(SceneError, match="camera must be outside"):
        renderer.render(state())
    outward, open_ = box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), (vertices[:8], facets[:11])
    for wrong in (outward, open_):
        with pytest.raises(ConfigError, match="inside: goes with closed shells of which one faces inward"):
            Shape.from_arrays(*wrong, inside=True)
    with pytest.raises(ConfigError, match="inside: must be true or false"):
        Shape.from_arrays(vertices, facets, inside=1)
    ball = {"kind": "icosphere", "radius_m": 5.0}
    table["bodies"][0] = {"name": "a", "generated": ball, "inside": True, "brdf": brdf}
    with pytest.raises(ConfigError, match=r"inside: goes with `shape`, a file"):
        Scene.from_dict(table)


def test_a_camera_under_open_ground_is_warned():
    """Near it and far below, in the dark and where it sees a slope's front; above it there is no warning."""
    x, y = np.meshgrid(np.linspace(-100.0, 100.0, 21), np.linspace(-100.0, 100.0, 21), indexing="ij")
    vertices = np.stack([x, y, 20.0 * np.sin(x / 30.0)], axis=-1).reshape(-1, 3)
    corner = np.arange(441).reshape(21, 21)
    a, b, c, d = (each.ravel() for each in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    ground = Shape.from_arrays(vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))
    made = scene(ground, cameras=[camera()])
    plain = {"mount": [1.0, 0.0, 0.0, 0.0], "off_m": np.zeros(3)}
    with Renderer(made) as renderer:
        for eye_m, aim_m, is_behind in (
                ([45.0, 0.0, 10.0], [80.0, 0.0, 0.0], True), ([0.0, 0.0, -400.0], [0.0, 0.0, 0.0], True),
                ([45.0, 0.0, 25.0], [80.0, 0.0, 0.0], False), ([0.0, 0.0, 400.0], [0.0, 0.0, 0.0], False)):
            up = (1.0, 0.0, 0.0)
            at = state(np.array(eye_m), aim_m, up, **plain)
            lit = State(r_sun_inertial_m=[1e11, 0.0, 1e11], spacecraft=at.spacecraft, bodies=at.bodies)
            found = [each for each in renderer.render(lit).warnings if each.code == "behind_ground"]
            assert bool(found) == is_behind, eye_m
            if found:
                assert "behind the ground of room, or under it" in found[0].message
