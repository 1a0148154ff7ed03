"""Rays near a large surface: the facets nearby are met about the camera, the others about the surface's middle."""

from __future__ import annotations

import numpy as np
import pytest
import raytracer
import views
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, Shape, State, frames
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.engines.rays.backend import RayTracer
from glrender.engines.rays.engine import RayEngine
from glrender.engines.rays.exact_rays import ExactMesh
from glrender.engines.rays.mesh import LEAST_LIFT, LIFT, RayMesh
from glrender.engines.rays.near_mesh import NearMesh
from glrender.view.view import view_bodies

SIDE_M, FOCAL_LENGTH_PX = 20e3, 110.0
GREY = Lambert(normal_albedo=0.2)
SPOT_M = np.array([5000.0, 3000.0, 0.0])
"""Where the ground is finest: far from the middle, about which float32 is good to 0.3 mm there."""
TO_SUN = np.array([0.55, -0.62, 0.56]) / np.linalg.norm([0.55, -0.62, 0.56])


def rough_ground(finest_m):
    """Vertices (V, 3) [m] and facets (F, 3) of ground of 20 km, with posts that are `finest_m` apart at the spot."""
    rng = np.random.default_rng(3)
    n = 70
    # From one post to the next they grow in proportion, so that 70 make half of a side.
    growth = 1.0
    for _ in range(100):
        growth = np.log1p(0.5 * SIDE_M * growth / (finest_m * n))
    share = np.arange(-n, n + 1) / n
    line = np.sign(share) * finest_m * n / growth * np.expm1(growth * np.abs(share))
    x, y = np.meshgrid(line, line, indexing="ij")
    post_m = np.maximum(np.gradient(line)[:, None], np.gradient(line)[None])
    height = 0.25 * post_m * rng.uniform(-1.0, 1.0, x.shape)
    height[n, n] = 0.0
    corner = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (each.ravel() for each in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    return (np.stack([x, y, height], axis=-1).reshape(-1, 3) + SPOT_M,
            np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))


def at(height_m, down_deg):
    """The state of a camera above the spot that looks along x, so far below the horizon."""
    down = np.radians(down_deg)
    place = SPOT_M + height_m * np.array([0.3, -0.2, 1.0])
    q = frames.look_at(place, place + [np.cos(down), 0.0, -np.sin(down)], (0.0, 0.0, 1.0))
    return State(r_sun_inertial_m=AU_M * TO_SUN, spacecraft=Pose(r_inertial_m=place, q_from_inertial=q),
                 bodies={"ground": Pose(r_inertial_m=np.zeros(3))})


def in_full(n, place, facet, distance_m):
    every, far_m = np.full(n, -1), np.full(n, np.inf)
    every[place], far_m[place] = facet, distance_m
    return every, far_m


@pytest.mark.parametrize("height_m, focal_length_px, finest_m, is_float64", [
    (2.0, 500.0, 0.004, False), (0.05, 500.0, 0.004, False), (30.0, 2000.0, 0.004, False), (0.05, 500.0, 100.0, True)])
def test_rays_near_the_ground_are_those_of_float64(height_m, focal_length_px, finest_m, is_float64):
    """First hits, shadows and lines to the camera from anywhere, of ground with posts of 4 mm: one ray in 2000 differs.

    Below the last camera facets are too long for float32.
    """
    vertices, facets = rough_ground(finest_m)
    mesh, exact = RayMesh(vertices, facets), ExactMesh(vertices, facets)
    place = SPOT_M + [0.0, 0.0, height_m]
    near = NearMesh(mesh, place, 1e-5 * mesh.radius_m * focal_length_px, focal_length_px)
    assert (near._exact is not None) == is_float64
    rng, n = np.random.default_rng(7), 8_000
    ray = rng.normal(size=(3, n)) * [[1.0], [1.0], [0.3]]
    ray /= np.linalg.norm(ray, axis=0)
    hits, asked = near.first(place, ray), exact.first(place.reshape(3, 1), ray)
    (facet, range_m), (true, true_m) = in_full(n, hits.place, hits.facet, hits.distance_m), in_full(n, *asked)
    assert (facet != true).mean() < 5e-4
    same = (facet == true) & (facet >= 0)
    assert same.sum() > 0.3 * n
    np.testing.assert_allclose(range_m[same], true_m[same], rtol=1e-9)
    # Shadows of what the camera sees.
    point = place[:, None] + hits.ray * hits.distance_m
    lit = np.flatnonzero(((hits.normal * TO_SUN[:, None]).sum(axis=0) > 0.05)
                         & ((hits.normal * hits.ray).sum(axis=0) < 0.0))
    point, normal, number = point[:, lit], hits.normal[:, lit], hits.facet[lit]
    start = near.raised(point, number, normal, LEAST_LIFT)
    true = exact.are_blocked(start, TO_SUN.reshape(3, 1), np.array([np.inf]))
    assert (near.blocks(start.T, TO_SUN) != true).mean() < 5e-4
    sunward = np.ascontiguousarray(np.broadcast_to(TO_SUN[:, None], start.shape))
    hits, asked = near.first(start, sunward), exact.first(start, sunward)
    assert (in_full(len(lit), hits.place, hits.facet, 0.0)[0] != in_full(len(lit), *asked)[0]).mean() < 5e-4
    # From points of all facets to the camera.
    number, share = rng.integers(0, len(facets), n), rng.dirichlet((1.0, 1.0, 1.0), n)
    point, normal = np.einsum("ijk,ij->ki", vertices[facets[number]], share), mesh.normals[number].T
    start = point + near.lift_m(point, number, LIFT) * normal
    towards = place[:, None] - start
    reach_m = np.linalg.norm(towards, axis=0)
    towards /= reach_m
    faces = (normal * towards).sum(axis=0) > 0.05
    true = exact.are_blocked(start, towards, reach_m)
    assert (near.blocks(start.T, towards.T, reach_m) != true)[faces].mean() < 5e-4


