"""Panels that are given with both their sides, by each engine. Truth: a Lambertian plate, E = A/pi F cos(incidence)."""

from __future__ import annotations

import numpy as np
import pytest
import views
from glrender import Body, Pose, Scene, Shape, State, frames, open_renderer
from glrender.base.constants import AU_M
from glrender.base.errors import ConfigError
from glrender.brdf import Lambert, LommelSeeliger
from glrender.engines.cycles import Cycles
from glrender.engines.cycles.backend import has_two_faces
from glrender.engines.cycles.blender_terms import BlenderTerms
from glrender.engines.rays.laser_ranges import laser_ranges
from solids import box

GREY = Lambert(normal_albedo=0.3)
N = 6
PRODUCTS = ("facet_id", "incidence", "emission", "sunlit")


def panel(scale=1.0, bend_m=0.0):
    """A rectangle of 4 m x 2 m in 72 triangles, bent along x, from x = 1 m on."""
    x, y = np.meshgrid(np.linspace(1.0, 5.0, N + 1), np.linspace(-1.0, 1.0, N + 1))
    first = (np.arange(N)[:, None] * (N + 1) + np.arange(N)).ravel()
    facets = np.concatenate([np.stack([first, first + 1, first + N + 2], 1),
                             np.stack([first, first + N + 2, first + N + 1], 1)])
    return scale * np.stack([x, y, bend_m * ((x - 3.0) / 2.0) ** 2], axis=-1).reshape(-1, 3), facets


def craft(scale=1.0, with_box=True, **kwargs):
    """A panel with both its sides, alone or beside a box."""
    places, sheet = panel(scale)
    corners, facets = (scale * box((-0.5,) * 3, (0.5,) * 3)[0], box((-0.5,) * 3, (0.5,) * 3)[1]) if with_box else (
        np.zeros((0, 3)), np.zeros((0, 3), int))
    sheet = sheet + len(corners)
    return Body(name="body", shape=Shape.from_arrays(
        np.concatenate([corners, places]), np.concatenate([facets, sheet, sheet[:, ::-1]])), brdf=GREY, **kwargs)


def pose(r_camera, target):
    return Pose(r_inertial_m=r_camera, q_from_inertial=frames.look_at(np.array(r_camera), np.array(target)))


def looking(side, incidence_deg, scale=1.0, sun_side=None):
    """A camera 20 m before the panel's middle, on a side of it; the Sun at an angle from the panel's normal there."""
    angle = np.radians(incidence_deg)
    to_sun = np.array([0.0, np.sin(angle), (sun_side or side) * np.cos(angle)])
    r_camera = scale * np.array([3.0, 0.0, 20.0 * side])
    return State(r_sun_inertial_m=AU_M * to_sun, bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                 spacecraft=pose(r_camera, scale * np.array([3.0, 0.0, 0.0])))


@pytest.mark.parametrize("backend, options", [
    ("auto", {"samples": 4}), ("raytrace", {}), ("auto", {"max_error": 0.001}), ("auto", {"max_error": 0.02}),
    ("auto", {"max_error": 0.2})], ids=["OpenGL", "rays", "0.001", "0.02", "0.2"])
@pytest.mark.parametrize("scale, with_box", [(1.0, True), (1.0, False), (1000.0, True)])
def test_each_side_is_lit_as_a_plate_is(backend, options, scale, with_box):
    """To 4e-4 in the middle 16 x 16 pixels, where cos^3 off the boresight is no less; no side shades its other one."""
    scene = views.scene([craft(scale, with_box)], [views.camera(100, 1000.0)], sun_disc=False)
    with open_renderer(scene, backend) as renderer:
        for side in (-1.0, 1.0):
            for incidence_deg in (0.0, 45.0, 80.0, 88.0):
                image = renderer.render(looking(side, incidence_deg, scale), **options).irradiance_W_m2[42:58, 42:58]
                truth = 0.3 / np.pi * views.SOLAR_IRRADIANCE_W_M2 * np.cos(np.radians(incidence_deg)) / 1000.0**2
                np.testing.assert_allclose(image, truth, rtol=4e-4)
            behind = renderer.render(looking(side, 20.0, scale, sun_side=-side), **options)
            assert not behind.irradiance_W_m2[42:58, 42:58].any(), "the side that the Sun does not light is dark"


