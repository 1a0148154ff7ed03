"""Errors in the navigator's units: what is predicted beside float64 rays, and tolerances in any of the units."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import views
from glrender import Body, ConfigError, Renderer, Scene, draw_still, open_renderer, take_frame
from glrender.brdf import Lambert
from glrender.planner.plan import ONE_DIRECTION, SLIVERS
from glrender.planner.predicted import allowed_rms, frame_errors
from glrender.planner.request import ImageUse
from glrender.scene.tolerance import LEAST, UNITS
from glrender.view.regions import Group
from glrender_camera import CameraModel, Detector, Optics
from glrender_cli.tolerance import read_max_error
from planning import CAMERA, view

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from accuracy.units import check_units, draw_small, summary, unit_errors

STATE = views.state(phase_deg=60.0, range_m=1500.0)
BODY = Body(name="body", shape=views.binary(7, 5),
            brdf=Lambert(normal_albedo=0.3))


@pytest.fixture(scope="module")
def renderer():
    with Renderer(Scene(bodies=[BODY], cameras=[views.camera(128, 700.0)])) as made:
        yield made


def test_held_out_frames_are_within_their_predictions_in_every_unit():
    """Twelve scenes that no constant was fitted to, beside float64 rays: in each unit at most one is beyond."""
    bodies = ["gaussian 20k", "binary 20k", "gaussian 82k", "binary 82k"]
    rows = [check_units(draw_small(seed, bodies, (64,)), 2e6) for seed in range(500, 512)]
    rows = [row for row in rows if row is not None]
    assert len(rows) >= 10
    for unit, told in summary(rows).items():
        assert told["frames"] >= 6 and told["within"] >= 1.0 - 1.0 / told["frames"], (unit, told)
        assert 0.03 < told["median"] and told["largest"] < 3.0, (unit, told)


def test_true_errors_of_a_disc_that_is_moved_or_grown():
    """By closed forms: 0.1 px aside is 0.1 px of the centre and no range; a radius 0.2 px larger is 0.66 % of range."""
    def disc(x_px, radius_px, n=96, samples=24):
        axis = (np.arange(n)[:, None] + (np.arange(samples) + 0.5) / samples - 0.5).ravel()
        inside = np.hypot(*np.meshgrid(axis - x_px, axis - 47.7)) < radius_px
        return inside.reshape(n, samples, n, samples).mean(axis=(1, 3))

    exact = disc(48.2, 30.3)
    moved, grown = (unit_errors(image, exact, exact > 0.5) for image in (disc(48.3, 30.3), disc(48.2, 30.5)))
    assert moved["centroid_px"] == pytest.approx(0.1, abs=2e-3) and moved["limb_px"] == pytest.approx(0.071, rel=0.15)
    assert moved["range"] < 5e-4 and moved["flux"] < 1e-4
    assert grown["range"] == pytest.approx(0.2 / 30.3, rel=0.15) and grown["limb_px"] == pytest.approx(0.2, rel=0.15)
    assert grown["flux"] == pytest.approx((30.5 / 30.3) ** 2 - 1.0, rel=0.02) and grown["centroid_px"] < 2e-3


@pytest.mark.parametrize("max_error", [0.1, 0.02, 0.004])
def test_a_number_plans_as_ever_and_as_a_table_of_rms(renderer, max_error):
    plain, table = (renderer.render(STATE, max_error=asked) for asked in (max_error, {"rms": max_error}))
    assert plain.irradiance_W_m2.tobytes() == table.irradiance_W_m2.tobytes()
    assert plain.plan.windows == table.plan.windows and plain.plan.predicted == table.plan.predicted
    assert plain.plan.max_error == max_error and plain.plan.asked == table.plan.asked == {"rms": max_error}
    assert all(window.budget.tolerance == max_error for window in plain.plan.windows)


@pytest.mark.parametrize("how", ["coverage", "centroids", "rays", "raster"])
@pytest.mark.parametrize("size_px, phase_deg", [(0.3, 20.0), (30.0, 140.0), (800.0, 60.0), (np.inf, 60.0)])
def test_an_rms_error_that_is_allowed_meets_the_tolerance(how, size_px, phase_deg):
    """Whatever part of it is modelled, in each unit, and after a point spread function; a tolerance of all is least."""
    members = Group.of([view(size_px=size_px, phase_deg=phase_deg)], CAMERA)
    asked = {"flux": 0.004, "centroid_px": 0.05, "limb_px": 0.1, "range": 0.05}
    for gain in (1.0, 0.3):
        each = {unit: allowed_rms({unit: most}, members, how, gain) for unit, most in asked.items()}
        assert allowed_rms(asked, members, how, gain) == min(each.values())
        for unit, rms in each.items():
            for part in (0.0, 0.5, 1.0):
                assert frame_errors([(members, how, rms, part * rms)], gain)[unit] <= asked[unit] * (1 + 1e-9)
        assert allowed_rms({"rms": 0.02}, members, how, gain) == 0.02 / gain


@pytest.mark.parametrize("asked", [{"flux": 0.002}, {"centroid_px": 0.02}, {"limb_px": 0.05, "range": 1e-3},
                                   {"rms": 0.05, "centroid_px": 0.004, "flux": 5e-4}])
def test_all_that_is_named_is_met_and_the_rest_is_told(renderer, asked):
    plan = renderer.render(STATE, max_error=asked).plan
    assert not plan.missed and not plan.warnings and list(plan.predicted) == list(UNITS)
    assert all(plan.predicted[unit] <= most for unit, most in asked.items())
    assert plan.asked == asked and plan.max_error <= asked.get("rms", 1.0)


def test_looser_tolerances_take_less_work(renderer):
    """OpenGL draws again fewer pixels, with fewer samples; coverage does without clipping."""
    def work(**asked):
        window, = renderer.render(STATE, max_error=asked, engine="raster").plan.windows
        return window.samples**2 + window.refined_samples**2 * window.refined_share

    for unit, loose, tight in (("centroid_px", 0.1, 0.02), ("flux", 0.01, 0.002), ("limb_px", 0.2, 0.04)):
        assert work(**{unit: loose}) < work(**{unit: tight}), unit
    engines = [renderer.render(STATE, max_error={"flux": most}).plan.windows[0].how for most in (0.005, 0.0004)]
    assert engines == ["centroids", "coverage"]


def test_a_tolerance_below_what_is_promised_of_any_frame_costs_no_more_and_is_told(renderer):
    """The limb is promised to 0.012 px at best; asking for less draws what that takes, and says so."""
    asked, least = ({"limb_px": most} for most in (1e-6, 1e-3))
    plans = [renderer.render(STATE, max_error=each).plan for each in (asked, least)]
    assert plans[0].windows == plans[1].windows and plans[0].missed == ("limb_px",)
    assert "frame of this view is 0.012" in plans[0].warnings[0] and "exceeds max_error 1e-06" in plans[0].warnings[0]


def test_a_point_spread_function_leaves_flux_and_centre_as_they_are(renderer):
    """Of a frame of digital numbers: RMS by the function's gain, the limb by its root, range and the rest as before.

    Light that is lost or too bright as a whole is no less afterwards.
    """
    model = CameraModel(optics=Optics(aperture_diameter_m=0.02, psf_sigma_px=1.2), exposure_s=0.05,
                        detector=Detector(quantum_efficiency=0.5, full_well_electrons=3e4, gain_DN_per_electron=0.1,
                                          bit_depth=12, read_noise_electrons=10.0))
    camera = views.camera(128, 700.0, model=model)
    with Renderer(Scene(bodies=[BODY], cameras=[camera])) as blurred:
        frame = take_frame(blurred, STATE, max_error={"rms": 0.02 * model.psf_noise_gain}).plan
        bare = draw_still(blurred, STATE, max_error=0.02).plan
    gain, ratio = model.psf_noise_gain, {unit: frame.predicted[unit] / bare.predicted[unit] for unit in UNITS}
    whole = math.hypot(*(bare.windows[0].causes[cause] for cause in (ONE_DIRECTION, SLIVERS))) / bare.predicted_error
    expected = {"rms": math.hypot(gain, whole * math.sqrt(1.0 - gain**2)), "flux": 1.0, "centroid_px": 1.0,
                "limb_px": math.sqrt(gain), "range": 1.0}
    assert ratio == pytest.approx(expected, rel=1e-6) and gain < 0.5


@pytest.mark.parametrize("gain", [0.3, 0.05])
@pytest.mark.parametrize("subdivisions, size_px, asked", [(4, 8, 0.02), (4, 150, 0.1), (5, 8, 0.02), (5, 150, 0.1)])
def test_flux_centre_and_range_of_an_image_are_predicted_alike_before_any_point_spread_function(
        subdivisions, size_px, asked, gain):
    """Equal images, clipped or by centroids, small or large, have equal errors; one drawn better has no larger ones."""
    body = Body(name="body", shape=views.binary(7, subdivisions), brdf=Lambert(normal_albedo=0.3))
    with Renderer(views.scene([body], [views.camera(200 if size_px > 100 else 16, 50.0 * size_px)])) as made:
        state = views.state(phase_deg=60.0, range_m=10_000.0)
        bare, blurred, better = (made.render(state, max_error=most, use=ImageUse(error_gain=each)) for most, each in (
            (asked, 1.0), (asked, gain), (0.05 * asked, gain)))
    assert bare.irradiance_W_m2.tobytes() == blurred.irradiance_W_m2.tobytes()
    for unit in ("flux", "centroid_px", "range"):
        assert blurred.plan.predicted[unit] == pytest.approx(bare.plan.predicted[unit], rel=1e-6), unit
        assert better.plan.predicted[unit] <= bare.plan.predicted[unit] * (1.0 + 1e-6), unit


def test_a_slow_backend_takes_units_too():
    with open_renderer(Scene(bodies=[BODY], cameras=[views.camera(48, 200.0)]), "raytrace") as tracer:
        plan = tracer.render(STATE, max_error={"centroid_px": 0.02}).plan
    assert plan.predicted["centroid_px"] <= 0.02 and plan.asked == {"centroid_px": 0.02} and not plan.missed


def test_a_plan_is_ten_lines_that_tell_the_engine_and_why(renderer):
    plan = renderer.render(STATE, max_error={"centroid_px": 0.02}, engine="rays").plan
    lines = str(plan).splitlines()
    assert len(lines) <= 10 and "ms" in lines[0] and "centroid" in lines[1] and "(0.02 px allowed)" in lines[1]
    assert "rays, " in lines[2] and "samples a pixel" in lines[2] and "asked for" in lines[2]
    told = plan.to_dict()
    assert told["predicted"] == plan.predicted and told["missed"] == () and told["milliseconds"] > 0.0
    assert "evenly bright" in renderer.render(STATE, max_error=0.1).plan.windows[0].why and "navigation" not in told


@pytest.mark.parametrize("asked, message", [
    ({"centroid": 0.1}, r"max_error.centroid: unknown key; did you mean 'centroid_px'\?"),
    ({"flux": -0.1}, r"max_error.flux: must be > 0 and <= 1, got -0.1; the least is 6e-08"),
    ({"limb_px": float("nan")}, "max_error.limb_px: must be a finite number, got nan"),
    ({"flux": 1e-9}, "max_error.flux: must be at least 6e-08: float32 pixels hold no less, got 1e-09"),
    ({"rms": 2.0}, "max_error.rms: must be > 0 and <= 1, got 2.0; 2 % is 0.02"),
    ({"centroid_px": True}, "max_error.centroid_px: must be a finite number"),
    ({}, "max_error: must name one of rms, flux, centroid_px, limb_px, range, sigmas, or be a number"),
    (0.5 * LEAST, "max_error: must be at least 6e-08"),
    ([0.1], "max_error: must be a finite number"),
])
def test_tolerances_that_are_none_are_refused_with_the_way_out(renderer, asked, message):
    with pytest.raises(ConfigError, match=message):
        renderer.render(STATE, max_error=asked)


def test_the_command_line_s_tolerances():
    assert read_max_error("0.02") == 0.02 and read_max_error(None) is None
    assert read_max_error("centroid_px=0.05, flux=0.001") == {"flux": 0.001, "centroid_px": 0.05}
    for text in ("low", "flux=", "flux=1e-3,flux=2e-3", "flux=0.1,0.2", "=1"):
        with pytest.raises(ConfigError, match="must be a number, or units with one each"):
            read_max_error(text)
