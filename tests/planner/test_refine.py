"""Samples where they matter: the error that an image tells of itself, and the pixels drawn again."""

from __future__ import annotations

import numpy as np
import pytest
import views
from backends import backend_or_skip
from cells import slow_but
from glrender import Body, Pose, Renderer, Shape, State
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.engines.rays.backend import RayTracer
from glrender.planner.adaptive_samples import (
    aligned_errors,
    frame_error,
    pixel_errors,
    plan_refinement,
)

GREY = Lambert(normal_albedo=0.4)


def edge_image(size, samples, slope=0.3, offset=0.37):
    """Half a plane of ones: sampled, and its exact pixel means."""
    fine = 64
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine
    exact = (y < offset * size + slope * x).astype(np.float64).reshape(size, fine, size, fine).mean(axis=(1, 3))
    y, x = (np.mgrid[: size * samples, : size * samples] + 0.5) / samples
    return (y < offset * size + slope * x).astype(np.float32), exact


@pytest.mark.parametrize("samples", [1, 2, 4])
def test_an_edge_tells_its_error(samples):
    """RMS over the image within 40 % of what an exact area integral says, at any count of samples."""
    stated, true = 0.0, 0.0
    for slope in (0.1, 0.3, 0.7, 0.9):
        image, exact = edge_image(48, samples, slope)
        mean, error = pixel_errors(image, samples)
        stated += np.square(error, dtype=np.float64).sum()
        true += np.square(mean - exact).sum()
    assert 0.6 < np.sqrt(stated / true) < 1.6


@pytest.mark.parametrize("samples", [2, 4, 8])
@pytest.mark.parametrize("is_column", [False, True])
def test_an_edge_along_samples_errs_as_one_over_their_number(samples, is_column):
    """RMS over half planes at all places in a pixel, in closed form. Tilted edges and noise have none."""
    stated, true, rows = 0.0, 0.0, np.arange(24.0)
    for place in 12.0 + np.arange(0.02, 1.0, 0.04):
        down = np.repeat(((np.arange(24 * samples) + 0.5) / samples < place)[:, None], 24 * samples, axis=1)
        mean, _ = pixel_errors(np.ascontiguousarray(down.T if is_column else down, np.float32), samples)
        error = aligned_errors(mean, samples)
        assert not np.delete(error, np.s_[10:15], axis=is_column).any()
        stated += np.square(error, dtype=np.float64).sum()
        true += np.square((mean.T if is_column else mean) - np.clip(place - rows, 0.0, 1.0)[:, None]).sum()
    assert 0.9 < np.sqrt(stated / true) < 1.2
    # At the image's own edges runs are cut short.
    inside = np.s_[4:-4, 4:-4]
    for slope in (0.3, 0.7, -1.0):
        y, x = (np.mgrid[: 24 * samples, : 24 * samples] + 0.5) / samples
        mean, _ = pixel_errors((y < 12.0 + slope * (x - 12.0)).astype(np.float32), samples)
        assert not aligned_errors(mean, samples)[inside].any()
    noise, _ = pixel_errors(np.random.default_rng(2).random((48 * samples,) * 2, np.float32), samples)
    assert (aligned_errors(noise, samples) > 0.0).mean() < 0.02
    assert not aligned_errors(np.zeros((4, 4), np.float32), samples).any()


def test_more_samples_leave_more_of_an_edge_along_them():
    """Of 8 times as many a side, 8^-2 of the squared error at an edge along them, 8^-3 at others."""
    image, _ = edge_image(48, 2, 0.0)
    mean, _ = pixel_errors(image, 2)
    error, left = aligned_errors(mean, 2), {}
    for is_aligned in (error < 0.0, error > 0.0):
        made = plan_refinement(mean, error, 2, 1e-9, is_aligned=is_aligned)
        left[bool(is_aligned.any())] = made.predicted_error / plan_refinement(mean, error, 2, 1e-9).predicted_error
    assert made.samples == 16 and left == {False: 1.0, True: pytest.approx(8.0**0.5)}


def test_shadows_along_the_image_rows_err_as_predicted():
    """Bars out of view throw them on a plate that fills the image: closed form, at 12 places in a pixel."""
    slab = np.array([[-200.0, -1.0, 0.0], [200.0, -1.0, 0.0], [200.0, 1.0, 0.0], [-200.0, 1.0, 0.0]])
    middles_m, halves_m = np.array([-90.0, -80.0, -70.0]), np.array([2.2, 3.1, 1.4])
    bars = [slab * [1.0, half, 1.0] + [0.0, y, -100.0] for y, half in zip(middles_m, halves_m, strict=True)]
    facets = np.vstack([np.array([[0, 2, 1], [0, 3, 2]]) + 4 * k for k in range(4)])
    body = Body(name="body", shape=Shape.from_arrays(np.vstack([slab * [1.0, 200.0, 1.0], *bars]), facets), brdf=GREY)
    scene = views.scene([body], [views.camera(40, 1000.0)], sun_disc=False)
    ratios, rows = [], np.arange(40)[:, None]
    with Renderer(scene) as renderer:
        for place in np.arange(0.04, 1.0, 1.0 / 12.0):
            camera = Pose(r_inertial_m=np.array([0.0, place, -1000.0]))
            state = State(r_sun_inertial_m=AU_M * np.array([0.0, -0.6, -0.8]), spacecraft=camera,
                          bodies={"body": Pose(r_inertial_m=np.zeros(3))})
            image = renderer.render(state, max_error=0.01, engine="rays")
            # The Sun's 3 in 4 across 100 m; 1 m is 1 px.
            low, high = (middles_m + 75.0 + 19.5 - place + side * halves_m for side in (-1.0, 1.0))
            dark = np.clip(np.minimum(rows + 0.5, high) - np.maximum(rows - 0.5, low), 0.0, 1.0).sum(axis=1)
            exact = np.repeat(1.0 - dark[:, None], 40, axis=1)
            error = image.irradiance_W_m2 / image.irradiance_W_m2.max() - exact
            ratios.append(frame_error(exact, error) / image.plan.predicted_error)
    # An edge errs by the root of 3 of its RMS error at most.
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.25 and np.max(ratios) < np.sqrt(3.0), ratios


