"""Derivatives of frames with shadows, and with what hides, against exact polygons of a slab with a pillar."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import views
from data_folders import ITOKAWA
from glrender import Body, Renderer, Shape
from glrender.brdf import Lambert
from glrender.engines.coverage import accumulate, boundary_refinement
from moved_states import moved
from pillar import BODY, CAMERA, STATE, moments, truth

COUNTS = {"spacecraft": 6, "bodies.body": 6, "sun": 2, "focal_length": 1}
# Steps [m, rad, px] of a thousandth of what moves the outline by a pixel, about.
STEPS = {"spacecraft": (4e-3, 4e-3, 0.1, 1e-6, 1e-6, 3e-5), "bodies.body": (4e-3, 4e-3, 0.1, 3e-5), "sun": (3e-5,),
         "focal_length": (0.03,)}


@cache
def drawn(sun_disc=False, distance_au=1.0):
    seen = replace(STATE, r_sun_inertial_m=distance_au * STATE.r_sun_inertial_m)
    with Renderer(views.scene([BODY], [CAMERA], sun_disc=sun_disc)) as renderer:
        return renderer.render(seen, derivatives=COUNTS, max_error=0.003)


def whole(image, name):
    (x0, y0, x1, y1), values = image.jacobian.roi, image.jacobian[name]
    found = np.zeros((len(values), *image.irradiance_W_m2.shape))
    found[:, y0:y1, x0:x1] = values
    return found


def differences(name, k):
    step = STEPS[name][min(k, len(STEPS[name]) - 1)]
    plus, minus = (truth(*moved(STATE, CAMERA, name, k, side * step)) for side in (1.0, -1.0))
    return (plus - minus) / (2.0 * step)


def test_the_image_is_that_of_the_polygons():
    assert views.relative_rms(drawn().irradiance_W_m2.astype(float), truth(STATE, CAMERA)) < 0.003


@pytest.mark.parametrize("name, k", [(name, k) for name, count in COUNTS.items() for k in range(count)])
def test_cuts_move_as_the_polygons_do(name, k):
    """Edges that shade and hide, to where few bisections put them; those that slide over few facets are coarser."""
    expected, found = differences(name, k), whole(drawn(), name)[k]
    scale = np.abs(moments(np.abs(expected))).max()
    slides = name == "sun" or (name, k // 3) == ("bodies.body", 1)
    np.testing.assert_allclose(moments(found) / scale, moments(expected) / scale, atol=0.03 if slides else 1e-3)
    assert np.linalg.norm(found - expected) < (0.25 if slides else 0.015) * np.linalg.norm(expected)


@pytest.mark.parametrize("name, k", [("spacecraft", 0), ("bodies.body", 3), ("bodies.body", 4), ("sun", 0), ("sun", 1)])
def test_the_discs_derivatives_are_the_mean_of_its_points(name, k):
    """A tenth of an astronomical unit from the Sun penumbras are 8 px wide, and their middles move as hard edges do."""
    image, expected = drawn(sun_disc=True, distance_au=0.1), 100.0 * differences(name, k)
    scale = np.abs(moments(np.abs(expected))).max()
    np.testing.assert_allclose(moments(whole(image, name)[k]) / scale, moments(expected) / scale, atol=0.05)
    hard = np.linalg.norm(whole(drawn(), "sun")) * 100.0
    assert np.linalg.norm(whole(image, "sun")) < 0.8 * hard


def test_the_plan_keeps_coverage_and_predicts_the_error_of_derivatives():
    """Where it would draw by rays otherwise: a rough binary at a tight tolerance."""
    body = Body(name="body", shape=views.binary(3, 5), brdf=Lambert(normal_albedo=0.3))
    with Renderer(views.scene([body], [views.camera(128, 1000.0)], sun_disc=False, max_error=0.001)) as renderer:
        image = renderer.render(views.state(phase_deg=90.0, range_m=2000.0), derivatives=["spacecraft", "sun"])
    assert {window.engine for window in image.plan.windows} == {"coverage"}
    assert "derivatives were asked for" in str(image.plan) and "predicted error of derivatives" in str(image.plan)
    assert 0.002 < image.plan.jacobian_error["spacecraft"] < 0.1 < image.plan.jacobian_error["sun"]
    with Renderer(views.scene([body], [views.camera(64, 500.0)], sun_disc=False)) as renderer:
        late = renderer.render(views.state(phase_deg=175.0, range_m=2000.0), derivatives=["spacecraft"])
    assert late.plan.jacobian_error["spacecraft"] > 0.5
    assert image.plan.to_dict()["jacobian_error"] == image.plan.jacobian_error


@pytest.fixture
def exact_cuts(monkeypatch):
    """Ends of cuts are found to 18 bisections, and no light is taken off where areas overlap."""
    def areas_alone(values, cover, *rest):
        return settle(values, np.minimum(cover, 1.0), *rest)

    settle = accumulate.settle
    monkeypatch.setattr(accumulate, "settle", areas_alone)
    monkeypatch.setattr(boundary_refinement, "_BISECTIONS", 18)
    monkeypatch.setattr(boundary_refinement, "_BISECTIONS_OF_FEW", 18)


@pytest.mark.slow
@pytest.mark.parametrize("phase_deg", [60.0, 80.0])
def test_the_suns_derivatives_of_a_rough_body_hold_but_where_shadows_jump(exact_cuts, phase_deg):
    """Within 5 % outside 0.5 % of the lit pixels, which have shadows that leap over ridges, by a turn of 1e-3 rad."""
    body = Body(name="body", shape=Shape.from_file(ITOKAWA, length_unit="km"), brdf=Lambert(normal_albedo=0.3))
    camera, state = views.camera(240, 1e4), views.state(phase_deg=phase_deg, range_m=30_000.0)
    with Renderer(views.scene([body], [camera], sun_disc=False, max_error=0.005)) as renderer:
        image = renderer.render(state, derivatives=["sun"])
        found, is_lit = whole(image, "sun"), image.irradiance_W_m2 > 0.0
        for k in range(2):
            plus, minus = (renderer.render(moved(state, camera, "sun", k, step)[0], derivatives=["focal_length"])
                           .irradiance_W_m2.astype(float) for step in (1e-3, -1e-3))
            expected = (plus - minus) / 2e-3
            off = np.abs(found[k] - expected)
            is_kept = off < np.quantile(off[is_lit], 0.995)
            assert np.linalg.norm(off[is_kept]) < 0.05 * np.linalg.norm(expected[is_kept]), k
            assert abs(found[k].sum() / expected.sum() - 1.0) < 0.015, k


@pytest.mark.slow
@pytest.mark.parametrize("phase_deg", [30.0, 60.0, 90.0])
def test_derivatives_of_a_rough_body_are_those_of_its_areas(exact_cuts, phase_deg):
    """With exact ends of cuts on both sides."""
    body = Body(name="body", shape=Shape.from_file(ITOKAWA, length_unit="km"), brdf=Lambert(normal_albedo=0.3))
    size_px, range_m, camera = 200.0, 30_000.0, views.camera(240, 200.0 / 600.0 * 30_000.0)
    state = views.state(phase_deg=phase_deg, range_m=range_m)
    # A shift of 2e-4 px: kinks at the borders of pixels are left out.
    across_m = 2e-4 * range_m / camera.focal_length_px
    turn_rad = 2e-4 / camera.focal_length_px
    steps = (across_m, across_m, across_m * range_m / 300.0, turn_rad, turn_rad, 4e-4 / size_px)
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        def drawn(k=0, step=0.0, derivatives=("focal_length",)):
            seen, _ = moved(state, camera, "spacecraft", k, step)
            return renderer.render(seen, max_error=0.005, derivatives=derivatives)

        found = whole(drawn(derivatives=("spacecraft",)), "spacecraft")
        for k, step in enumerate(steps):
            plus, minus = (drawn(k, side * step).irradiance_W_m2.astype(float) for side in (1.0, -1.0))
            expected = (plus - minus) / (2.0 * step)
            assert np.linalg.norm(found[k] - expected) < 2e-3 * np.linalg.norm(expected), k
