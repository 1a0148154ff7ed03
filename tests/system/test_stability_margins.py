"""Ratios of 1 to 1e8: near planes, offsets of rays, tolerances of edges and coordinates far from an origin hold.

Truths: closed forms, and float64 rays against every facet (`sweeps.traced_by_hand`). RESULTS.md has the table.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import solids
import sweeps
import views
from cells import slow_but
from glrender import Body, ConfigError, Pose, Renderer, Shape, State, frames, generate, laser_ranges
from glrender.base.constants import AU_M
from glrender.emission.layers import Layers
from glrender.engines.rays.backend import RayTracer
from glrender.engines.rays.exact_rays import ExactMesh
from glrender.engines.rays.mesh import RayMesh
from glrender.engines.rays.near_mesh import NearMesh
from glrender.scene.shape.convex_hull import Hull
from glrender.view.view import view_bodies
from glrender_cli.subject import default_state
from missing import needed_module

RATIOS = [10.0**k for k in range(1, 9)]


def _body(shape, name="body"):
    return Body(name=name, shape=shape, brdf=sweeps.GREY)


def _told(image, truth, budget):
    """The error of an image: no more than is told, and the budget met or a warning given."""
    rms = views.relative_rms(image.irradiance_W_m2, truth)
    assert rms <= image.plan.predicted_error + 0.002
    assert image.plan.predicted_error <= budget or image.plan.warnings
    return rms


@pytest.fixture(scope="module")
def pillar():
    """The truth: what the image shows is the same however far the ground goes on."""
    camera = views.camera(40, 60.0)
    scene = views.scene([_body(sweeps.pillar_on_ground(100.0))], [camera], sun_disc=False)
    return camera, sweeps.traced_by_hand(scene.bodies, camera, sweeps.before_the_pillar(), samples=8)


@pytest.mark.parametrize("ratio", slow_but(RATIOS, 0, 3, 7))
def test_a_pillar_shades_ground_however_large(pillar, ratio):
    """Hulls take the slab for convex from 1e3 on, by its volume; float32 coordinates lose the pillar at 1e7."""
    needed_module("embreex", "pip install embreex")
    camera, truth = pillar
    scene = views.scene([_body(sweeps.pillar_on_ground(max(ratio, 20.0)))], [camera], sun_disc=False)
    with Renderer(scene) as renderer:
        image = renderer.render(sweeps.before_the_pillar(), max_error=0.02)
    assert _told(image, truth, 0.02) < 0.02
    assert image.plan.predicted_error <= 0.02
    np.testing.assert_allclose(image.irradiance_W_m2.sum(dtype=float), truth.sum(), rtol=0.002)
    with RayTracer(scene) as tracer:
        traced = tracer.render(sweeps.before_the_pillar(), samples=8).irradiance_W_m2
    assert views.relative_rms(traced, truth) < 0.003


@pytest.mark.parametrize("ratio", [1e3, 1e5, 1e7])
def test_opengl_alone_tells_that_its_map_is_too_coarse(pillar, ratio):
    camera, truth = pillar
    with Renderer(views.scene([_body(sweeps.pillar_on_ground(ratio))], [camera], sun_disc=False)) as renderer:
        image = renderer.render(sweeps.before_the_pillar(), max_error=0.02, engine="raster")
    assert _told(image, truth, 0.02) > 0.02


@pytest.mark.parametrize("offset", slow_but([0.0, *RATIOS], 0, 3, 8))
def test_coordinates_far_from_their_origin_cost_nothing(pillar, offset):
    """A patch of terrain in the coordinates of its planet: by each engine as if it were about its own middle."""
    camera, _ = pillar
    shape = sweeps.pillar_on_ground(20.0)
    # Exact in float64: no rounding of the shape itself.
    shift = np.rint(20.0 * offset * np.array([0.6, 0.64, 0.48]))
    moved = Shape.from_arrays(shape.vertices_m + shift, shape.facets)
    here = sweeps.before_the_pillar()
    there = replace(here, bodies={"body": Pose(r_inertial_m=-shift)})
    images, products = [], []
    for each, state in ((shape, here), (moved, there)):
        scene = views.scene([_body(each)], [camera], sun_disc=False)
        with Renderer(scene) as renderer:
            images.append([renderer.render(state, samples=4).irradiance_W_m2,
                           renderer.render(state, max_error=0.02).irradiance_W_m2])
            products.append(renderer.render(state, products=["range", "r_body"]).products)
        with RayTracer(scene) as tracer:
            images[-1].append(tracer.render(state, samples=4).irradiance_W_m2)
        ranges = laser_ranges(scene, state, camera.directions(np.mgrid[0:40:7, 0:40:7].reshape(2, -1).T))
        products[-1]["laser"] = ranges.range_m
    for one, other in zip(*images, strict=True):
        # Edges of shadows may fall to the other side of a sample.
        assert views.relative_rms(other, one) < 0.01
    np.testing.assert_allclose(products[1]["laser"], products[0]["laser"], rtol=1e-12, atol=4e-16 * np.abs(shift).max())
    np.testing.assert_allclose(products[1]["range"], products[0]["range"], rtol=1e-6, atol=4e-16 * np.abs(shift).max())
    np.testing.assert_allclose(products[1]["r_body"], products[0]["r_body"] + shift, rtol=1e-6)


def test_the_view_that_no_state_is_given_for_shows_what_is_far_from_its_origin():
    shape = sweeps.pillar_on_ground(20.0)
    scene = views.scene([_body(Shape.from_arrays(shape.vertices_m + [1e6, 0.0, 0.0], shape.facets))], [views.camera()])
    view, = view_bodies(default_state(scene, "navcam", 0.5), scene.cameras[0], scene.hulls)
    assert view.is_whole and 60.0 < view.size_px < 200.0


def test_a_coma_about_an_origin_beside_the_shape_is_refused():
    with pytest.raises(ConfigError, match="shape: must be around the origin of the body that has a coma"):
        Layers([], Shape.from_arrays(generate.icosphere(subdivisions=1, radius_m=1.0).vertices_m + 10.0,
                                     generate.icosphere(subdivisions=1, radius_m=1.0).facets))


def test_the_sun_and_the_phase_are_those_of_the_shape_not_of_its_far_origin():
    """A plate a hundredth of an au from its body's origin: the light on it, in closed form."""
    vertices, facets = solids.box((-50.0, -50.0, -10.0), (50.0, 50.0, 0.0))
    shift = np.array([0.0, 0.0, 0.01 * AU_M])
    camera, range_m = views.camera(16, 16 / 100.0 * 1e5 * 4.0), 1e5
    state = State(r_sun_inertial_m=[0.8 * AU_M, 0.0, 0.6 * AU_M], bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=shift + [0.0, 0.0, range_m], q_from_inertial=[0.0, 1.0, 0.0, 0.0]))
    with Renderer(views.scene([_body(Shape.from_arrays(vertices + shift, facets))], [camera])) as renderer:
        image = renderer.render(state, max_error=0.01)
    to_sun = np.array([0.8, 0.0, 0.59])
    expected = (sweeps.GREY.normal_albedo / np.pi * 0.59 / np.linalg.norm(to_sun) ** 3
                * views.SOLAR_IRRADIANCE_W_M2 / camera.focal_length_px**2)
    np.testing.assert_allclose(image.irradiance_W_m2[8, 8], expected, rtol=1e-5)


