"""What noise lets be known: a closed form, the scatter of simulated fits, and costs in a pose."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import views
from data_folders import ITOKAWA
from glrender import Body, Renderer, Shape, generate
from glrender.base.constants import AU_M
from glrender.base.errors import ConfigError
from glrender.brdf import Lambert
from glrender_camera import CameraModel, Detector, Optics
from moved_states import moved

DETECTOR = Detector(quantum_efficiency=0.6, full_well_electrons=5e4, gain_DN_per_electron=0.08, bit_depth=12,
                    offset_DN=60.0, read_noise_electrons=20.0, dark_current_electrons_per_s=50.0)
CAMERA = views.camera(40, 250.0, model=CameraModel(
    optics=Optics(aperture_diameter_m=0.02, psf_sigma_px=0.8, transmission=7e-6), detector=DETECTOR, exposure_s=0.004))
BODY = Body(name="body", brdf=Lambert(normal_albedo=0.3), shape=generate.icosphere(radius_m=100.0, subdivisions=3))
STATE = views.state(phase_deg=60.0, range_m=2000.0)


@cache
def drawn(state=STATE, max_error=0.02, derivatives=("spacecraft", "law.normal_albedo")):
    with Renderer(views.scene([BODY], [CAMERA], sun_disc=False)) as renderer:
        return renderer.render(state, derivatives=derivatives, max_error=max_error)


def test_the_albedo_of_a_body_is_known_as_well_as_its_light():
    """One factor on all light: its information is that of a sum of Poisson numbers and read-out noise."""
    image = drawn()
    known = image.information(unknown=(), components={"law.normal_albedo": (0,)})
    quiet = replace(CAMERA, model=replace(CAMERA.model, detector=Detector(
        quantum_efficiency=0.6, full_well_electrons=1e14, gain_DN_per_electron=1e-9, bit_depth=16)))
    electrons = 1e-6 * quiet.expose(image.irradiance_W_m2 * np.float32(1e6)).electrons.astype(float)
    variance = electrons + 20.0**2 + 50.0 * 0.004 + 1.0 / 12.0 / 0.08**2
    expected = 0.3 / np.sqrt(np.sum(electrons**2 / variance))
    np.testing.assert_allclose(known.sigmas["law.normal_albedo"], expected, rtol=1e-3)
    assert known.names == ("law.normal_albedo",) and known.unknowable == () and known.warnings == ()


def test_simulated_fits_scatter_as_the_bound_has_it():
    """300 noisy frames of the camera: the detector's own noise, against the variances of the bound."""
    image = drawn()
    known = image.information(CAMERA.model, components={"spacecraft": (0, 1, 2)})
    fit, count = known.fit, len(known.names)
    errors = []
    for seed in range(300):
        dn = CAMERA.expose(image.irradiance_W_m2, seed).dn
        residual = ((dn - 60.0) / 0.08 - 50.0 * 0.004 - fit.sensor.electrons) * fit.sensor.weights
        errors.append(fit.scale[:count] * (fit.inverse @ (fit.design[:, :count].T @ residual.ravel())))
    errors = np.array(errors)
    np.testing.assert_allclose(np.std(errors, axis=0) / list(known.sigmas.values()), 1.0, atol=0.12)
    assert abs(np.mean([known.nees(error) for error in errors]) - 3.0) < 0.4
    pixels = known.in_pixels
    np.testing.assert_allclose(pixels["spacecraft[0]"], known.sigmas["spacecraft[0]"] * 250.0 / 2000.0, rtol=1e-6)
    np.testing.assert_allclose(pixels["spacecraft[2]"], known.sigmas["spacecraft[2]"] / 20.0, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("size_px", "phase_deg"), [(200.0, 60.0), (200.0, 90.0), (500.0, 60.0)])
def test_sigmas_of_a_rough_body_are_within_1_percent_of_those_at_a_far_finer_tolerance(size_px, phase_deg):
    body = Body(name="body", shape=Shape.from_file(ITOKAWA, length_unit="km"), brdf=Lambert(normal_albedo=0.3))
    camera = views.camera(round(1.2 * size_px), 50.0 * size_px, model=CAMERA.model)
    state = views.state(phase_deg=phase_deg, range_m=30_000.0)
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        images = [renderer.render(state, derivatives=["spacecraft"], max_error=each) for each in (0.0007, 0.005, 0.02)]
    for components in (range(3), range(6)):
        known = [image.information(components={"spacecraft": components}, exposure_s="auto") for image in images]
        finest, *others = [[*each.sigmas.values()] for each in known]
        for sigmas in others:
            np.testing.assert_allclose(sigmas, finest, rtol=0.01)


