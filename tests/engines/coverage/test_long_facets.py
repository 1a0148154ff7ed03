"""Bars that hide and shade each other between their corners, by closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import solids
import views
from glrender import Body, Renderer
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from scipy.spatial.transform import Rotation

HALF_M, ABOVE_M, SUN_SLOPE, RANGE_M, N_BARS = 100.0, 10.0, 0.5, 1e6, 10


def layers(wide_m):
    """Ten bars of 200 m along x, and ten along y above them, which touch nowhere."""
    boxes = []
    for begin_m in -90.0 + 20.0 * np.arange(N_BARS):
        boxes += [((-HALF_M, begin_m, -wide_m), (HALF_M, begin_m + wide_m, 0.0)),
                  ((begin_m, -HALF_M, ABOVE_M), (begin_m + wide_m, HALF_M, ABOVE_M + wide_m))]
    return solids.several(*boxes)


@pytest.mark.parametrize("wide_m, turn_deg, max_error", [
    (2.0, 0.0, 0.05), (2.0, 25.0, 0.02), (0.5, 25.0, 0.05), (1.0, 10.0, 0.02), (3.0, 10.0, 0.02),
    pytest.param(0.2, 25.0, 0.05, marks=pytest.mark.slow)])
def test_crossed_bars_have_the_light_that_they_leave_each_other(wide_m, turn_deg, max_error):
    """All corners are seen and lit from above; at each of the 100 crossings a bar hides one place and shades another.

    Of a bar as thick as wide, a Sun of a slope along x has a shadow as long as the width and the slope's part of it.
    """
    shape = layers(wide_m)
    scene = views.scene([Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))],
                        [views.camera(300, RANGE_M)], sun_disc=False)
    up = Rotation.from_euler("z", turn_deg, degrees=True)
    state = replace(views.state(direction=(0.0, 0.0, 1.0), range_m=RANGE_M),
                    r_sun_inertial_m=AU_M * up.apply(np.array([SUN_SLOPE, 0.0, 1.0]) / np.hypot(SUN_SLOPE, 1.0)))
    state = replace(state, bodies={"body": replace(state.bodies["body"], q_from_inertial=up.inv().as_quat(
        scalar_first=True))})
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=max_error)
    area_m2 = 2.0 * N_BARS * 2.0 * HALF_M * wide_m - N_BARS**2 * wide_m**2 * (2.0 + SUN_SLOPE)
    expected = (views.SOLAR_IRRADIANCE_W_M2 * 0.3 / np.pi * area_m2 / np.hypot(SUN_SLOPE, 1.0)
                / (RANGE_M - 0.5 * ABOVE_M) ** 2)
    assert image.plan.windows[0].engine == "coverage"
    error = abs(image.irradiance_W_m2.sum(dtype=float) / expected - 1.0)
    assert error <= max(image.plan.predicted["flux"], 0.1 * max_error), (error, image.plan.predicted)
