"""The errors of sunlit areas, out of light alone: a low Sun and few triangles, by closed form and by chance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from glrender.engines.coverage import sunlit_error
from glrender.engines.coverage.coverage_image import CoverageImage
from glrender.engines.coverage.sunlit_error import (
    CLIPPED_ERROR,
    CoverageError,
    ErrorScale,
    low_sun,
    pixels_squared,
    safety_squared,
)

SUN_RAD = 0.0047


def mean_of_disc(u):
    """Mean of max(0, u + t) over a disc of radius 1, t along one axis: by its strips."""
    t = np.cos(math.pi * (np.arange(2000) + 0.5) / 2000)
    weight = np.sqrt(1.0 - t**2) * np.sin(math.pi * (np.arange(2000) + 0.5) / 2000)
    return float((np.maximum(0.0, u + t) * weight).sum() / weight.sum())


@pytest.mark.parametrize("u", [0.0, 0.3, 0.9])
def test_a_facet_on_the_terminator_lacks_the_part_of_the_disc_that_shows(u):
    squared, light = low_sun(np.array([2.0]), np.array([u * SUN_RAD]), np.array([9.0]), SUN_RAD, 0.0, 9.0)
    missing = 2.0 * SUN_RAD * (mean_of_disc(u) - u)
    assert light == pytest.approx(9.0 * missing, rel=1e-4)
    assert squared == pytest.approx(9.0 * missing**2, rel=1e-4)


def test_facets_for_which_the_suns_middle_has_set_have_the_mean_of_what_shows():
    """Over heights of its middle from a radius below the horizon to the horizon."""
    _, light = low_sun(np.array([2.0]), np.array([0.5]), np.array([9.0]), SUN_RAD, 4.0, 9.0)
    shows = np.mean([mean_of_disc(u) for u in -(np.arange(200) + 0.5) / 200])
    assert light == pytest.approx(4.0 * 2.0 * SUN_RAD * shows, rel=1e-3)


def test_a_low_sun_does_not_matter_for_facets_that_all_of_it_lights():
    assert low_sun(np.ones(3), np.full(3, 1.01 * SUN_RAD), np.ones(3), SUN_RAD, 0.0, 3.0) == (0.0, 0.0)


def test_few_triangles_have_the_error_of_nearly_half_their_light_and_many_their_mean():
    """As many as there are have the root of their number: 2000 sums of so many cuts at random stay within."""
    one = safety_squared(np.ones(1))
    assert CLIPPED_ERROR * one == pytest.approx(0.25), "no triangle errs by more than half of its light"
    assert safety_squared(np.ones(10**8)) == pytest.approx(1.0, rel=0.01)
    assert safety_squared(np.r_[1.0, np.full(1000, 1e-8)]) == pytest.approx(one, rel=1e-3), "the others do not matter"
    rng = np.random.default_rng(5)
    for n in (1, 3, 10, 100, 1000):
        # Shares of light that are wrong: mostly small, seldom a tenth, as a boundary that bends leaves them.
        wrong = math.sqrt(CLIPPED_ERROR) * rng.standard_t(4.0, (2000, n)) / math.sqrt(2.0)
        within = (np.minimum(wrong**2, 0.25).sum(axis=1) <= CLIPPED_ERROR * safety_squared(np.ones(n)) * n).mean()
        assert within > 0.95


@pytest.mark.parametrize("n_px, flux_share", [(900.0, 0.1), (900.0, 0.02), (25.0, 0.1)])
def test_a_squared_error_is_that_of_pixels_or_of_the_flux_whichever_asks_for_more(n_px, flux_share):
    """RMS over the lit pixels over their mean; and the error of the total light, over its share of the tolerance."""
    scale = ErrorScale(light=3.0 * n_px, n_px=n_px, phase_rad=1.0, flux_share=flux_share)
    squared = 0.5
    rms, flux = math.sqrt(squared / n_px) / 3.0, math.sqrt(squared) / (3.0 * n_px)
    assert scale.rms(squared) == pytest.approx(max(rms, flux / flux_share))
    assert scale.error(0.0) > 0.0 and scale.error(scale.most_squared(0.02)) == pytest.approx(0.02)
    light = 0.01 * scale.light
    assert scale.rms(scale.flux_weight * light**2) == pytest.approx(0.01 / flux_share), "as the flux's own"


def test_light_within_a_pixel_errs_in_one_pixel_and_beyond_in_each():
    np.testing.assert_allclose(pixels_squared(2.0, np.array([0.1, 1.0, 7.0])), [0.04, 4.0, 28.0])


@pytest.mark.parametrize("crease_rad", [0.05, 0.2, 0.6])
def test_more_is_missed_between_corners_the_rougher_and_the_lower_the_sun(crease_rad):
    """Shadows are as long as the tangent of half the phase angle says."""
    at = [sunlit_error.missed(1.0, crease_rad, math.radians(phase_deg)) for phase_deg in (20.0, 60.0, 120.0)]
    assert at[0] == pytest.approx(at[1]) and at[2] == pytest.approx(3.0 * at[1])
    assert at[1] == pytest.approx(max(crease_rad, 0.2) / 0.2 * sunlit_error.missed(1.0, 0.0, 1.0))


def test_a_body_between_corners_takes_a_fair_share_of_the_brightest_facet():
    """A disc that fills an equilateral triangle has pi / (3 root 3) of it; all smaller radii are as frequent."""
    largest = math.pi / (3.0 * math.sqrt(3.0))
    fair = largest**2 * np.mean(np.linspace(0.0, 1.0, 1001) ** 4)
    assert fair < sunlit_error.missed_behind(np.array([1.0, 0.5])) < 2.0 * fair
    assert sunlit_error.missed_behind(np.zeros(0)) == 0.0


@pytest.mark.parametrize("share, times", [(0.82, 1.0), (0.78, 1.0 / 0.78), (0.2, 5.0)])
def test_an_image_with_much_less_light_than_its_corners_promise_errs_over_its_own(share, times):
    scale = ErrorScale(light=10.0, n_px=100.0, phase_rad=1.0, flux_share=0.1)
    image = CoverageImage(means=np.full((2, 2), 2.5 * share), error=CoverageError(0.01, 0.02), scales=(scale, scale))
    assert image.by_its_light().error == pytest.approx((0.01 * times, 0.02 * times))


def test_thin_parts_err_over_the_pixels_that_they_light_but_for_crescents():
    """Facets of 100 px that light 1000 err over half of these; the outline alone lights 120."""
    scale = ErrorScale(light=10.0, n_px=100.0, phase_rad=1.0, flux_share=0.1)
    assert scale.over(1000.0).per_root == pytest.approx(np.sqrt(5.0) * scale.per_root)
    assert scale.over(120.0) == scale
    crescent = ErrorScale(light=10.0, n_px=100.0, phase_rad=2.5, flux_share=0.1)
    assert crescent.over(1000.0) == crescent


def test_the_safety_of_a_thousand_triangles_is_no_more_than_their_scatter_asks_for():
    """Shares of light that are wrong as above: 95 % of the sums are within, and a third of them near."""
    wrong = CLIPPED_ERROR * np.random.default_rng(6).standard_t(4.0, (2000, 1000)) ** 2 / 2.0
    ratio = np.minimum(wrong, 0.25).sum(axis=1) / (CLIPPED_ERROR * safety_squared(np.ones(1000)) * 1000)
    assert 0.35 < np.percentile(ratio, 95) <= 1.0