@pytest.mark.parametrize("height", [1e-2 * 10.0**-k for k in range(7)])
def test_a_facet_from_close_above_is_as_bright_as_it_is(height):
    """From 1e-2 to 1e-8 radii above a sphere's facet: radiance, range and incidence in closed form.

    By rays at 1e-8 the camera was under the ground: a wholly dark frame was told as exact.
    """
    needed_module("embreex", "pip install embreex")
    shape = generate.icosphere(radius_m=100.0, subdivisions=2)
    k = int(np.argmax(shape.facet_normals @ [0.5, 0.2, 0.84]))
    normal, middle = shape.facet_normals[k], shape.vertices_m[shape.facets[k]].mean(axis=0)
    aside = np.cross(normal, [0.0, 0.0, 1.0])
    height_m = 100.0 * height
    place = middle + height_m * normal
    sun = np.array([0.6, 0.3, 0.74]) / np.linalg.norm([0.6, 0.3, 0.74])
    state = State(r_sun_inertial_m=AU_M * sun, bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=place,
                                  q_from_inertial=frames.look_at(place, place - normal + 0.7 * aside)))
    camera = views.camera(32, 40.0)
    y, x = np.mgrid[:32, :32]
    rays = camera.directions(np.stack([x, y], axis=-1))
    truth = (sweeps.GREY.normal_albedo / np.pi * (normal @ sun) * views.SOLAR_IRRADIANCE_W_M2
             * rays[..., 2] ** 3 / camera.focal_length_px**2)
    down = -(rays @ frames.dcm(state.spacecraft.q_from_inertial)) @ normal
    scene = views.scene([_body(shape)], [camera])
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.02, products=["range", "facet_id", "incidence"])
        by_opengl = renderer.render(state, max_error=0.02, engine="raster")
    assert _told(image, truth, 0.02) < 1e-3
    assert image.plan.predicted_error <= 0.02
    _told(by_opengl, truth, 0.02)
    assert (image.products["facet_id"] == k).all()
    # Float64 places at 100 m are good to 1e-14 m.
    np.testing.assert_allclose(image.products["range"], height_m / down, rtol=1e-3 + 3e-14 / height_m)
    np.testing.assert_allclose(image.products["incidence"], np.arccos(normal @ sun), atol=1e-3)
    with RayTracer(scene) as tracer:
        np.testing.assert_allclose(tracer.render(state, samples=2).irradiance_W_m2, truth, rtol=2e-3)


