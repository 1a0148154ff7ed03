"""Bodies in another's penumbra: their light as predicted and as asked for, beside the area that two discs share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from cells import slow_but
from glrender import Pose, Renderer
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.base.rotations import sun_from_body
from glrender.brdf import Lambert
from glrender.planner import eclipse_samples
from glrender.planner.adaptive_samples import pixel_means
from glrender.planner.penumbra import penumbra_of
from glrender.planner.request import MAX_SAMPLES
from glrender.view.occluders import casters
from glrender.view.view import view_bodies

LAW, RADIUS_M, RANGE_M = Lambert(normal_albedo=0.3), 100.0, 1e5


def hidden_share(radius, disc, apart):
    """Share of a disc that another one hides, one number at a time: sectors less triangles."""
    if apart >= radius + disc:
        return 0.0
    if apart <= abs(radius - disc):
        return min(radius / disc, 1.0) ** 2
    one = 2.0 * np.arccos((apart**2 + radius**2 - disc**2) / (2.0 * apart * radius))
    other = 2.0 * np.arccos((apart**2 + disc**2 - radius**2) / (2.0 * apart * disc))
    return 0.5 * (radius**2 * (one - np.sin(one)) + disc**2 * (other - np.sin(other))) / (np.pi * disc**2)


def light_left(to_sun, r_other_m, other_m, n=64):
    """Share of a Lambert sphere's light, seen from +Z far away, that another sphere leaves; the Sun has no y."""
    middle = (np.arange(n) + 0.5) / n
    first = max(np.arctan2(to_sun[0], to_sun[2]) - 0.5 * np.pi, -0.5 * np.pi)
    east, north = (each.ravel() for each in np.meshgrid(first + (0.5 * np.pi - first) * middle, np.pi * (middle - 0.5)))
    normal = np.stack([np.cos(north) * np.sin(east), np.sin(north), np.cos(north) * np.cos(east)], axis=-1)
    light = normal @ to_sun * normal[:, 2] * np.cos(north)
    to_other = r_other_m - RADIUS_M * normal
    range_m, cosine = np.linalg.norm(to_other, axis=1), to_other @ to_sun
    apart = np.arctan2(np.linalg.norm(np.cross(to_other, to_sun), axis=1), cosine)
    hidden = [hidden_share(np.arcsin(other_m / far), SUN_RADIUS_M / AU_M, angle)
              for far, angle in zip(range_m, apart, strict=True)]
    return float(light @ (1.0 - np.array(hidden)) / light.sum())


def eclipsed(away_m, aside_m, other_m, phase_deg, size_px):
    """A scene, its state, and the share of its light that a body of 100 m has left."""
    to_sun = np.array([np.sin(np.radians(phase_deg)), 0.0, np.cos(np.radians(phase_deg))])
    place = away_m * to_sun + aside_m * sun_from_body(to_sun)[1]
    bodies = [views.sphere(LAW, 5, RADIUS_M, "body"), views.sphere(LAW, 6, other_m, "other")]
    scene = views.scene(bodies, [views.camera(64, 0.5 * size_px * RANGE_M / RADIUS_M)])
    state = views.state(0.0, range_m=RANGE_M, bodies=("body", "other"))
    away = state.spacecraft.r_inertial_m / np.linalg.norm(state.spacecraft.r_inertial_m)
    turn = sun_from_body(away).T
    state = replace(state, r_sun_inertial_m=AU_M * turn @ to_sun, bodies={
        "body": state.bodies["body"], "other": Pose(r_inertial_m=turn @ place)})
    return scene, state, light_left(to_sun, place, other_m)


@pytest.mark.parametrize("asked", slow_but([0.02, {"flux": 0.01}, {"flux": 0.003}], 1))
@pytest.mark.parametrize("away_m, aside_m, other_m, phase_deg, size_px", [
    (12e3, 0.0, 100.0, 20.0, 40.0), (80e3, 40.0, 100.0, 20.0, 40.0), (9e3, 60.0, 130.0, 50.0, 24.0),
    (15e3, 0.0, 110.0, 15.0, 3.0), (30e3, 0.0, 90.0, 60.0, 0.4), (40e3, 120.0, 60.0, 30.0, 40.0)],
    ids=["deep", "slight", "aside", "few pixels", "less than a pixel", "annulus"])
