"""Laser ranges: against every facet by brute force, closed forms, Embree, and the OpenGL product; and over the wire."""

from __future__ import annotations

import numpy as np
import pytest
import serving
import views
from glrender import Body, ConfigError, Renderer, SceneError, generate
from glrender.brdf import Lambert
from glrender.engines.rays.exact_rays import ExactMesh
from glrender.engines.rays.laser_ranges import RangeNoise, laser_ranges
from glrender_client import Client, ServerError
from missing import needed_module

LAW = Lambert(normal_albedo=0.2)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def brute(vertices, facets, ray):
    """Nearest distance by testing every facet's three edges."""
    corner = vertices[facets]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    with np.errstate(divide="ignore"):
        t = np.einsum("ij,ij->i", corner[:, 0], normal) / (normal @ ray)
    point = t[:, None] * ray
    inside = t > 0.0
    for k in range(3):
        edge = corner[:, (k + 1) % 3] - corner[:, k]
        inside &= np.einsum("ij,ij->i", np.cross(edge, point - corner[:, k]), normal) >= 0.0
    return np.where(inside, t, np.inf).min()


@pytest.mark.parametrize("origin_m", [(300.0, 50.0, 20.0), (0.0, 0.0, 5000.0), (-120.0, 90.0, -60.0),
                                      (0.0, 0.0, 125.0)])
def test_the_nearest_facet_is_found_as_by_testing_all(origin_m, rng):
    shape = generate.three_lobes(radius_m=100.0, subdivisions=4)
    mesh, vertices = ExactMesh(shape.vertices_m, shape.facets), shape.vertices_m - np.array(origin_m)
    aim = unit(rng.uniform(-120.0, 120.0, (400, 3)) - np.array(origin_m))
    anywhere = unit(rng.normal(size=(100, 3)))
    rays = np.concatenate([aim, anywhere, np.eye(3), -np.eye(3)])
    facet, distance = mesh.hit(np.array(origin_m), rays)
    truth = np.array([brute(vertices, shape.facets, ray) for ray in rays])
    np.testing.assert_allclose(distance, truth, rtol=1e-11)
    assert 0.2 < np.isfinite(truth).mean() < 1.0
    assert ((facet >= 0) == np.isfinite(distance)).all()