def test_what_is_unknown_besides_costs_information():
    sigmas = [drawn().information(unknown=each).sigmas["spacecraft[2]"] for each in ((), "gain", ("gain", "offset"))]
    assert sigmas[0] < sigmas[1] < sigmas[2]
    known = drawn().information(unknown=("gain",))
    assert known.unknowable == ("law.normal_albedo",) and np.isinf(known.sigmas["law.normal_albedo"])
    np.testing.assert_allclose(known.sigmas["spacecraft[0]"], drawn().information(unknown=("gain",), components={
        "spacecraft": range(6)}).sigmas["spacecraft[0]"], rtol=1e-6)


@pytest.mark.parametrize("k, step, unit", [(0, 0.4, 0.125), (1, -0.4, 0.125), (2, 6.0, 0.05)])
def test_the_cost_of_a_moved_image_is_the_move(k, step, unit):
    """A twentieth of a pixel, and 0.3 % of the range, where the attitude is known."""
    known = drawn().information(components={"spacecraft": (0, 1, 2)})
    other = drawn(moved(STATE, CAMERA, "spacecraft", k, step)[0], derivatives=("sun",))
    cost = known.cost_of(other)
    np.testing.assert_allclose(cost.pop(f"spacecraft[{k}]"), step * unit, rtol=0.03)
    assert max(map(abs, cost.values())) < 0.1 * abs(step * unit)
    brighter = known.cost_of(1.1 * drawn().irradiance_W_m2)
    assert max(map(abs, brighter.values())) < 1e-5


def test_nothing_lit_says_that_nothing_can_be_known():
    dark = drawn(replace(STATE, r_sun_inertial_m=-AU_M * STATE.spacecraft.r_inertial_m / 2000.0))
    known = dark.information()
    assert known.unknowable == known.names == (*(f"spacecraft[{k}]" for k in range(6)), "law.normal_albedo")
    assert np.isinf(list(known.sigmas.values())).all() and not known.matrix.any()


def test_a_sharp_point_spread_function_is_warned_of():
    model = replace(CAMERA.model, optics=replace(CAMERA.model.optics, psf_sigma_px=0.4))
    assert "bends within a pixel" in drawn().information(model).warnings[0]
    model = replace(CAMERA.model, optics=replace(CAMERA.model.optics, psf_sigma_px=0.6))
    assert not drawn().information(model).warnings


def test_full_pixels_tell_nothing():
    bright = drawn().irradiance_W_m2 > 0.3 * drawn().irradiance_W_m2.max()
    weights = [drawn().information(exposure_s=exposure_s).fit.sensor.weights[bright] for exposure_s in (0.004, 10.0)]
    assert weights[0].all() and not weights[1].any()
    assert np.isfinite(drawn().information(exposure_s="auto").sigmas["spacecraft[0]"])


def test_bad_arguments():
    image = drawn()
    with Renderer(views.scene([BODY], [views.camera(40, 250.0)], sun_disc=False)) as renderer:
        alone = renderer.render(STATE)
    with pytest.raises(ConfigError, match="must have been asked for"):
        alone.information(CAMERA.model)
    for arguments, message in (({"unknown": ("gains",)}, "did you mean 'gain'"), ({"model": 3}, "be a CameraModel"),
                               ({"components": {"sun": (0,)}}, "ask for it in derivatives"),
                               ({"components": {"spacecraft": (6,)}}, r"components.spacecraft\[0\]"),
                               ({"components": ("spacecraft",)}, r"components: must be a mapping.*\{.spacecraft.: \("),
                               ({"components": {"spacecraft": 0}}, r"components.spacecraft: must be a list.*got 0"),
                               ({"components": {"spacecraft": (0, 0)}}, "each once.*leave it out"),
                               ({"components": {}}, "one at least"), ({"unknown": None}, r"unknown: must be .*\(\)"),
                               ({"model": {"preset": "x"}}, "CameraModel.from_dict")):
        with pytest.raises(ConfigError, match=message):
            image.information(**arguments)
    known = image.information()
    with pytest.raises(ConfigError, match=r"error: must have shape \(7,\)"):
        known.nees([1.0, 2.0])
    with pytest.raises(ConfigError, match="image: must have shape"):
        known.cost_of(np.zeros((3, 3)))