def test_an_eclipse_s_light_is_as_predicted_and_as_asked(away_m, aside_m, other_m, phase_deg, size_px, asked):
    """Two samples a pixel that agree do not tell that all of the Sun's disc is free, or hidden."""
    scene, state, left = eclipsed(away_m, aside_m, other_m, phase_deg, size_px)
    assert 0.02 < left < 0.98
    alone = views.scene(scene.bodies[:1], scene.cameras)
    with Renderer(scene) as renderer, Renderer(alone) as free:
        image = renderer.render(state, max_error=asked)
        whole = free.render(replace(state, bodies={"body": state.bodies["body"]}), max_error=5e-4)
    found = [each.irradiance_W_m2.sum(dtype=float) for each in (image, whole)]
    error, predicted = abs(found[0] / found[1] / left - 1.0), image.plan.predicted["flux"]
    assert error <= predicted + 1e-3, (error, image.plan.windows)
    if isinstance(asked, dict):
        assert "flux" in image.plan.missed or error <= asked["flux"], (error, image.plan.windows)
        assert predicted < 10.0 * asked["flux"], "no more is promised than rays can keep, and no less"


@pytest.mark.parametrize("phase_deg", [150.0, 170.0, 177.3, 179.0, 179.9])
def test_the_light_that_is_left_of_a_crescent(phase_deg):
    """The planner's few points are all in what is lit, however narrow."""
    scene, state, left = eclipsed(9e3, 60.0, 130.0, phase_deg, 60.0)
    seen = view_bodies(state, scene.cameras[0], scene.hulls)
    sun_rad = SUN_RADIUS_M / AU_M
    found = penumbra_of(seen[0], casters(seen[0], seen, scene.hulls, sun_rad), scene.hulls, sun_rad)
    assert found.left == pytest.approx(left, abs=0.01) and found.hard_flux <= 1.0


@pytest.mark.parametrize("phase_deg", [177.3, 178.0, 179.6, 180.0])
def test_a_crescent_with_a_caster_is_drawn(phase_deg):
    """The light of a body behind whose limb the Sun is may be nothing; its prediction is a number."""
    scene, state, _ = eclipsed(1000.0, 20.0, 20.0, phase_deg, 60.0)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.02)
    assert np.isfinite(image.irradiance_W_m2).all() and np.isfinite(list(image.plan.predicted.values())).all()


@pytest.mark.parametrize("phase_deg, most", [(120.0, 0.01), (150.0, 0.05), (165.0, 0.3)])
def test_a_small_crescent_s_eclipse_is_predicted_by_its_samples(phase_deg, most):
    """The noise is that which the samples show: no law of full discs makes it more than all the light there is."""
    scene, state, left = eclipsed(30e3, 0.0, 90.0, phase_deg, 1.5)
    with Renderer(scene) as renderer, Renderer(views.scene(scene.bodies[:1], scene.cameras)) as free:
        image = renderer.render(state, max_error=0.02)
        whole = free.render(replace(state, bodies={"body": state.bodies["body"]}), max_error=5e-4)
    found = [each.irradiance_W_m2.sum(dtype=float) for each in (image, whole)]
    (window,), predicted = image.plan.windows, image.plan.predicted
    assert abs(found[0] / found[1] / left - 1.0) <= predicted["flux"] + 1e-3 < most
    assert predicted["centroid_px"] < 1.5 and window.predicted_error >= window.flux_error


def test_the_narrowest_crescent_s_eclipse_has_an_error():
    """Of a thousandth of the disc a third is dark, on a thousand samples across: some 3 %, and not 0."""
    scene, state, _ = eclipsed(30e3, 0.0, 90.0, 176.5, 1.5)
    with Renderer(scene) as renderer:
        windows = renderer.render(state, max_error=0.02).plan.windows
    assert 0.01 < next(window for window in windows if "body" in window.bodies).flux_error < 0.1