@pytest.mark.parametrize("ratio", slow_but(RATIOS, 0, 3, 7))
def test_a_small_body_before_a_large_one(ratio):
    """A cube over a slab that is larger by a ratio: it hides it, shades it, and is not shaded by it."""
    needed_module("embreex", "pip install embreex")
    camera = views.camera(40, 60.0)
    large = max(ratio, 20.0)
    bodies = [_body(solids.several(((-0.5, -0.5, 0.2), (0.5, 0.5, 1.2))), "small"),
              _body(solids.several(((-large, -large, -0.3 * large), (large, large, 0.0))), "large")]
    state = sweeps.before_the_pillar(names=("small", "large"))
    truth = sweeps.traced_by_hand(bodies, camera, state, samples=8)
    scene = views.scene(bodies, [camera], sun_disc=False)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.02)
    assert _told(image, truth, 0.02) < 0.02
    with RayTracer(scene) as tracer:
        assert views.relative_rms(tracer.render(state, samples=8).irradiance_W_m2, truth) < 0.003


@pytest.mark.parametrize("range_radii", [3.0 * 10.0**k for k in range(1, 10)])
def test_rays_from_far_off_do_not_shade_what_they_meet(range_radii):
    """A sphere's flux as the sum over its facets; at 3e9 radii a fourth of it was in its own shadow."""
    needed_module("embreex", "pip install embreex")
    body = views.sphere(sweeps.GREY, 4)
    state = views.state(phase_deg=60.0, range_m=100.0 * range_radii)
    scene = views.scene([body], [views.camera(64, 28.0 * range_radii)], sun_disc=False)
    with RayTracer(scene) as tracer:
        light = sweeps.flux(tracer.render(state, samples=8))
    np.testing.assert_allclose(light, sweeps.facet_flux(body.shape, state), rtol=2e-3)


@pytest.mark.parametrize("solid", ["tetrahedron", "box", "icosphere"])
@pytest.mark.parametrize("range_m", [2.0 * 10.0**k for k in range(10)])
def test_a_laser_does_not_slip_between_facets(solid, range_m, rng):
    """Aimed at corners and edges that face it, the range is theirs: not the far wall's, nor none.

    From 1e3 sides away on some went through, when edges were held to 1e-12 of them.
    """
    vertices, facets = {
        "tetrahedron": (np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]),
                        np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])),
        "box": solids.box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        "icosphere": (lambda shape: (shape.vertices_m, shape.facets))(generate.icosphere(radius_m=1.0, subdivisions=2)),
    }[solid]
    for _ in range(3):
        place = rng.normal(size=3)
        seen = vertices - range_m * place / np.linalg.norm(place)
        corner = seen[facets]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        tilt = -np.einsum("ij,ij->i", normal, corner[:, 0]) / np.linalg.norm(corner[:, 0], axis=1)
        corner = corner[tilt > 0.05]
        share = rng.uniform(0.0, 1.0, (len(corner), 1))
        targets = np.concatenate([corner.reshape(-1, 3), *(
            share * corner[:, k] + (1.0 - share) * corner[:, (k + 1) % 3] for k in range(3))])
        expected = np.linalg.norm(targets, axis=1)
        _, distance = ExactMesh(seen, facets).hit(np.zeros(3), targets / expected[:, None])
        # The bound is the rounding of the camera's place over the least cosine.
        np.testing.assert_allclose(distance, expected, rtol=0.0, atol=1e-13 + 400.0 * np.finfo(float).eps * range_m)


