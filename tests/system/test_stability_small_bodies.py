"""From a hundredth of a pixel to twenty: the light stays what it is, and where it is."""

from __future__ import annotations

import numpy as np
import pytest
import sweeps
from cells import slow_but

PLACES = ((0.0, 0.0), (0.31, 0.17), (-0.45, 0.49))


@pytest.mark.parametrize("size_px", slow_but(
    [0.01, 0.1, 0.5, 1.0, 2.0, 3.0, 3.95, 4.05, 5.0, 7.0, 10.0, 20.0], 0, 3, 6, 7, 10))
@pytest.mark.parametrize("phase_deg, centroid_px", [(20.0, 0.01), (90.0, 0.015)])
def test_flux_and_centre_of_brightness_run_on(size_px, phase_deg, centroid_px):
    """A rough binary at three places in the pixel, rays put into the same pixels as truth; the goal is 1 %, 0.01 px."""
    found = np.array([sweeps.small_body(size_px, phase_deg, place, max_error=0.02) for place in PLACES])
    np.testing.assert_allclose(found[:, 0], 0.0, atol=0.005)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=centroid_px)


def test_below_a_pixel_the_flux_does_not_depend_on_size_or_place():
    """The grid of samples moves with the body: 1e-3 over sizes of 0.01 to 3 px."""
    found = [sweeps.small_body(size, 90.0, place, max_error=0.01)[0] for size in (0.01, 0.3, 3.0) for place in PLACES]
    assert np.ptp(found) < 1e-3