def test_the_edge_of_a_dark_side_is_an_edge():
    """A body that ends at its window's border, and one that goes on beyond the frame."""
    even = np.ones((8, 8), np.float32)
    for samples in (1, 2):
        _, ends = pixel_errors(even, samples, dark_sides=(True, False, False, True))
        assert (ends[0] > 0.07).all() and (ends[:, -1] > 0.07).all()
        assert not ends[1:, :-1].any()


def test_an_even_image_has_no_error():
    mean, error = pixel_errors(np.full((12, 12), 3.0, np.float32), 3)
    np.testing.assert_allclose(mean, 3.0, rtol=1e-6)
    assert not error.any()
    assert frame_error(mean, error) == 0.0 and plan_refinement(mean, error, 3, 0.01) is None
    dark = np.zeros((4, 4), np.float32)
    assert frame_error(*pixel_errors(dark, 1)) == 0.0 and plan_refinement(*pixel_errors(dark, 1), 1, 0.01) is None


def test_only_the_edge_is_drawn_again():
    image, _ = edge_image(64, 1)
    mean, error = pixel_errors(image, 1)
    refinement = plan_refinement(mean, error, 1, 0.02)
    assert refinement.predicted_error <= 0.02 < frame_error(mean, error)
    assert 0.01 < refinement.share < 0.08, "64 pixels long, three wide, of 4096"
    contrast = np.abs(np.diff(image, axis=0))
    rows, columns = np.nonzero(contrast)
    assert refinement.mask[rows, columns].all() and refinement.mask[rows + 1, columns].all()


def test_a_tighter_budget_refines_more_and_an_impossible_one_the_most():
    rng = np.random.default_rng(1)
    mean, error = pixel_errors(rng.random((64, 64), np.float32), 1)
    efforts = []
    for budget in (0.2, 0.1, 0.05, 0.03):
        refinement = plan_refinement(mean, error, 1, budget)
        assert refinement.predicted_error <= budget
        efforts.append(refinement.share * refinement.samples**2)
    assert efforts == sorted(efforts)
    refinement = plan_refinement(mean, error, 1, 1e-5)
    assert refinement.samples == 16 and refinement.predicted_error > 1e-5


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
@pytest.mark.parametrize("phase_deg", slow_but([30.0, 90.0], 1))
def test_a_refined_frame_meets_its_budget_where_the_coarse_one_does_not(backend, phase_deg):
    """Against 8 x 8 rays a pixel; and pixels that were not drawn again are those of one sample."""
    body = Body(name="body", shape=views.binary(2), brdf=GREY)
    scene, state = views.scene([body], [views.camera(256, 2000.0)]), views.state(phase_deg=phase_deg)
    with Renderer(scene, backend_or_skip(backend)) as renderer, RayTracer(scene) as tracer:
        truth = tracer.render(state, samples=8).irradiance_W_m2.astype(np.float64)
        image, coarse = renderer.render(state, max_error=0.02), renderer.render(state, samples=1)
    window, = image.plan.windows
    error = lambda frame: np.sqrt(np.mean((frame - truth)[truth > 0] ** 2)) / truth[truth > 0].mean()  # noqa: E731
    assert error(image.irradiance_W_m2) <= image.plan.predicted_error <= 0.02
    assert error(coarse.irradiance_W_m2) > 0.03
    if window.refined_samples:
        assert 0.0 < window.refined_share < 0.6


def test_pixels_outside_the_mask_are_left_as_they_are():
    """A sphere's inside keeps its coarse samples, byte for byte; its limb changes."""
    scene, state = views.scene([views.sphere(GREY, 5)], [views.camera(640, 6000.0)]), views.state(phase_deg=30.0)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.004, engine="raster")
        window, = image.plan.windows
        coarse = renderer.render(state, samples=window.samples)
    assert window.refined_samples > window.samples
    changed = image.irradiance_W_m2 != coarse.irradiance_W_m2
    area = (window.roi[2] - window.roi[0]) * (window.roi[3] - window.roi[1])
    assert 0 < changed.sum() <= window.refined_share * area + 1
