"""Samples where they matter: the error that an image tells of itself, and the pixels drawn again."""

from __future__ import annotations

import numpy as np
import pytest
import views
from backends import backend_or_skip
from cells import slow_but
from glrender import Body, Renderer
from glrender.brdf import Lambert
from glrender.engines.rays.backend import RayTracer
from glrender.planner.adaptive_samples import frame_error, pixel_errors, plan_refinement

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
