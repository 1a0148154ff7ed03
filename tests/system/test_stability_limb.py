"""The limb at every orientation, crescents that are all limb, and facets that are all edge."""

from __future__ import annotations

import numpy as np
import pytest
import sweeps
import views
from cells import slow_but
from glrender import Body, Renderer


def test_the_limb_is_in_its_place_at_every_orientation():
    """36 sectors of a full disc against the outline's polygon: 0.03 px RMS, 0.08 px each, 0.02 px in the mean.

    The goal is 0.05 px each.
    """
    offset = sweeps.limb_offsets()
    assert np.sqrt(np.mean(offset**2)) <= 0.03
    assert np.abs(offset).max() <= 0.08
    assert abs(offset.mean()) <= 0.02


@pytest.mark.parametrize("is_rough", [False, True], ids=["sphere", "rough"])
@pytest.mark.parametrize("phase_deg", slow_but([165.0, 172.0, 175.0, 177.0, 179.0], 0, 3))
def test_a_thin_crescent_is_right_or_the_plan_says_so(phase_deg, is_rough):
    """Flux within a tenth of the budget, or a warning."""
    error, _, is_warned = sweeps.crescent(phase_deg, is_rough)
    assert is_warned or np.isnan(error) or abs(error) <= 2e-3


@pytest.mark.parametrize("phase_deg, tolerance", slow_but(
    [(165.0, 2e-3), (170.0, 6e-3), (175.0, 0.02), (177.0, 0.05)], 1, 3))
def test_flux_of_a_thin_crescent_of_a_sphere(phase_deg, tolerance):
    """Against the sum over its facets."""
    error, _, _ = sweeps.crescent(phase_deg, False)
    assert abs(error) <= tolerance


@pytest.mark.parametrize("n_sectors", [200, 600])
@pytest.mark.parametrize("phase_deg", [0.0, 60.0, 120.0])
def test_sliver_facets_leave_no_holes(n_sectors, phase_deg):
    """Facets up to 50 times as long as wide, needles at the poles: flux within 0.2 %, no gap inside the outline."""
    shape = sweeps.sliver_sphere(n_sectors)
    state = views.state(phase_deg=phase_deg, range_m=1e5)
    body = Body(name="body", shape=shape, brdf=sweeps.GREY)
    with Renderer(views.scene([body], [views.camera(256, 1e5)])) as renderer:
        image = renderer.render(state, max_error=0.02, products=["body_id"])
    np.testing.assert_allclose(sweeps.flux(image), sweeps.facet_flux(shape, state), rtol=2e-3)
    seen = image.products["body_id"] == 0
    for row in seen[seen.any(axis=1)]:
        first, last = np.flatnonzero(row)[[0, -1]]
        assert row[first:last + 1].all()