QUAD = "v 1 -1 0\nv 5 -1 0\nv 5 1 0\nv 1 1 0\n"
BENT = "v 1 -1 0\nv 3 -1 0\nv 5 -1 0\nv 5 1 0\nv 3 0.9 0\nv 1 1 0\n"


@pytest.mark.parametrize("text, n_facets", [
    (QUAD + "f 1 2 3 4\nf 4 3 2 1\n", 4), (QUAD + "f 1 2 3 4\nf 1 4 3 2\n", 4),
    (QUAD + QUAD + "f 1 2 3 4\nf 8 7 6 5\n", 4), (QUAD + "f 1 2 3\nf 1 3 4\nf 4 3 2\nf 4 2 1\n", 4),
    (BENT + "f 1 2 3 4 5 6\nf 6 5 4 3 2 1\n", 8), (BENT + "f 1 2 3 4 5 6\nf 3 2 1 6 5 4\n", 8)],
    ids=["turned", "from the first corner", "corners of its own", "other diagonals", "concave", "concave, turned"])
def test_sides_that_begin_elsewhere_are_sides_all_the_same(tmp_path, text, n_facets):
    """Of polygons wound the other way from any corner, and of triangles along the other diagonal: rays see each."""
    (tmp_path / "panel.obj").write_text(text)
    body = Body.from_file(tmp_path / "panel.obj", name="body", length_unit="m", brdf=GREY)
    assert (body.shape.report.n_facets, body.shape.report.n_two_sided) == (n_facets, n_facets // 2)
    assert not body.shape.report.warnings
    with open_renderer(views.scene([body], [views.camera(100, 1000.0)], sun_disc=False), "raytrace") as renderer:
        for side in (-1.0, 1.0):
            image = renderer.render(looking(side, 60.0)).irradiance_W_m2[42:58, 42:58]
            np.testing.assert_allclose(image, 0.3 / np.pi * views.SOLAR_IRRADIANCE_W_M2 * 0.5 / 1000.0**2, rtol=4e-4)


def test_texture_coordinates_stay_with_their_corners_where_a_diagonal_changes():
    places = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]])
    sheet = [[0, 1, 2], [0, 2, 3], [3, 2, 1], [3, 1, 0]]
    shape = Shape.from_arrays(places, np.array(sheet), uv=places[sheet][..., :2] / 4.0)
    np.testing.assert_array_equal(4.0 * shape.uv, shape.vertices_m[shape.facets][..., :2])


@pytest.mark.parametrize("backend, options", [("auto", {"samples": 4}), ("raytrace", {})])
def test_smooth_normals_of_each_side_are_its_own(backend, options):
    scene = views.scene([craft(smooth_normals=True)], [views.camera(100, 1000.0)], sun_disc=False)
    with open_renderer(scene, backend) as renderer:
        for side in (-1.0, 1.0):
            image = renderer.render(looking(side, 60.0), **options).irradiance_W_m2[42:58, 42:58]
            np.testing.assert_allclose(image, 0.3 / np.pi * views.SOLAR_IRRADIANCE_W_M2 * 0.5 / 1000.0**2, rtol=4e-4)


def test_what_a_pixel_sees_is_told_of_the_side_that_it_faces():
    """Facets, incidence and emission: 30 deg and 0 at the middle from either side, another facet from each."""
    scene = views.scene([craft(with_box=False)], [views.camera(33, 400.0)])
    seen = []
    for backend in ("auto", "raytrace"):
        with open_renderer(scene, backend) as renderer:
            for side in (-1.0, 1.0):
                told = renderer.render(looking(side, 30.0), products=PRODUCTS).products
                np.testing.assert_allclose(np.degrees(told["incidence"][16, 16]), 30.0, atol=0.1)
                np.testing.assert_allclose(np.degrees(told["emission"][16, 16]), 0.0, atol=0.1)
                assert told["sunlit"][16, 16] == 1
                seen.append(set(np.unique(told["facet_id"][told["facet_id"] >= 0])))
    assert not seen[0] & seen[1] and seen[0] == seen[2] and seen[1] == seen[3]