def test_coordinates_about_the_middle_would_not_do():
    """The ground of these tests is finer than float32 about its middle: there a hundredth of the hits are of others."""
    vertices, facets = rough_ground(0.004)
    mesh, exact, place = RayMesh(vertices, facets), ExactMesh(vertices, facets), SPOT_M + [0.0, 0.0, 0.05]
    ray = np.random.default_rng(7).normal(size=(3, 8_000)) * [[1.0], [1.0], [0.3]]
    ray /= np.linalg.norm(ray, axis=0)
    hits = mesh.first(place, ray)
    found = in_full(ray.shape[1], hits.place, hits.facet, hits.distance_m)[0]
    asked = in_full(ray.shape[1], *exact.first(place.reshape(3, 1), ray))[0]
    assert (found != asked).mean() > 0.01


@pytest.mark.parametrize("height_m, down_deg", [(300.0, 60.0), (2.0, 25.0), (0.1, 10.0)])
def test_frames_near_the_ground_are_those_of_other_rays(height_m, down_deg):
    """Ground of 20 km from 300 m to 0.1 m, by the tests' own rays about the camera: 0.5 % of pixels may differ."""
    vertices, facets = rough_ground(0.004)
    shape = Shape.from_arrays(vertices, facets)
    camera, state = views.camera(64, FOCAL_LENGTH_PX), at(height_m, down_deg)
    with RayTracer(views.scene([Body(name="ground", shape=shape, brdf=GREY)], [camera], sun_disc=False)) as tracer:
        image = tracer.render(state, samples=3, products=["facet_id", "range"])
    truth, facet, range_m = raytracer.trace([("ground", shape.vertices_m, shape.facets, GREY)], camera, state,
                                            views.SOLAR_IRRADIANCE_W_M2, 3)
    assert (image.products["facet_id"] != facet).mean() < 2e-3
    same = (image.products["facet_id"] == facet) & (facet >= 0)
    assert same.mean() > 0.5
    np.testing.assert_allclose(image.products["range"][same], range_m[same], rtol=1e-9)
    assert (np.abs(image.irradiance_W_m2 - truth) > 1e-5 * truth.max()).mean() < 5e-3


def test_few_facets_are_prepared_for_a_frame():
    """Two metres above 39,000 facets of 20 km a frame needs those within 70 m, and none where it sees coarser pixels.

    A camera that stays where it was finds them prepared.
    """
    vertices, facets = rough_ground(0.5)
    shape = Shape.from_arrays(vertices, facets)
    engine = RayEngine(views.scene([Body(name="ground", shape=shape, brdf=GREY)], [views.camera(64, FOCAL_LENGTH_PX)]))
    for height_m, expected in ((2.0, True), (2.0, True), (3000.0, False)):
        (view,) = view_bodies(at(height_m, 30.0), engine.scene.cameras[0], engine.scene.hulls)
        mesh = engine._mesh(view)
        assert isinstance(mesh, NearMesh) is expected
        assert mesh is engine._mesh(view)
        if expected:
            reach_m = 1.5 * 3e-5 * FOCAL_LENGTH_PX * mesh.radius_m
            middle_m = shape.vertices_m[shape.facets[mesh._number]].mean(axis=1) - view.r_camera_body_m
            assert 0 < len(mesh._number) < 0.4 * len(facets)
            assert np.median(np.linalg.norm(middle_m, axis=1)) < reach_m


@pytest.mark.parametrize("options", [{}, {"engine": "rays"}])
def test_what_is_sunlit_is_what_the_image_shows_lit(options):
    """A block of 1 m on a plain of 4 km, from 3 m: its shadow by slabs, which a shadow map is too coarse for."""
    plain_m = 0.1 * SIDE_M * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    low_m, high_m = np.array([4.0, -0.5, 0.0]), np.array([4.3, 0.5, 1.0])
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
                      [1, 5, 7], [1, 7, 3]])
    shape = Shape.from_arrays(np.concatenate([plain_m, low_m + corner * (high_m - low_m) - [0.0, 0.0, 1e-3]]),
                              np.concatenate([[[0, 1, 2], [0, 2, 3]], sides + 4]))
    camera = PinholeCamera(name="navcam", width_px=64, height_px=64, focal_length_px=64.0)
    eye_m = np.array([0.0, 0.0, 3.0])
    state = State(r_sun_inertial_m=AU_M * TO_SUN, bodies={"plain": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=eye_m, q_from_inertial=frames.look_at(eye_m, np.array([3.5, 0.5, 0.0]))))
    scene = Scene(bodies=[Body(name="plain", shape=shape, brdf=GREY)], cameras=[camera], sun_disc=False)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.02, products=("range", "sunlit"), **options)
    assert {window.engine for window in image.plan.windows} == {"rays"}
    y, x = np.mgrid[:64, :64]
    towards = camera.directions(np.stack([x.ravel(), y.ravel()], axis=1).astype(float))
    towards = towards @ frames.dcm(state.spacecraft.q_from_inertial)
    point_m = eye_m + image.products["range"].reshape(-1, 1) * towards
    on_plain = np.abs(point_m[:, 2]) < 1e-3
    to_slabs = np.sort(np.stack([(low_m - point_m) / TO_SUN, (high_m - point_m) / TO_SUN]), axis=0)
    is_shaded = to_slabs[0].max(axis=1) < to_slabs[1].min(axis=1)
    sunlit = image.products["sunlit"].ravel() > 0.5
    assert (on_plain & is_shaded).sum() > 40
    assert (sunlit == ~is_shaded)[on_plain].mean() > 0.999
