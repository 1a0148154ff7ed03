"""Deviation of two surfaces: closed forms of spheres and boxes, movements that are known, halves, and the command."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from glrender import generate
from glrender_cli.__main__ import main
from glrender_photogrammetry import Mesh, deviation
from glrender_photogrammetry.mesh import Closest
from scipy.spatial.transform import Rotation

RADIUS_M = 100.0


@pytest.fixture(scope="module")
def sphere():
    return generate.icosphere(radius_m=RADIUS_M, subdivisions=6)


@pytest.fixture(scope="module")
def lobes():
    return generate.contact_binary(radius_m=300.0, seed=1, subdivisions=5)


def moved(shape, scale, turn_rad, shift_m, kept=slice(None)):
    turn = Rotation.from_rotvec(turn_rad).as_matrix()
    return Mesh(vertices_m=scale * shape.vertices_m @ turn.T + shift_m, facets=shape.facets[kept])


@pytest.mark.parametrize("higher_m", [1.0, -1.0])
def test_spheres_one_metre_larger_and_smaller(sphere, higher_m):
    """Closed form, to 0.02 m (issue); pixels of 0.9 and 1.1 m tell that all, or nothing, is within one."""
    model = generate.icosphere(radius_m=RADIUS_M + higher_m, subdivisions=5)
    found = deviation(model, sphere, px_m=1.1)
    np.testing.assert_allclose([found.mean_m, found.max_m, found.p95_m], [higher_m, 1.0, 1.0], atol=0.02)
    assert found.sigma_m < 0.02 and found.mad_m < 0.02 and found.complete_1px == 1.0 and found.seen == 1.0
    found = deviation(model, sphere, px_m=0.9)
    assert (found.complete_1px, found.complete_2px) == (0.0, 1.0)


def test_bumps_of_one_metre(sphere):
    """Vertices raised or sunk by 1 m in caps of known area stand 1 m off, all others lie on the sphere."""
    model = generate.icosphere(radius_m=RADIUS_M, subdivisions=5)
    up = model.vertices_m / RADIUS_M
    height_m = np.zeros(len(up))
    for k, (direction, own_m) in enumerate(zip(np.vstack([np.eye(3), -np.eye(3)]), [1, -1, 1, -1, 1, -1],
                                               strict=True)):
        height_m[up @ direction > np.cos(np.radians(10.0 + k))] = own_m
    found = deviation(Mesh(vertices_m=model.vertices_m + up * height_m[:, None], facets=model.facets), sphere)
    np.testing.assert_allclose(found.per_vertex_m, height_m, atol=0.02)
    np.testing.assert_allclose([found.mean_m, found.sigma_m, found.max_m],
                               [height_m.mean(), height_m.std(), 1.0], atol=0.02)
    assert found.mad_m < 0.02 and found.complete_1px is None


@pytest.mark.parametrize("kept", ["all", "half"])
def test_a_mesh_moved_turned_and_scaled_is_laid_back(lobes, kept):
    """Itself, whole and halved: nothing is left to 0.02 m, and what was done to it is found."""
    half = lobes.vertices_m[lobes.facets].mean(axis=1)[:, 2] > 0.0
    share = lobes.facet_areas_m2[half].sum() / lobes.facet_areas_m2.sum()
    kept, share = (half, share) if kept == "half" else (slice(None), 1.0)
    for scale, turn_rad, shift_m in ((1.004, [0.01, -0.02, 0.015], [4.0, -3.0, 2.0]),
                                     (0.9, [0.2, 0.1, -0.15], [40.0, 20.0, -30.0])):
        found = deviation(moved(lobes, scale, turn_rad, shift_m, kept), lobes, px_m=0.5, align="similarity")
        assert found.max_m < 0.02 and abs(found.complete_1px - share) < 0.03
        np.testing.assert_allclose([found.scale, found.turn_rad], [1.0 / scale, np.linalg.norm(turn_rad)], rtol=1e-4)
    assert deviation(moved(lobes, 1.004, [0.01, -0.02, 0.015], 0.0), lobes).max_m > 0.5


def test_attitudes_leave_a_turn_and_take_scale_and_shift(lobes):
    found = deviation(moved(lobes, 1.02, np.zeros(3), [5.0, -4.0, 3.0]), lobes, align="attitudes")
    np.testing.assert_allclose([found.scale, found.turn_rad], [1.0 / 1.02, 0.0], atol=1e-6)
    assert found.max_m < 0.02
    assert deviation(moved(lobes, 1.02, [0.02, 0.0, 0.0], 0.0), lobes, align="attitudes").max_m > 1.0


def test_half_a_mesh_is_half_complete(lobes):
    half = lobes.vertices_m[lobes.facets].mean(axis=1)[:, 0] > 0.0
    share = lobes.facet_areas_m2[half].sum() / lobes.facet_areas_m2.sum()
    found = deviation(Mesh(vertices_m=lobes.vertices_m, facets=lobes.facets[half]), lobes, px_m=0.1)
    assert found.max_m == 0.0 and abs(found.complete_1px - share) < 0.03


def test_distances_to_a_box_of_twelve_facets():
    """Signed distance of a box in closed form, near its edges and corners too, where facets are long and meet."""
    size = np.array([200.0, 30.0, 8.0])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    box = Mesh(vertices_m=corners, facets=[t for a, b, c, d in squares for t in ((a, b, c), (a, c, d))])
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (5000, 3)) * size
    beyond = np.abs(points) - size
    true = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
    found, place, facet = Closest(box)(points)
    np.testing.assert_allclose(found, true, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(points - place, axis=1), np.abs(true), atol=1e-9)
    on_plane = np.abs(((place - box.corners_m[facet, 0]) * box.facet_normals[facet]).sum(axis=1))
    assert on_plane.max() < 1e-9


def test_a_sample_is_even_over_the_area(sphere):
    points_m, facet = Mesh.of(sphere).sample(20_000)
    assert abs((points_m[:, 2] > 50.0).mean() - 0.25) < 0.01, "Archimedes: zones of a sphere by their height"
    assert len(np.unique(facet)) > 15_000


def test_vertices_of_no_facet_are_no_part_of_the_surface():
    """Far away in both: the alignment goes on to the end, and rays start near the body."""
    sphere = generate.icosphere(radius_m=RADIUS_M, subdivisions=4)
    lone = Mesh(vertices_m=np.vstack([sphere.vertices_m, [1e9, 0.0, 0.0]]), facets=sphere.facets)
    larger = Mesh(vertices_m=1.05 * lone.vertices_m, facets=lone.facets)
    found = deviation(larger, lone, align="similarity")
    np.testing.assert_allclose([found.scale, found.max_m, found.sigma_m], [1.0 / 1.05, 0.0, 0.0], atol=1e-4)
    ray = np.array([[0.0, 0.6, -0.8]])
    assert lone.seen_from(-5e4 * ray[0], ray)[0] == Mesh.of(sphere).seen_from(-5e4 * ray[0], ray)[0] >= 0


def test_a_fine_patch_on_a_coarse_surface_needs_few_pieces():
    """Squares of 64 m and of 1 m on a plane; the distances are the heights, next to the patch too."""
    def squares(n, side_m, start_m):
        y, x = np.divmod(np.arange((n + 1) ** 2), n + 1)
        corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
        return (np.column_stack([start_m + side_m * x, side_m * y, 0.0 * x]),
                np.vstack([corner + step for step in ([[0], [1], [n + 2]], [[0], [n + 2], [n + 1]])], dtype=int,
                          casting="unsafe").reshape(2, 3, -1).transpose(0, 2, 1).reshape(-1, 3))

    (coarse_m, coarse), (fine_m, fine) = squares(23, 64.0, 0.0), squares(26, 1.0, -26.0)
    closest = Closest(Mesh(vertices_m=np.vstack([coarse_m, fine_m]), facets=np.vstack([coarse, fine + len(coarse_m)])))
    assert len(coarse) == 1058 and len(fine) == 1352 and closest._tree.n < 200_000
    for low, high in (([0.0, 0.0, -30.0], [1400.0, 1400.0, 30.0]), ([-26.0, 0.0, -30.0], [60.0, 26.0, 30.0])):
        points_m = np.random.default_rng(1).uniform(low, high, (2000, 3))
        np.testing.assert_allclose(closest(points_m)[0], points_m[:, 2], atol=1e-9)


def test_a_small_patch_of_the_truth_is_no_other_unit(sphere):
    patch = moved(sphere, 1.0, np.zeros(3), 0.1, sphere.vertices_m[sphere.facets].mean(axis=1)[:, 2] > 99.9)
    assert 5.0 < np.ptp(patch.used_vertices_m, axis=0).max() < 11.0
    assert deviation(patch, sphere, align="none").max_m < 0.2


@pytest.mark.parametrize("model, options, message", [
    (lambda s: moved(s, 1.0, np.zeros(3), [1e4, 0.0, 0.0]), {}, "model: must overlap the truth, which lies from"),
    (lambda s: moved(s, 1e-3, np.zeros(3), 0.0), {"align": "similarity"}, "in another unit: give metres"),
    (lambda s: moved(s, 100.0, np.zeros(3), 0.0, s.vertices_m[s.facets].mean(axis=1)[:, 2] > 0.0), {}, "another unit"),
    (lambda s: moved(s, 39.37, np.zeros(3), 0.0), {"align": "attitudes"}, "must be of the truth's size"),
    (lambda s: moved(s, 1.0 / 39.37, np.zeros(3), 0.0), {}, "must be of the truth's size"),
    (lambda s: moved(s, 3.28, np.zeros(3), 0.0), {"align": "similarity"}, "truth's scale to 2 times, got '0.3049 by"),
    (lambda s: moved(s, 0.3048, np.zeros(3), 0.0), {"align": "attitudes"}, "truth's scale to 2 times, got '3.281 by"),
    (lambda s: s, {"frames": []}, "frames: must be one or more, got 0"),
    (lambda s: s, {"align": "icp"}, "align: must be one of none, attitudes, similarity, got 'icp'"),
    (lambda s: s, {"px_m": 0.0}, "px_m: must be > 0 and finite, got 0.0"),
])
def test_bad_input_is_refused_with_field_rule_and_value(sphere, model, options, message):
    with pytest.raises(ValueError, match=message):
        deviation(model(sphere), sphere, **options)


@pytest.mark.parametrize("vertices_m, facets, message", [
    ([[0, 0, 0], [1, 0, 0], [0, 1, np.nan]], [[0, 1, 2]], "vertices_m: must be finite numbers"),
    ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 2, 3]], "facets: must be integers from 0 to 2, got 3"),
    ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.empty((0, 3)), "facets: must be finite numbers of shape"),
])
def test_a_mesh_checks_its_facets(vertices_m, facets, message):
    with pytest.raises(ValueError, match=message):
        Mesh(vertices_m=vertices_m, facets=facets)


@pytest.mark.parametrize("ending", ["ply", "obj", "stl", "glb"])
def test_a_mesh_is_read_as_it_was_written(tmp_path, ending, lobes):
    Mesh.of(lobes).to_file(tmp_path / f"m.{ending}")
    back = Mesh.from_file(tmp_path / f"m.{ending}")
    np.testing.assert_allclose(back.corners_m, lobes.vertices_m[lobes.facets], atol=1e-3)


def test_the_command_tells_numbers_and_draws_a_map(tmp_path, lobes, capsys, monkeypatch):
    """A model 1 m too high on one side and too low on the other: red there, blue here."""
    monkeypatch.chdir(tmp_path)
    lobes.to_file("truth.obj")
    up = lobes.vertices_m / np.linalg.norm(lobes.vertices_m, axis=1, keepdims=True)
    side = np.sign(lobes.vertices_m[:, :1])
    Mesh(vertices_m=lobes.vertices_m + side * up, facets=lobes.facets).to_file("model.ply")
    assert main(["deviation", "model.ply", "truth.obj", "--px-m", "2", "--picture", "map.png", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert 0.8 < told["max_m"] <= 1.01 and abs(told["mean_m"]) < 0.2 and told["complete_1px"] == 1.0
    blue, _, red = np.moveaxis(cv2.imread("map.png")[420:840].astype(int), 2, 0)
    assert (red > blue + 60).sum() > 5000 and (blue > red + 60).sum() > 5000
    assert main(["deviation", "model.ply", "truth.obj"]) == 0
    assert capsys.readouterr().out.startswith("mean ")


@pytest.mark.parametrize("arguments, message", [
    (["none.ply", "truth.obj"], "none.ply"),
    (["cloud.ply", "truth.obj"], "cloud.ply: must hold triangles, got 'Trimesh'; a cloud of points has no surface"),
    (["truth.obj", "truth.obj", "--picture", "map.gif"], "--picture: must be a file .png or .jpg"),
    (["truth.obj", "truth.obj", "--picture", "nowhere/map.png"], "--picture: must be in a folder that is there"),
    (["truth.obj", "truth.obj", "--unit", "km"], "model: must be of the truth's size"),
    (["truth.obj", "truth.obj", "--frames", "."], ".: must be a folder of `glrender sequence`"),
])
def test_the_command_refuses_in_one_line(tmp_path, sphere, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    generate.icosphere(radius_m=RADIUS_M, subdivisions=2).to_file("truth.obj")
    (tmp_path / "cloud.ply").write_text("ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
                                        "property float z\nend_header\n0 0 0\n1 1 1\n")
    assert main(["deviation", *arguments]) == 1
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