@pytest.mark.parametrize("backend", ["auto", "raytrace"])
def test_a_flat_panel_from_its_edge_is_dark_and_from_one_side_only_is_seen_there(backend):
    """Without a thickness there is nothing to see along it; of a sheet with one side the other is seen through."""
    places, sheet = panel()
    sheet = Body(name="body", shape=Shape.from_arrays(places, sheet), brdf=GREY)
    along = State(r_sun_inertial_m=[0.0, 0.0, AU_M], bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=pose([30.0, 0.0, 0.0], [3.0, 0.0, 0.0]))
    for body in (craft(with_box=False), sheet):
        with open_renderer(views.scene([body], [views.camera(64, 300.0)]), backend) as renderer:
            assert renderer.render(along).irradiance_W_m2.sum() < 1e-9
            lit = [renderer.render(looking(side, 20.0)).irradiance_W_m2[32, 32] > 0.0 for side in (-1.0, 1.0)]
            assert lit == ([True, True] if body is not sheet else [False, True])


@pytest.mark.parametrize("backend, options", [("auto", {"samples": 4}), ("raytrace", {}), ("auto", {})])
def test_a_panel_shades_what_is_behind_it_once(backend, options):
    """A wall 5 m behind, half in the panel's shadow: lit as a plate where the Sun passes, dark behind the panel."""
    places, sheet = panel()
    wall = np.array([[-20.0, -20, -5], [20, -20, -5], [20, 20, -5], [-20, 20, -5]])
    facets = np.concatenate([sheet, sheet[:, ::-1], np.array([[0, 1, 2], [0, 2, 3]]) + len(places)])
    body = Body(name="body", shape=Shape.from_arrays(np.concatenate([places, wall]), facets), brdf=GREY)
    with open_renderer(views.scene([body], [views.camera(65, 500.0)]), backend) as renderer:
        behind, aside = (renderer.render(State(
            r_sun_inertial_m=[0.0, 0.0, AU_M], bodies={"body": Pose(r_inertial_m=np.zeros(3))},
            spacecraft=pose([-30.0, 0.0, 30.0], [3.0, y, -5.0])), **options).irradiance_W_m2 for y in (0.0, 6.0))
    assert not behind[30:35, 30:35].any()
    np.testing.assert_allclose(aside[32, 32], 0.3 / np.pi * views.SOLAR_IRRADIANCE_W_M2 / 500.0**2, rtol=4e-4)


def test_blender_gets_one_of_two_sides_as_it_draws_both():
    """Two facets in one place would hide each other at random."""
    body = craft()
    facets = BlenderTerms(views.scene([body], [views.camera()])).arrays(body)["facets"]
    assert len(facets) == 12 + 72 and len(body.shape.facets) == 12 + 144


WALL_M, WALL_Z_M = 20.0, -5.0
ACROSS = State(r_sun_inertial_m=[0.0, 0.0, AU_M], bodies={"body": Pose(r_inertial_m=np.zeros(3))},
               spacecraft=pose([-30.0, 0.0, 30.0], [3.0, 0.0, -5.0]))


def before_a_wall(n_across):
    """A sheet of one side that faces a wall of many facets 5 m below it, in one body: sheet first."""
    places, sheet = panel()
    x, y = np.meshgrid(*2 * [np.linspace(-WALL_M, WALL_M, n_across + 1)])
    first = (np.arange(n_across)[:, None] * (n_across + 1) + np.arange(n_across)).ravel() + len(places)
    wall = np.concatenate([np.stack([first, first + 1, first + n_across + 2], 1),
                           np.stack([first, first + n_across + 2, first + n_across + 1], 1)])
    points = np.concatenate([places, np.stack([x, y, np.full_like(x, WALL_Z_M)], axis=-1).reshape(-1, 3)])
    return Body(name="body", shape=Shape.from_arrays(points, np.concatenate([sheet[:, ::-1], wall])), brdf=GREY)


def wall_alone(camera, n=8):
    """Irradiance (H, W) of the wall by rays of this test: dark where the sheet is between it and the Sun."""
    at = (np.arange(camera.width_px * n) + 0.5) / n - 0.5
    x, y = np.meshgrid(at, at)
    ray = np.stack([(x - camera.principal_point_px[0]) / camera.focal_length_px,
                    (y - camera.principal_point_px[1]) / camera.focal_length_px, np.ones_like(x)], axis=-1)
    length = np.linalg.norm(ray, axis=-1)
    ray = ray @ frames.dcm(ACROSS.spacecraft.q_from_inertial)
    place = ACROSS.spacecraft.r_inertial_m + ray * ((WALL_Z_M - 30.0) / ray[..., 2])[..., None]
    is_lit = (np.abs(place[..., :2]) < WALL_M).all(axis=-1) & ~(
        (np.abs(place[..., 0] - 3.0) < 2.0) & (np.abs(place[..., 1]) < 1.0))
    light = 0.3 / np.pi * views.SOLAR_IRRADIANCE_W_M2 * is_lit / (length**3 * camera.focal_length_px**2)
    return light.reshape(camera.height_px, n, camera.width_px, n).mean(axis=(1, 3))


