"""The error that is predicted of a small body's own grid of samples, beside rays."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import views
from cells import slow_but
from glrender import Pose, Renderer, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.engines.small_bodies import add_by_area
from glrender.planner.error_model import BodyTraits
from glrender.planner.small_body_grid import SAMPLES_ACROSS, samples_across, sampling_errors
from glrender.scene.scene import Body
from glrender.view.regions import Group
from glrender.view.view import view_bodies
from missing import needed_module
from scipy.spatial.transform import Rotation

TRUTH_ACROSS, ACROSS, SIZES_PX = 1500, (64, 128, 256), (0.1, 0.7, 2.0, 5.0, 15.0)


def traits(n_facets, crease_rad):
    return BodyTraits(radius_m=100.0, is_convex=False, law="lambert", max_phase_rad=math.pi, n_facets=n_facets,
                      crease_rad=crease_rad)


SMOOTH, ROUGH = traits(80_000, math.radians(0.6)), traits(800_000, math.radians(18.0))


def small(size_px, phase_deg=60.0):
    return SimpleNamespace(size_px=size_px, phase_rad=math.radians(phase_deg))


def shapes():
    lumpy = views.binary(3, 5)
    return {"sphere": generate.icosphere(radius_m=100.0, subdivisions=5), "contact binary": lumpy,
            "rough": generate.subdivide_with_relief(lumpy, levels=2, relief=0.06, seed=1)}


class Samples:
    """Of a body that fills the image: what samples across it see, and the pixels of them at another size."""

    MARGIN = 0.02

    def __init__(self, engine, camera, views_):
        self._engine, self._camera, self._views = engine, camera, views_
        x0, y0, x1, y1 = views_[0].bounds_px
        self.longer_px = max(x1 - x0, y1 - y0)
        margin = self.MARGIN * self.longer_px
        self._low, self._high = np.array([x0, y0]) - margin, np.array([x1, y1]) + margin
        self._sides = self._high - self._low

    def samples(self, across):
        counts = np.ceil(across * self._sides / self.longer_px).astype(int)
        x, y = (low + (np.arange(n) + 0.5) * side / n
                for low, side, n in zip(self._low, self._sides, counts, strict=True))
        return self._engine.lattice(x, y, self._camera, self._views, len(x))

    def pixels(self, samples, scale, place):
        image = np.zeros((32, 32), np.float32)
        add_by_area(image, samples, (*place, *(place + scale * self._sides)))
        return image.astype(float)


@pytest.mark.parametrize("name", slow_but(["sphere", "contact binary", "rough"], 1))
def test_the_error_of_a_grid_holds_beside_rays(name):
    """Of ten attitudes, 10 to 130 deg, 0.1 to 15 px, 64 to 256 samples across: nine in ten, and not four times it."""
    needed_module("embreex", "pip install embreex")
    from glrender.engines.rays.engine import RayEngine

    shape, rng, told = shapes()[name], np.random.default_rng(7), []
    known = traits(len(shape.facets), shape.crease_rad)
    camera = views.camera(256, 1000.0)
    scene = views.scene([Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))], [camera], sun_disc=False)
    engine = RayEngine(scene)
    for phase_deg in np.linspace(10.0, 130.0, 10):
        q_body = rng.standard_normal(4)
        state = views.state(phase_deg, sun_in_image=rng.standard_normal(2), q_body=q_body / np.linalg.norm(q_body))
        seen = view_bodies(state, camera, scene.hulls)
        lattices = Samples(engine, camera, seen)
        truth, *coarse = (lattices.samples(across) for across in (TRUTH_ACROSS, *ACROSS))
        for size_px in SIZES_PX:
            scale, place = size_px / seen[0].size_px, 8.0 + rng.random(2)
            expected = lattices.pixels(truth, scale, place)
            told += [views.relative_rms(lattices.pixels(samples, scale, place), expected)
                     / sampling_errors(small(size_px, phase_deg), known, across)[1]
                     for across, samples in zip(ACROSS, coarse, strict=True)]
    assert np.mean(np.array(told) <= 1.0) >= 0.9
    assert 0.25 <= np.median(told) <= 1.0


@pytest.mark.parametrize("size_px, offset_m, gap_m, moon_m", slow_but([
    (3.0, 20.0, 12_000.0, 60.0), (3.0, 40.0, 12_000.0, 60.0), (3.0, 60.0, 12_000.0, 60.0), (0.1, 40.0, 12_000.0, 60.0),
    (0.5, 20.0, 12_000.0, 60.0), (3.0, 30.0, 1500.0, 60.0), (3.0, 40.0, 1500.0, 60.0)], 1, 3))
def test_the_flux_holds_in_another_body_s_penumbra(size_px, offset_m, gap_m, moon_m):
    """Each sample meets one point of the Sun's disc: noise. A moon sunward, beside 2000 x 1200 rays."""
    needed_module("embreex", "pip install embreex")
    from glrender.engines.rays.engine import RayEngine

    camera = views.camera(40, 10.0 * size_px)
    bodies = [Body(name=name, shape=shape, brdf=Lambert(normal_albedo=0.3)) for name, shape in (
        ("body", shapes()["contact binary"]), ("moon", generate.icosphere(radius_m=moon_m, subdivisions=3)))]
    scene = views.scene(bodies, [camera], sun_disc=True)
    state = views.state(phase_deg=70.0, bodies=("body", "moon"))
    sunward = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    state = replace(state, bodies={**state.bodies, "moon": Pose(r_inertial_m=gap_m * sunward + offset_m)})
    seen = view_bodies(state, camera, scene.hulls)
    x0, y0, x1, y1 = seen[0].bounds_px
    x, y = (low + (np.arange(n) + 0.5) * (high - low) / n for low, high, n in ((x0, x1, 2000), (y0, y1, 1200)))
    only = [replace(view, is_visible=view.name == "body") for view in seen]
    truth = RayEngine(scene).lattice(x, y, camera, only, 2000).mean() * (x1 - x0) * (y1 - y0)
    assert truth > 0.0
    with Renderer(scene) as renderer:
        for max_error in (0.05, 0.02, 0.01):
            image = renderer.render(state, max_error=max_error)
            error = abs(image.irradiance_W_m2.sum(dtype=float) / truth - 1.0)
            assert error <= min(image.plan.predicted_error, max(0.125 * max_error, 2e-3)), image.plan.windows