@pytest.mark.parametrize("ratio", RATIOS)
def test_a_laser_meets_a_mast_before_a_far_wall(ratio):
    """Two bodies: at the edges of a box of 1 m, before a wall as many times as large and as far behind."""
    bodies = [_body(solids.several(((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))), "mast"),
              _body(solids.several(((-2 * ratio, -2 * ratio, ratio), (2 * ratio, 2 * ratio, 2 * ratio))), "wall")]
    state = State(r_sun_inertial_m=[0.0, 0.0, -AU_M], spacecraft=Pose(r_inertial_m=[0.0, 0.0, -20.0]),
                  bodies={name: Pose(r_inertial_m=np.zeros(3)) for name in ("mast", "wall")})
    corner = [[x, y, 19.5] for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.0, 0.5)]
    beside = [[x, 0.3, 19.5] for x in (-0.5 - 1e-9, 0.5 + 1e-9)]
    targets = np.array([*corner, *beside])
    found = laser_ranges(views.scene(bodies, [views.camera()]), state,
                         targets / np.linalg.norm(targets, axis=1, keepdims=True))
    assert found.body_id.tolist() == [0] * 9 + [1] * 2
    np.testing.assert_allclose(found.range_m[:9], np.linalg.norm(targets[:9], axis=1), rtol=1e-14)
    depth = ratio + 20.0
    np.testing.assert_allclose(found.range_m[9:], np.linalg.norm(targets[9:], axis=1) * depth / 19.5, rtol=1e-14)


@pytest.mark.parametrize("aspect", RATIOS[:5])
def test_long_thin_facets_hide_nothing_of_themselves(aspect):
    """A bar, from 4 of its widths: a warning, a refusal, or what rays in float64 see."""
    width = 100.0 / aspect
    body = _body(solids.several(((-50.0, -0.5 * width, -0.5 * width), (50.0, 0.5 * width, 0.5 * width))))
    place = np.array([3.0, -4.0 * width, 2.5 * width])
    state = State(r_sun_inertial_m=AU_M * np.array([0.3, -0.6, 0.74]), bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=place,
                                  q_from_inertial=frames.look_at(place, [3.0, 0.0, 0.0], (0.3, 0.2, 1.0))))
    camera = views.camera(40, 120.0)
    truth = sweeps.traced_by_hand([body], camera, state, samples=8)
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        image = renderer.render(state, max_error=0.02)
    assert _told(image, truth, 0.02) < 0.02


@pytest.mark.parametrize("side", [1e-1, 1e-3, 1e-5, 1e-8])
def test_a_body_with_a_boulder_is_not_convex(side):
    """By its volume and its area it would be from 1e-3 radii on; and no facet of the boulder is lost."""
    sphere = generate.icosphere(radius_m=1.0, subdivisions=3)
    vertices, facets = solids.box((-0.5, -0.5, -0.3), (0.5, 0.5, 1.0))
    place = sphere.vertices_m[sphere.facets[7]].mean(axis=0)
    shape = Shape.from_arrays(*solids.joined((sphere.vertices_m, sphere.facets), (side * vertices + place, facets)))
    assert len(shape.facets) == len(sphere.facets) + 12
    assert not Hull(shape.vertices_m, shape.facets).is_convex


@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6])
def test_a_body_with_a_dent_is_not_convex(depth):
    """A dent as wide as it is deep in one facet of a sphere."""
    sphere = generate.icosphere(radius_m=1.0, subdivisions=3)
    a, b, c = sphere.vertices_m[sphere.facets[7]]
    middle = (a + b + c) / 3.0
    ring = middle + depth * (np.array([a, b, c]) - middle) / np.linalg.norm(a - middle)
    n = len(sphere.vertices_m)
    corner = [*sphere.facets[7], n, n + 1, n + 2]
    around = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5], [3, 4, 6], [4, 5, 6], [5, 3, 6]]
    facets = np.concatenate([np.delete(sphere.facets, 7, axis=0), np.array([*corner, n + 3])[around]])
    vertices = np.concatenate([sphere.vertices_m, ring, [middle * (1.0 - depth)]])
    assert not Hull(vertices, facets).is_convex
    vertices[-1] = middle
    assert Hull(vertices, facets).is_convex


def test_the_digits_of_a_file_make_no_dent():
    for subdivisions in (3, 5):
        sphere = generate.icosphere(radius_m=1.0, subdivisions=subdivisions)
        assert Hull(np.round(sphere.vertices_m, 6), sphere.facets).is_convex


@pytest.mark.parametrize("above", [1e-1, 1e-3, 1e-6, 1e-9, 0.0, -1e-6])
def test_the_distance_close_to_the_hull_is_that_of_the_surface(above):
    """Between two boxes whose hull is a box: the near plane was as near as the hull, and OpenGL's depths ran out."""
    shape = solids.several(((-3.0, -1.0, -1.0), (-1.0, 1.0, 1.0)), ((1.0, -1.0, -1.0), (3.0, 1.0, 1.0)))
    hull = Hull(shape.vertices_m, shape.facets)
    place = np.array([0.0, 0.0, 1.0 + above])
    expected = math.hypot(1.0, above) if above > 0.0 else 1.0
    assert 0.9 * above <= hull.distance_m(place) <= expected * (1.0 + 1e-12)
    if above < 0.02:
        np.testing.assert_allclose(hull.distance_m(place), expected, rtol=1e-12)