@pytest.mark.parametrize("n_across, backend, options", [
    (1, "auto", {"samples": 4}), (1, "raytrace", {"max_error": 0.01}), (1, "auto", {"max_error": 0.3}),
    (1, "auto", {"max_error": 0.02}), (1, "auto", {"engine": "rays", "max_error": 0.02}),
    (1, "auto", {"engine": "coverage", "max_error": 0.3}), (110, "auto", {"max_error": 0.3})],
    ids=["OpenGL", "raytrace", "0.3", "0.02", "rays", "coverage", "centroids"])
def test_a_back_hides_nothing_and_casts_its_shadow(n_across, backend, options):
    """The wall through the back of a sheet, to 1 % of its light, by centroids 2 %; what is seen there is the wall."""
    scene = views.scene([before_a_wall(n_across)], [views.camera(65, 500.0)], sun_disc=False)
    with open_renderer(scene, backend) as renderer:
        image = renderer.render(ACROSS, products=["facet_id", "range"], **options)
    if n_across > 1:
        assert image.plan.windows[0].by_centroids
    truth = wall_alone(scene.cameras[0])
    assert views.relative_rms(image.irradiance_W_m2, truth) < 0.15
    np.testing.assert_allclose(image.irradiance_W_m2.sum(dtype=float), truth.sum(),
                               rtol=0.01 if n_across == 1 else 0.02)
    assert (image.products["facet_id"][20:45, 20:45] >= 2 * N * N).all()
    middle_m = np.linalg.norm([33.0, 0.0, 35.0])
    np.testing.assert_allclose(image.products["range"][32, 32], middle_m, rtol=1e-5)
    np.testing.assert_allclose(laser_ranges(scene, ACROSS, [0.0, 0.0, 1.0]).range_m, middle_m, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
@pytest.mark.parametrize("law", [GREY, LommelSeeliger(single_scattering_albedo=0.3)], ids=["Lambert", "OSL"])
def test_blender_looks_through_a_back_as_well(law):
    """It drew both sides of each facet: the sheet in place of the wall. A sheet of two sides is seen from either."""
    made = before_a_wall(1)
    scene = views.scene([Body(name="body", shape=made.shape, brdf=law)], [views.camera(65, 500.0)], sun_disc=False)
    with open_renderer(scene, "cycles", bounces=0) as cycles, open_renderer(scene, "raytrace") as rays:
        light = cycles.render(ACROSS, samples=8).irradiance_W_m2
        truth = wall_alone(scene.cameras[0]) if law is GREY else rays.render(ACROSS, samples=8).irradiance_W_m2
    assert views.relative_rms(light, truth) < 0.02
    np.testing.assert_allclose(light.sum(dtype=float), truth.sum(), rtol=2e-3)
    both = Body(name="body", shape=Shape.from_arrays(*panel(), sides="both"), brdf=law)
    with open_renderer(views.scene([both], [views.camera(64, 300.0)]), "cycles", bounces=2) as cycles:
        for side in (-1.0, 1.0):
            assert cycles.render(looking(side, 20.0), samples=4).irradiance_W_m2[32, 32] > 0.0


def test_blender_refuses_a_sheet_of_another_image_behind():
    """Of two facets in one place Blender draws either, so both must have the same texture coordinates."""
    places, sheet = panel()
    facets = np.concatenate([sheet, sheet[:, ::-1]])
    uv = (places[facets][..., :2] + [0.0, 1.0]) / [6.0, 2.0]
    other = np.where(np.arange(len(facets))[:, None, None] < len(sheet), uv, 0.5 * uv)
    same, differs = (Body(name="body", shape=Shape.from_arrays(places, facets, uv=each), brdf=GREY,
                          albedo_map=np.ones((2, 2))) for each in (uv, other))
    assert not has_two_faces(same)
    with pytest.raises(ConfigError, match="^albedo_map: must be the same on both sides of a sheet.*, got 'body'; "):
        Cycles(views.scene([differs], [views.camera()]))


OPEN_BOX = (box((-0.5,) * 3, (0.5,) * 3)[0], box((-0.5,) * 3, (0.5,) * 3)[1][2:])


@pytest.mark.parametrize("backend, options", [
    ("auto", {"samples": 4}), ("raytrace", {}), ("auto", {"max_error": 0.2}), ("auto", {"engine": "rays"})],
    ids=["OpenGL", "raytrace", "coverage", "rays"])
def test_sides_gives_panels_their_other_side(backend, options):
    """A bent panel and a flat one, each with one side in the file, lit as a plate from both sides of it."""
    shape = Shape.from_arrays(*panel(), sides="both")
    assert shape.report.n_two_sided == 2 * N * N and not shape.report.warnings
    body = Body(name="body", shape=shape, brdf=GREY)
    with open_renderer(views.scene([body], [views.camera(100, 1000.0)], sun_disc=False), backend) as renderer:
        for side in (-1.0, 1.0):
            for incidence_deg in (0.0, 60.0, 85.0):
                image = renderer.render(looking(side, incidence_deg), **options).irradiance_W_m2[42:58, 42:58]
                truth = 0.3 / np.pi * views.SOLAR_IRRADIANCE_W_M2 * np.cos(np.radians(incidence_deg)) / 1000.0**2
                np.testing.assert_allclose(image, truth, rtol=4e-4)


def test_sides_leaves_closed_shells_alone_and_keeps_texture_coordinates():
    corners, facets = box((-0.5,) * 3, (0.5,) * 3)
    places, sheet = panel()
    both = Shape.from_arrays(np.concatenate([corners, places]), np.concatenate([facets, sheet + len(corners)]),
                             uv=np.concatenate([corners, places])[np.concatenate([facets, sheet + 8])][..., :2] / 8.0,
                             sides="both")
    assert (both.report.n_facets, both.report.n_two_sided) == (12 + 4 * N * N, 2 * N * N)
    np.testing.assert_allclose(8.0 * both.uv, both.vertices_m[both.facets][..., :2], atol=1e-6)
    again = Shape.from_arrays(both.vertices_m, both.facets, sides="both")
    assert again.report.n_two_sided == 2 * N * N, "a panel that has both sides gets no third one"
    assert Shape.from_arrays(*OPEN_BOX, sides="both").report.n_two_sided == 10, "what is in an open box is seen too"
    for sides in ("file", "front"):
        assert Shape.from_arrays(places, sheet, sides=sides).report.n_two_sided == 0


def test_sides_in_a_scene_file(tmp_path):
    (tmp_path / "panel.obj").write_text(QUAD + "f 1 2 3 4\n")
    table = {"name": "body", "shape": "panel.obj", "length_unit": "m", "sides": "both",
             "brdf": {"law": "lambert", "normal_albedo": 0.3}}
    cameras = [{"name": "navcam", "width_px": 64, "height_px": 64, "focal_length_px": 100.0}]
    made = Scene.from_dict({"bodies": [table], "cameras": cameras}, shape_dir=tmp_path)
    assert made.bodies[0].shape.report.n_two_sided == 2
    with pytest.raises(ConfigError, match=r"bodies\[0\].sides: must be one of 'file', 'front', 'both', got 'back'"):
        Scene.from_dict({"bodies": [{**table, "sides": "back"}], "cameras": cameras}, shape_dir=tmp_path)
    ball = {"name": "body", "generated": {"kind": "icosphere", "radius_m": 1.0}, "brdf": table["brdf"], "sides": "both"}
    with pytest.raises(ConfigError, match="sides: goes with `shape`"):
        Scene.from_dict({"bodies": [ball], "cameras": cameras})
    del ball["sides"]
    for key, value in (("surface", 3), ("length_unit", "km")):
        with pytest.raises(ConfigError, match=rf"bodies\[0\].{key}: goes with `shape`, a file, got '?{value}'?; leave"):
            Scene.from_dict({"bodies": [{**ball, key: value}], "cameras": cameras})
    with pytest.raises(ConfigError, match="sides"):
        Body.from_file(tmp_path / "panel.obj", name="body", length_unit="m", brdf=GREY, sides="inside")