@pytest.mark.parametrize("seed", slow_but(range(4), 1))
@pytest.mark.parametrize("sizes_px", [(0.5, 3.5), (4.5, 14.0)])
def test_the_error_of_several_bodies_holds(sizes_px, seed):
    """Two to four, smooth and lumpy, bright and dark, within so many pixels: beside 1500 rays across all of them."""
    needed_module("embreex", "pip install embreex")
    from glrender.engines.rays.engine import RayEngine

    rng = np.random.default_rng(seed)
    names = [f"body{k}" for k in range(2 + seed % 3)]
    radii_m = [100.0, *rng.choice([100.0, 50.0, 20.0], len(names) - 1)]
    bodies = [Body(name=name, brdf=Lambert(normal_albedo=albedo), shape=(
        generate.icosphere(radius_m=radius_m, subdivisions=4) if is_smooth
        else generate.contact_binary(radius_m=radius_m, seed=3, subdivisions=5)))
        for name, radius_m, albedo, is_smooth in zip(names, radii_m, rng.choice([0.05, 0.3], len(names)),
                                                     rng.uniform(size=len(names)) < 0.5, strict=True)]
    # Along the image's diagonal, 30 m between them.
    state = views.state(rng.uniform(10.0, 120.0), range_m=1e6, bodies=names, sun_in_image=rng.standard_normal(2))
    right, down = frames.dcm(state.spacecraft.q_from_inertial)[:2]
    along_m = np.cumsum([0.0, *(a + b + 30.0 for a, b in zip(radii_m, radii_m[1:], strict=False))])
    state = replace(state, bodies={name: Pose(
        r_inertial_m=(place_m - along_m.mean()) * (right + rng.uniform(0.3, 1.0) * down) / 1.1,
        q_from_inertial=Rotation.random(random_state=rng).as_quat(scalar_first=True))
        for name, place_m in zip(names, along_m, strict=True)})
    camera = views.camera(24, 1e6 * rng.uniform(*sizes_px) / (along_m[-1] + 200.0))
    scene = views.scene(bodies, [camera], sun_disc=False)
    seen = view_bodies(state, camera, scene.hulls)
    x0, y0, x1, y1 = Group.of(seen, camera).outline
    x, y = (low + (np.arange(1500) + 0.5) * (high - low) / 1500 for low, high in ((x0, x1), (y0, y1)))
    truth = np.zeros((24, 24), np.float32)
    add_by_area(truth, RayEngine(scene).lattice(x, y, camera, seen, 1500), (x0, y0, x1, y1))
    with Renderer(scene) as renderer:
        for max_error in (0.05, 0.02):
            image = renderer.render(state, max_error=max_error)
            error = views.relative_rms(image.irradiance_W_m2.astype(float), truth.astype(float))
            assert error <= 1.1 * image.plan.predicted_error and error <= max_error
            assert abs(image.irradiance_W_m2.sum(dtype=float) / truth.sum(dtype=float) - 1.0) <= 0.1 * max_error


def test_rays_of_a_lattice_are_those_of_its_places():
    """More places than are taken at once: 1001 x 701, of which every thirteenth is cast alone."""
    needed_module("embreex", "pip install embreex")
    from glrender.engines.rays import engine as ray_engine

    camera = views.camera(32, 150.0)
    scene = views.scene([Body(name="body", shape=shapes()["sphere"], brdf=Lambert(normal_albedo=0.3))], [camera],
                        sun_disc=True)
    engine, seen = ray_engine.RayEngine(scene), view_bodies(views.state(100.0), camera, scene.hulls)
    x, y = np.linspace(5.0, 27.0, 1001), np.linspace(4.0, 26.0, 701)
    made = engine.lattice(x, y, camera, seen, 7)
    row, column = (axis.ravel()[::13] for axis in np.indices(made.shape))
    alone = engine.irradiance(np.stack([x[column], y[row]]).T, camera, seen, row % 7 * 7 + column % 7)
    np.testing.assert_array_equal(made.ravel()[::13], alone)


