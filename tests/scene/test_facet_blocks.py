"""Distances to a surface by boxes around runs of its facets, against each facet on its own."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import generate
from glrender.scene.shape.facet_blocks import FacetBlocks


def _nearest_m(corners, point):
    """Distance [m] from a point to a triangle (3, 3): least squares within it and along its sides."""
    best = np.inf
    for free in ((0, 1), (0,), (1,), (2,)):
        start = corners[1] if free == (2,) else corners[0]
        sides = np.array([corners[1] - corners[0], corners[2] - corners[0], corners[2] - corners[1]])[list(free)]
        share = np.linalg.lstsq(sides.T, point - start, rcond=None)[0]
        if len(free) == 2:
            if share.min() < 0.0 or share.sum() > 1.0:
                continue
        else:
            share = np.clip(share, 0.0, 1.0)
        best = min(best, float(np.linalg.norm(start + share @ sides - point)))
    return best


@pytest.mark.parametrize("is_shuffled", [False, True], ids=["as made", "in any order"])
@pytest.mark.parametrize("far", [0.3, 1.05, 4.0])
def test_distances_are_those_of_each_facet(far, is_shuffled, rng):
    """From within a rough body, close to it and far: 1e-12 of the distance; in reach are all facets that are."""
    shape = generate.three_lobes(radius_m=100.0, subdivisions=2)
    facets = rng.permutation(shape.facets) if is_shuffled else shape.facets
    blocks = FacetBlocks(shape.vertices_m, facets)
    for way in rng.normal(size=(4, 3)):
        point = 100.0 * far * way / np.linalg.norm(way)
        each = np.array([_nearest_m(corners, point) for corners in shape.vertices_m[facets]])
        assert blocks.distance_m(point) == pytest.approx(each.min(), rel=1e-12)
        reach = np.quantile(each, 0.1)
        facet, distance = blocks.within(point, reach)
        np.testing.assert_array_equal(facet, np.flatnonzero(each <= reach))
        np.testing.assert_allclose(distance, each[facet], rtol=1e-9)
    assert len(blocks.within(np.array([1e5, 0.0, 0.0]), 10.0)[0]) == 0