def test_no_ray_slips_between_facets(rng):
    """Rays at vertices and along edges of a closed body always meet it."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=3)
    vertices = shape.vertices_m - np.array([400.0, 0.0, 0.0])
    corner = vertices[shape.facets]
    weight = rng.uniform(0.0, 1.0, (len(corner), 1))
    targets = np.concatenate([vertices, corner[:, 0] * weight + corner[:, 1] * (1.0 - weight)])
    # Grazing ones at the limb may pass by.
    targets = targets[np.einsum("ij,ij->i", targets + [400.0, 0.0, 0.0], -unit(targets)) > 10.0]
    _, distance = ExactMesh(vertices, shape.facets).hit(np.zeros(3), unit(targets))
    np.testing.assert_allclose(distance, np.linalg.norm(targets, axis=1), rtol=1e-9)


def test_far_beyond_float32_the_range_is_exact():
    """At 5e8 m float32 resolves 32 m; a facet square to the ray answers to 1e-15."""
    vertices = np.array([[-1.0, -1.0, 5e8 + 0.125], [1.0, -1.0, 5e8 + 0.125], [0.0, 1.0, 5e8 + 0.125]])
    _, distance = ExactMesh(vertices, np.array([[0, 1, 2]])).hit(np.zeros(3), np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(distance, 5e8 + 0.125, rtol=1e-15)


def test_a_sphere_answers_in_closed_form():
    """An icosphere of 81 920 facets: its faces lie within R (1 - cos(half a facet)) of the sphere."""
    scene = views.scene([views.sphere(LAW, subdivisions=6)], [views.camera()])
    state = views.state(range_m=2000.0)
    off = np.radians([0.0, 0.5, 1.0, 2.0, 2.8, 2.9])
    found = laser_ranges(scene, state, np.stack([np.sin(off), 0.0 * off, np.cos(off)], axis=1))
    miss = 2000.0 * np.sin(off)
    truth = 2000.0 * np.cos(off) - np.sqrt(np.maximum(100.0**2 - miss**2, 0.0))
    hits = miss < 100.0
    assert hits.tolist() == [True] * 5 + [False]
    np.testing.assert_allclose(found.range_m[hits], truth[hits], atol=0.05)
    np.testing.assert_allclose(found.beam_incidence[hits], np.arcsin(miss[hits] / 100.0), atol=0.02)
    assert np.isnan(found.range_m[~hits]).all() and (found.body_id == np.where(hits, 0, -1)).all()


@pytest.fixture(scope="module")
def two_bodies():
    bodies = [Body(name="body", shape=generate.three_lobes(radius_m=100.0, subdivisions=5), brdf=LAW),
              views.sphere(LAW, radius_m=40.0, name="moon")]
    camera = views.camera(q_camera_from_spacecraft=unit(np.array([1.0, 0.02, -0.03, 0.4])),
                          r_camera_spacecraft_m=[1.0, 2.0, 3.0])
    state = views.state(bodies=("body", "moon"), range_m=1500.0).to_dict()
    state["spacecraft"]["q_from_inertial"] = views.state(range_m=1500.0).spacecraft.q_from_inertial.tolist()
    state["bodies"]["body"]["q_from_inertial"] = unit(np.array([0.3, 0.2, -0.5, 0.7])).tolist()
    state["bodies"]["moon"]["r_inertial_m"] = [60.0, -250.0, 100.0]
    from glrender import State
    return views.scene(bodies, [camera]), State.from_dict(state)


def test_pixels_and_rays_agree(two_bodies):
    """Along a pixel's centre the ray and the OpenGL products see the same facet at the same range."""
    scene, state = two_bodies
    camera = scene.cameras[0]
    with Renderer(scene) as renderer:
        image = renderer.render(state, products=["range", "body_id", "facet_id", "emission"])
    y, x = np.mgrid[0:camera.height_px:3, 0:camera.width_px:3]
    found = laser_ranges(scene, state, camera.directions(np.stack([x.ravel(), y.ravel()], axis=1)))
    seen = {name: array[::3, ::3].ravel() for name, array in image.products.items()}
    assert set(found.body_id) == {-1, 0, 1}, "both bodies and the sky are in view"
    same = (found.facet_id == seen["facet_id"]) & (found.body_id == seen["body_id"])
    assert same.mean() > 0.995, "a pixel on an edge may fall to either side"
    hit = same & (found.body_id >= 0)
    np.testing.assert_allclose(found.range_m[hit], seen["range"][hit], rtol=1e-6)
    np.testing.assert_allclose(found.beam_incidence[hit], seen["emission"][hit], atol=2e-3)


def test_embree_agrees(two_bodies):
    needed_module("embreex", "pip install embreex")
    from glrender import open_renderer

    scene, state = two_bodies
    camera = scene.cameras[0]
    with open_renderer(scene, "raytrace") as tracer:
        image = tracer.render(state, products=["range", "facet_id"], samples=1)
    y, x = np.mgrid[0:camera.height_px:5, 0:camera.width_px:5]
    found = laser_ranges(scene, state, camera.directions(np.stack([x.ravel(), y.ravel()], axis=1)))
    same = found.facet_id == image.products["facet_id"][::5, ::5].ravel()
    assert same.mean() > 0.995
    hit = same & (found.facet_id >= 0)
    np.testing.assert_allclose(found.range_m[hit], image.products["range"][::5, ::5].ravel()[hit], rtol=1e-10)