@pytest.mark.parametrize("known", [SMOOTH, ROUGH], ids=["smooth", "rough"])
@pytest.mark.parametrize("size_px", [0.01, 1.0, 30.0])
def test_the_fewest_samples_that_do_are_taken(known, size_px):
    view = small(size_px)
    for flux_error in (0.01, 0.001):
        across = samples_across(view, known, flux_error)
        assert sampling_errors(view, known, across)[0] <= flux_error or across == SAMPLES_ACROSS[-1]
        fewer = [n for n in SAMPLES_ACROSS if n < across]
        assert all(sampling_errors(view, known, n)[0] > flux_error for n in fewer)
    assert samples_across(view, known, 0.01) <= samples_across(view, known, 0.001)
    assert samples_across(view, known, 0.01, 1e-5) == SAMPLES_ACROSS[-1], "no grid has such pixels"


def test_below_a_pixel_a_body_errs_as_its_flux_does():
    """All of its light is in a pixel or two, whatever its size."""
    for known in (SMOOTH, ROUGH):
        flux, pixels = zip(*(sampling_errors(small(size_px), known, 100.0) for size_px in (0.001, 0.01, 0.1)),
                           strict=True)
        np.testing.assert_allclose(flux, flux[0])
        np.testing.assert_allclose(pixels, flux[0], rtol=0.05)


def test_rough_facets_smaller_than_samples_are_noise():
    """N^-1 beside N^-1.5; of 800,000 facets from 180 samples across on they are not smaller."""
    def flux(known, across):
        return sampling_errors(small(1.0), known, across)[0]

    assert flux(ROUGH, 50.0) == pytest.approx(2.0 * flux(ROUGH, 100.0), rel=0.1)
    assert flux(ROUGH, 50_000.0) == pytest.approx(2.0**1.5 * flux(ROUGH, 100_000.0), rel=0.03)
    assert flux(SMOOTH, 50.0) == pytest.approx(2.0**1.5 * flux(SMOOTH, 100.0), rel=0.1)
    assert flux(ROUGH, 100.0) > 2.0 * flux(SMOOTH, 100.0)


@pytest.mark.parametrize("size_px, axis, max_error", [(0.7, 0.35, 0.005), (1.0, 0.2, 0.05), (2.7, 0.35, 0.05)])
def test_an_elongated_body_of_few_pixels_has_its_light_where_it_is(size_px, axis, max_error):
    """An ellipsoid 1 : `axis`, turned by 0.5 rad: Lambert's law over 200 x 200 places a pixel.

    Its image and centre of brightness are those of the closed form but for its 20,480 facets.
    """
    needed_module("embreex", "pip install embreex")
    ball, turn, range_m = generate.icosphere(radius_m=100.0, subdivisions=5), Rotation.from_rotvec([0.0, 0.0, 0.5]), 1e6
    shape = Shape.from_arrays(turn.apply(ball.vertices_m * [1.0, axis, axis]), ball.facets)
    place_px, sun = np.array([0.31, -0.18]), np.array([0.6, 0.0, -0.8])
    camera = views.camera(6, size_px * range_m / 200.0)
    state = State(r_sun_inertial_m=1.5e11 * sun, bodies={"body": Pose(r_inertial_m=np.zeros(3))}, spacecraft=Pose(
        r_inertial_m=np.array([*(-place_px * 200.0 / size_px), -range_m])))
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))], [camera],
                              sun_disc=False)) as renderer:
        image = renderer.render(state, max_error=max_error)
    step = (np.arange(6 * 200) + 0.5) / 200.0 - 3.0
    x, y = (step - place_px[0]) * 2.0 / size_px, (step[:, None] - place_px[1]) * 2.0 / size_px
    u, v = x * np.cos(0.5) + y * np.sin(0.5), (y * np.cos(0.5) - x * np.sin(0.5)) / axis
    w = np.sqrt(np.maximum(1.0 - u * u - v * v, 0.0))
    # Outward normal of the near side, -w along the boresight: the gradient of the ellipsoid's equation.
    normal = turn.apply(np.stack([u, v / axis, -w / axis], axis=-1).reshape(-1, 3))
    cosine = (normal @ sun / np.linalg.norm(normal, axis=1)).reshape(w.shape)
    light = np.where(w > 0.0, np.maximum(cosine, 0.0), 0.0)
    truth = light.reshape(6, 200, 6, 200).mean(axis=(1, 3))
    truth *= views.SOLAR_IRRADIANCE_W_M2 * 0.3 / np.pi / camera.focal_length_px**2 * (AU_M / 1.5e11) ** 2
    assert image.plan.windows[0].target == "own_grid"
    assert views.relative_rms(image.irradiance_W_m2.astype(float), truth) <= max(image.plan.predicted_error, 0.005)
    found_px, expected_px = (views.centroid_px(each) for each in (image.irradiance_W_m2, truth))
    np.testing.assert_allclose(found_px, expected_px, atol=1e-3)