@pytest.mark.parametrize("left", [0.1, 0.7, 0.99])
def test_the_error_of_a_grid_s_total_is_that_of_independent_samples(left):
    """Of n lit samples with a share p left the total errs by the root of (1 - p) / (p n), the law by 1.5 times that."""
    rng = np.random.default_rng(7)
    bare = np.zeros((200, 200), np.float32)
    bare[:50] = 2.0
    found = eclipse_samples.grid_flux_error(bare * (rng.random(bare.shape) < left), bare)
    assert found == pytest.approx(1.5 * np.sqrt((1.0 - left) / left / 1e4), rel=0.1)


def test_a_grid_s_error_is_a_number_above_zero_wherever_it_has_light():
    """Too: less light without the eclipse than with it, by noise, and none at all."""
    bare = np.ones((40, 40), np.float32)
    for each in (bare, 0.9 * bare):
        assert 0.0 < eclipse_samples.grid_flux_error(bare, each) < 2e-3
    assert eclipse_samples.grid_flux_error(bare, 0.0 * bare) == 1.0
    assert eclipse_samples.grid_flux_error(0.0 * bare, bare) == eclipse_samples.grid_flux_error(0.0 * bare, 0.0 * bare)


def test_a_crescent_s_light_without_an_eclipse_is_of_the_same_grid():
    assert eclipse_samples.bare_samples(0.0, (1000, 900)) == (96, 96)
    assert eclipse_samples.bare_samples(np.radians(160.0), (1000, 900)) == (1000, 900)


@pytest.mark.parametrize("size_px, phase_deg, expected", [(0.01, 60.0, 1.0), (20.0, 0.0, 17.75), (20.0, 90.0, 12.57)])
def test_pixels_err_by_the_root_of_their_number_times_the_total_s_error(size_px, phase_deg, expected):
    found = eclipse_samples.grid_pixel_error(0.01, size_px, np.radians(phase_deg))
    assert found == pytest.approx(0.01 * expected, rel=1e-2)


def test_what_agrees_in_a_pixel_has_the_variance_of_those_around():
    """Of a share p of lit samples of brightness b the variance is p (1 - p) b^2, in dark pixels too; none beside."""
    rng, count, left = np.random.default_rng(5), 2, 0.1
    bare = np.zeros((80, 80), np.float32)
    bare[20:60, 20:60] = 3.0
    samples = bare * (rng.random(bare.shape) < left)
    variance, _ = eclipse_samples.sample_variances(samples, bare, count, 40.0)
    is_dark = (pixel_means(samples, count) == 0.0)[10:30, 10:30]
    assert 0.5 < is_dark.mean() < 0.9 and variance[:9].max() == 0.0
    np.testing.assert_allclose(variance[10:30, 10:30][is_dark].mean(), 9.0 * left * (1.0 - left), rtol=0.15)
    assert eclipse_samples.sample_variances(bare, bare, count, 40.0)[0].max() < 1e-6


def test_the_total_is_held_by_more_samples_or_the_best_there_is():
    """The tolerance of the total is met by as many samples as it takes; what cannot be met has the most."""
    rng = np.random.default_rng(6)
    bare = np.full((96, 96), 1.0, np.float32)
    samples = bare * (rng.random(bare.shape) < 0.5)
    (variance, _), mean = eclipse_samples.sample_variances(samples, bare, 2, 1e3), pixel_means(samples, 2)
    error = eclipse_samples.pixel_errors(variance, 2, 1e3)
    for asked, most in ((0.02, 0.02), (0.004, 0.004), (1e-5, 0.004)):
        refined = eclipse_samples.holding_flux(None, mean, error, variance, 2, 1.0, asked, 0.0)
        count = eclipse_samples.counts(refined, 2)
        assert eclipse_samples.flux_error(mean, variance, count) <= most
    assert refined.samples == MAX_SAMPLES and refined.share == 1.0
