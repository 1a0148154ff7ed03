"""Where shadow maps fail: acne at low Sun, shadows that leave their boulder. docs/stability.md has the plots."""

from __future__ import annotations

import pytest
import sweeps


@pytest.mark.parametrize("size_px", [50.0, 200.0])
@pytest.mark.parametrize("phase_deg, share", [(0.0, 5e-4), (30.0, 5e-4), (60.0, 5e-4), (90.0, 5e-4), (120.0, 5e-4),
                                              (150.0, 2e-3), (165.0, 1e-2), (175.0, 0.2)])
def test_a_convex_body_casts_no_shadow_on_itself(phase_deg, size_px, share):
    """The goal is 0.05 % of the lit flux; from 150 deg on the low Sun costs what is stated here."""
    assert abs(sweeps.false_shadow(phase_deg, size_px, samples=4)) <= share


@pytest.mark.parametrize("phase_deg", [5.0, 30.0, 60.0, 90.0, 120.0, 150.0, 170.0, 175.0])
def test_a_shadow_stays_with_what_casts_it(phase_deg):
    """A pillar's shadow begins at its foot and ends where it must: its length within half a pixel."""
    assert abs(sweeps.pillar_shadow(phase_deg)) <= 0.5