def test_float64_rays_meet_what_float32_rays_meet(rng):
    """Where both can tell: the same facets of a rough body, and the same shadows."""
    needed_module("embreex", "pip install embreex")
    shape = generate.three_lobes(radius_m=100.0, subdivisions=4)
    mesh = RayMesh(shape.vertices_m, shape.facets)
    # All facets are near, and so near that they stay float64.
    fine = NearMesh(mesh, np.array([0.0, 0.0, 110.0]), 1e4, 1e9)
    start = rng.normal(size=(3, 2000))
    start *= 300.0 / np.linalg.norm(start, axis=0)
    aim = rng.uniform(-80.0, 80.0, (3, 2000)) - start
    aim /= np.linalg.norm(aim, axis=0)
    one, other = mesh.first(start, aim), fine.first(start, aim)
    np.testing.assert_array_equal(one.place, other.place)
    assert (one.facet == other.facet).mean() > 0.999
    np.testing.assert_allclose(one.distance_m, other.distance_m, rtol=1e-6)
    above = start.take(one.place, axis=1) + one.ray * one.distance_m + 1e-3 * one.normal
    to_sun = np.array([0.6, 0.0, 0.8])
    assert (mesh.blocks(above.T, to_sun) == fine.blocks(above.T, to_sun)).mean() > 0.999
    # Axis-parallel rays divide by nothing.
    along = fine.first(np.array([0.0, 0.0, 500.0]), np.array([[0.0], [0.0], [-1.0]]))
    assert len(along.place) == 1 and along.distance_m[0] < 500.0


def test_float64_rays_leave_no_gap(rng):
    """At corners and along edges of a sphere, from near and from 1e8 radii."""
    needed_module("embreex", "pip install embreex")
    shape = generate.icosphere(radius_m=1.0, subdivisions=3)
    mesh = RayMesh(shape.vertices_m, shape.facets)
    for range_m in (3.0, 1e4, 1e8):
        fine = NearMesh(mesh, np.array([0.36, -0.48, 0.8]) * range_m, 2.0 * range_m, 1e12)
        place = np.array([0.36, -0.48, 0.8]) * range_m
        corner = shape.vertices_m[shape.facets]
        share = rng.uniform(0.0, 1.0, (len(corner), 1))
        targets = np.concatenate([shape.vertices_m, share * corner[:, 0] + (1.0 - share) * corner[:, 1]])
        targets = targets[targets @ (place / range_m) > 0.4]
        away = targets - place
        expected = np.linalg.norm(away, axis=1)
        hits = fine.first(place, (away / expected[:, None]).T)
        assert len(hits.place) == len(targets)
        np.testing.assert_allclose(hits.distance_m, expected, rtol=0.0, atol=1e-13 + 1e-14 * range_m)


@pytest.mark.parametrize("radius_m", [1e-2, 1.0, 1e6, 1e8, 1e9])
def test_a_body_of_any_size_and_what_one_direction_to_the_sun_costs(radius_m):
    """Each facet has its own direction to the Sun and its own distance, which are told where they matter."""
    shape = generate.icosphere(radius_m=radius_m, subdivisions=4)
    state = views.state(phase_deg=70.0, range_m=20.0 * radius_m)
    with Renderer(views.scene([_body(shape)], [views.camera(64, 400.0)])) as renderer:
        image = renderer.render(state, max_error=0.01)
    centre = shape.vertices_m[shape.facets].mean(axis=1)
    away = state.r_sun_inertial_m - centre
    sun_m = np.linalg.norm(away, axis=1)
    camera = state.spacecraft.r_inertial_m - centre
    range_m = np.linalg.norm(camera, axis=1)
    mu0 = np.maximum(np.einsum("ij,ij->i", shape.facet_normals, away) / sun_m, 0.0)
    mu = np.maximum(np.einsum("ij,ij->i", shape.facet_normals, camera) / range_m, 0.0)
    expected = (mu0 * mu * shape.facet_areas_m2 / range_m**2 / (sun_m / AU_M) ** 2).sum()
    expected *= sweeps.GREY.normal_albedo / np.pi * views.SOLAR_IRRADIANCE_W_M2
    error = abs(sweeps.flux(image) / expected - 1.0)
    assert error < 0.001 + image.plan.predicted_error
    assert radius_m < 1e8 or image.plan.predicted_error > radius_m / AU_M
