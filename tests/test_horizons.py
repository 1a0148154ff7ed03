"""Horizons of vertices against rays: what they call open is free, beside needles and below what floats too."""

from __future__ import annotations

import numpy as np
import pytest
import solids
import views
from glrender import Body, Shape, generate
from glrender.area_engine import AreaEngine
from glrender.brdf import Lambert
from glrender.horizons import Horizons, tree
from glrender.ray_engine import RayEngine
from glrender.rays import LIFT, RayMesh
from glrender.view import view_bodies
from trimesh.remesh import subdivide


def together(*parts):
    """One shape of several (vertices, facets)."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return Shape.from_arrays(np.concatenate([vertices for vertices, _ in parts]),
                             np.concatenate([facets + k for k, (_, facets) in zip(first[:-1], parts, strict=True)]))


def plain():
    """(vertices, facets) of a slab whose top, at z = 0, has vertices everywhere."""
    vertices, facets = solids.box((-100, -100, -20), (100, 100, 0))
    for _ in range(5):
        vertices, facets = subdivide(vertices, facets)
    return vertices, facets


def needles():
    rng = np.random.default_rng(0)
    feet = rng.uniform(-70.0, 70.0, (20, 2))
    return together(plain(), *(solids.box((x, y, -5.0), (x + 1.0, y + 1.0, 60.0)) for x, y in feet))


def floating():
    rng, ball = np.random.default_rng(0), generate.icosphere(radius_m=4.0, subdivisions=1)
    places = rng.uniform((-70.0, -70.0, 10.0), (70.0, 70.0, 80.0), (12, 3))
    return together(plain(), *((ball.vertices_m + place, ball.facets) for place in places))


SHAPES = {
    "needles": needles, "floating": floating,
    "a thin wall": lambda: together(plain(), solids.box((-60.0, 10.0, -5.0), (60.0, 10.3, 30.0))),
    "a binary": lambda: generate.contact_binary(radius_m=100.0, seed=3, subdivisions=4),
    "spikes": lambda: generate.gaussian_random_sphere(radius_m=100.0, sigma=0.8, correlation_deg=5.0, subdivisions=4),
    "a bowl": lambda: solids.bowl(n=24)}


@pytest.mark.parametrize("name, most_open", [
    ("needles", 0.6), ("floating", 0.6), ("a thin wall", 0.7), ("a binary", 0.7), ("spikes", 0.1), ("a bowl", 0.7)])
def test_what_is_open_is_free_and_most_of_what_is_free_is_open(name, most_open):
    shape = SHAPES[name]()
    horizons, mesh = Horizons(shape), RayMesh(shape.vertices_m, shape.facets)
    every, rng = np.arange(len(shape.vertices_m)), np.random.default_rng(1)
    start_m = shape.vertices_m + LIFT * mesh.radius_m * horizons._normals.T
    n_free = n_open = 0
    for place_m in 300.0 * rng.standard_normal((60, 3)):
        direction = place_m / np.linalg.norm(place_m)
        is_free = ~mesh.blocks(start_m, direction)
        is_open = horizons.are_open(every, direction, False)
        assert not (is_open & ~is_free).any(), np.flatnonzero(is_open & ~is_free)
        n_free, n_open = n_free + np.count_nonzero(is_free), n_open + np.count_nonzero(is_open)
        away = 1e9 * direction
        np.testing.assert_array_equal(horizons.are_open(every, away, True)[::7],
                                      horizons.are_open(every[::7].copy(), away, True))
    assert n_open > most_open * n_free


@pytest.mark.parametrize("name", ["needles", "floating", "a binary"])
def test_an_image_is_the_same_where_every_ray_is_cast(name, monkeypatch):
    camera, state = views.camera(128, 600.0), views.state(phase_deg=40.0, direction=(0.3, -0.6, 0.6))
    scene = views.scene([Body(name="body", shape=SHAPES[name](), brdf=Lambert(normal_albedo=0.3))], [camera])
    seen, images = view_bodies(state, camera, scene.hulls), []
    for is_open in (Horizons.are_open, lambda self, vertices, towards, is_place: np.zeros(len(vertices), bool)):
        monkeypatch.setattr(Horizons, "are_open", is_open)
        rays = RayEngine(scene)
        images.append(AreaEngine(scene, rays).draw(("body",), camera, seen, camera.bounds_px, (128, 128), 0.02)[0])
        rays.close()
    assert images[0].any()
    np.testing.assert_array_equal(*images)


def test_what_is_all_closed_sees_nothing_even_along_its_normal():
    """Rounding makes a unit vector's product with itself more than 1."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=3)
    horizons = Horizons(shape)
    horizons._table[:] = 255
    for vertex, normal in enumerate(horizons._normals.T):
        assert not horizons.are_open(np.array([vertex]), normal, False)[0]


@pytest.mark.parametrize("stored", [np.zeros((3, 16), np.uint8), np.zeros((12, 16)), np.zeros(0, np.uint8)])
def test_a_table_that_is_not_the_shape_s_is_made_anew(stored, tmp_path, monkeypatch):
    """Compiled loops look at no bounds."""
    monkeypatch.setenv("GLRENDER_CACHE", str(tmp_path))
    shape = generate.icosphere(radius_m=100.0, subdivisions=0)
    expected = Horizons(shape)._table
    (file,) = tmp_path.glob("horizons*")
    np.savez(file, horizons=stored)
    np.testing.assert_array_equal(Horizons(shape)._table, expected)


@pytest.mark.parametrize("n_facets", [1, 4, 5, 37, 80])
def test_every_facet_is_in_one_leaf_and_in_the_boxes_around_it(n_facets):
    vertices_m = np.random.default_rng(2).uniform(-1.0, 1.0, (3 * n_facets, 3))
    shape = Shape(vertices_m=vertices_m, facets=np.arange(3 * n_facets, dtype=np.int32).reshape(-1, 3), uv=None,
                  report=None)
    corners, middles_m, halves_m, radii_m, begins = tree(shape)
    assert sorted(corners[0]) == list(range(0, 3 * n_facets, 3))
    n_leaves = len(begins) - 1
    assert len(radii_m) == 2 * n_leaves and begins[0] == 0 and begins[-1] == n_facets and (np.diff(begins) > 0).all()
    np.testing.assert_allclose(radii_m, np.linalg.norm(halves_m, axis=0))
    for leaf in range(n_leaves):
        points = vertices_m[corners[:, begins[leaf]:begins[leaf + 1]].ravel()].T
        node = n_leaves + leaf
        while node:
            assert (abs(points - middles_m[:, [node]]) <= halves_m[:, [node]] + 1e-12).all()
            node //= 2