def test_noise_is_of_the_size_asked_for_and_repeats():
    scene, state = views.scene([views.sphere(LAW)], [views.camera()]), views.state(range_m=2000.0)
    rays = np.repeat([[0.0, 0.0, 1.0]], 10_000, axis=0)
    exact = laser_ranges(scene, state, rays).range_m
    noisy = laser_ranges(scene, state, rays, noise=RangeNoise(sigma_m=0.5, seed=4)).range_m
    # Ten thousand draws: mean within 4 sigma of 0.005, standard deviation within 4 of 0.7 %.
    np.testing.assert_allclose((noisy - exact).mean(), 0.0, atol=0.02)
    np.testing.assert_allclose((noisy - exact).std(), 0.5, rtol=0.03)
    again = laser_ranges(scene, state, rays, noise=RangeNoise(sigma_m=0.5, seed=4)).range_m
    np.testing.assert_array_equal(again, noisy)
    as_matlab = laser_ranges(scene, state, rays, noise=RangeNoise(sigma_m=0.5, seed=4.0)).range_m
    np.testing.assert_array_equal(as_matlab, noisy)
    rounded = laser_ranges(scene, state, rays[:1], noise=RangeNoise(resolution_m=0.25)).range_m
    assert rounded % 0.25 == 0.0 and abs(rounded - exact[0]) <= 0.125
    lost = laser_ranges(scene, state, rays[:1], noise=RangeNoise(max_range_m=1899.0))
    assert np.isnan(lost.range_m[0]) and np.isnan(lost.beam_incidence[0])
    assert (lost.body_id[0], lost.facet_id[0]) == (-1, -1)
    assert laser_ranges(scene, state, rays[:1], noise=RangeNoise(max_range_m=1901.0)).body_id[0] == 0


@pytest.mark.parametrize("value, message", [
    ([[0.0, 0.0, 1.1]], r"directions_camera\[0\]: norm must be 1"),
    ([[0.0, 0.0, 1.0], [0.0, 0.0, float("nan")]], r"directions_camera\[1\]: norm"),
    ([], "must be a list of unit vectors"), ([[0.0, 1.0]], "must be a list of unit vectors"),
    ("up", "must be a list of unit vectors"), ([[1, 0, 0], [1, 0]], "must be a list of unit vectors"),
    (np.tile([0.0, 0.0, 1.0], (10_001, 1)), "must be at most 10000, got 10001"),
])
def test_what_is_no_direction_is_refused(value, message):
    scene, state = views.scene([views.sphere(LAW, subdivisions=1)], [views.camera()]), views.state()
    with pytest.raises(ConfigError, match=message):
        laser_ranges(scene, state, value)


def test_over_the_wire_it_is_the_same(tmp_path, two_bodies):
    from glrender import State, load_scene

    table = views.state().to_dict()
    rays = unit(np.random.default_rng(1).normal([0.0, 0.0, 1.0], 0.03, (50, 3)))
    with serving.server(tmp_path, "--workers", "2") as (endpoint, _), Client(endpoint) as client:
        scene = load_scene(tmp_path / "scene.toml")
        expected = laser_ranges(scene, State.from_dict(table), rays, "bare")
        reply = client.range(table, rays, "bare")
        for name in ("body_id", "facet_id", "beam_incidence"):
            np.testing.assert_array_equal(reply.arrays[name], getattr(expected, name))
        np.testing.assert_array_equal(reply.arrays["range"], expected.range_m)
        assert np.isfinite(expected.range_m).any() and repr(reply).startswith("<Reply range t=0.0 s")
        assert client.hello()["limits"]["max_directions"] == 10_000 and "range" in client.hello()["operations"]
        noisy = client.range(table, rays, "bare", noise={"sigma_m": 1.0, "seed": 2})
        np.testing.assert_array_equal(noisy.arrays["range"], laser_ranges(
            scene, State.from_dict(table), rays, "bare", RangeNoise(sigma_m=1.0, seed=2)).range_m)
        for changes, code, path in [
                ({"noise": {"sigma": 1.0}}, "config", "noise.sigma"),
                ({"noise": {"sigma_m": -1}}, "config", "noise.sigma_m"),
                ({"noise": {"seed": 0.5}}, "config", "noise.seed"), ({"noise": 3}, "config", "noise"),
                ({"directions_camera": [[0, 0, 2]]}, "config", "directions_camera[0]"),
                ({"directions_camera": "x"}, "config", "directions_camera"), ({"camera": "wac"}, "scene", "camera")]:
            with pytest.raises(ServerError) as caught:
                client.range(**{"state": table, "directions_camera": rays, "camera": "bare", **changes})
            assert (caught.value.code, caught.value.path) == (code, path)


def test_a_camera_inside_a_body_is_refused():
    scene = views.scene([views.sphere(LAW)], [views.camera()])
    with pytest.raises(SceneError, match="outside body"):
        laser_ranges(scene, views.state(range_m=50.0), [0.0, 0.0, 1.0])
