"""How far facets are divided, and how closely what crosses them is cut: a sheet under a square roof, of few or many."""

from __future__ import annotations

import numpy as np
import pytest
import solids
from glrender import Body, Shape
from glrender.engines.coverage import sunlit_error
from glrender.engines.coverage.boundary_refinement import find_areas
from glrender.planner.error_budget import MISSED_SHARE
from roofs import HALF_M, LAW, below_a_roof, seen_of

# Facets along a side: 2592 and 4050 facets in all.
FEW_ASIDE, MANY_ASIDE = 36, 45


def sheet(n_aside):
    """A square of 300 m, of two facets in each of n x n squares."""
    x = np.linspace(-HALF_M, HALF_M, n_aside + 1)
    place = np.arange((n_aside + 1) ** 2).reshape(n_aside + 1, -1)
    a, b, c, d = place[:-1, :-1], place[:-1, 1:], place[1:, 1:], place[1:, :-1]
    facets = np.concatenate([np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))])
    y, x = np.meshgrid(x, x, indexing="ij")
    return Shape.from_arrays(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), facets)


def areas_under(n_aside, roof_m, light_over_most):
    """The areas of a sheet, a facet of which has so many times the squared light that may err; and the latter."""
    bodies, state, camera = below_a_roof(1, 200.0, 20.0)
    bodies = [Body(name="ground", shape=sheet(n_aside), brdf=LAW),
              Body(name="roof", shape=solids.slab(roof_m, 0.01), brdf=LAW)]
    seen, *_ = seen_of(bodies, state, camera)
    light = sunlit_error.pixels_squared(seen.radiance.of(seen.whole), seen.facet_px(seen.whole)).max()
    return find_areas(seen, light / light_over_most, 1.0), light / light_over_most


@pytest.mark.parametrize("n_aside, light_over_most, is_divided", [
    (FEW_ASIDE, 0.1, False), (FEW_ASIDE, 0.2, True), (MANY_ASIDE, 15.0, False), (MANY_ASIDE, 30.0, True)])
def test_facets_are_divided_first_that_might_hide_a_tolerance_of_light(n_aside, light_over_most, is_divided):
    """Of few each counts, of which a boundary may take 0.4; of many errors cancel, and dividing them all takes long."""
    areas, _ = areas_under(n_aside, 20.0, light_over_most)
    assert len(areas.seen.uniform.facet) > 0.9 * len(areas.seen.boundary.facet) if is_divided else not len(
        areas.seen.uniform.facet)


@pytest.mark.parametrize("light_over_most, n_divisions", [(1.0, 1), (5.0, 2), (18.0, 3)])
def test_facets_by_the_boundary_are_divided_until_little_is_missed_or_three_times(light_over_most, n_divisions):
    """The first division leaves a third of what passes between corners, each more a half of that."""
    n_aside = 2 * MANY_ASIDE
    areas, most = areas_under(n_aside, 100.0, light_over_most)
    seen = areas.seen
    before = sunlit_error.missed(float(seen.squared_light(seen.boundary).sum()) / seen.safety_squared,
                                 seen.facets.crease_rad, seen.view.phase_rad)
    assert areas.missed / before == pytest.approx(0.36 * 0.5 ** (n_divisions - 1), rel=0.2)
    assert areas.missed <= MISSED_SHARE * most or n_divisions == 3
    lit = np.concatenate([corner[:, np.isin(facet, np.setdiff1d(seen.beside_boundary().facet, areas.clipped.facet))]
                          for corner, facet in areas.polygons if len(corner) == 3], axis=1)
    x, y = seen.cutter.points.r_m[:2, lit]
    part_m2 = 0.5 * np.abs((x * np.roll(y, -1, axis=0) - y * np.roll(x, -1, axis=0)).sum(axis=0))
    np.testing.assert_allclose(part_m2, 0.5 * (2.0 * HALF_M / n_aside) ** 2 / 4.0**n_divisions, rtol=1e-9)


@pytest.mark.parametrize("n_aside, light_over_most, n_bisections", [(FEW_ASIDE, 0.1, 6), (MANY_ASIDE, 15.0, 2)])
def test_ends_of_cuts_are_found_as_closely_as_their_number_asks_for(n_aside, light_over_most, n_bisections):
    """After n bisections ends err evenly within 2^-n: the lit share of a part by sqrt(2 / 3) / sqrt(12) of that."""
    areas, _ = areas_under(n_aside, 60.0, light_over_most)
    assert (len(areas.clipped.facet) > 3000) == (n_aside == MANY_ASIDE)
    cutter = areas.seen.cutter

    def lit_m2(polygons):
        for corner, _ in polygons:
            x, y = cutter.points.r_m[:2, corner]
            yield 0.5 * np.abs((x * np.roll(y, -1, axis=0) - y * np.roll(x, -1, axis=0)).sum(axis=0))

    found, exact = (np.concatenate([*lit_m2(each)]) for each in (areas.polygons[-3:-1],
                                                                 cutter.cut_off(areas.clipped, 12)))
    side_m = cutter.points.r_m[:, areas.clipped.corner]
    whole_m2 = 0.5 * np.linalg.norm(np.cross(side_m[:, 1] - side_m[:, 0], side_m[:, 2] - side_m[:, 0], axis=0), axis=0)
    is_one = cutter.are_lit(areas.clipped).sum(axis=0) == 1
    share = (found - exact) / np.concatenate([whole_m2[is_one], whole_m2[~is_one]])
    assert np.sqrt(np.mean(share**2)) == pytest.approx(np.sqrt(2.0 / 3.0 / 12.0) * 0.5**n_bisections, rel=0.4)
