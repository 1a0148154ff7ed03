"""Whole spheres: phase functions, albedos, and a law replaced by a cheaper one.

Numbers are those printed in ../shared/photometry.md unless a docstring says otherwise.
"""

from __future__ import annotations

import numpy as np
import photometry_truth as truth
import pytest
from glrender.base.errors import ConfigError
from glrender.brdf import Akimov, Hapke, Lambert, LommelSeeliger, LunarLambert, OrenNayar, Table
from glrender.brdf.fitting import compare, fit
from glrender.brdf.integrals import (
    bond_albedo,
    centre_of_brightness,
    disc_albedo,
    geometric_albedo,
    hemispherical_albedo,
    phase_function,
    phase_integral,
)
from glrender.brdf.presets import LUNAR_LAMBERT_WEIGHTS, PRESETS
from published_laws import BODIES, COMET, EROS, MOON, hapke

# ---- Whole spheres.

SPHERES = {30: (0.880843, 0.859386, 0.198605, 0.183093), 60: (0.608998, 0.619827, 0.399952, 0.378175),
           90: (0.318310, 0.376775, 0.589049, 0.563219), 120: (0.108998, 0.176041, 0.744876, 0.714947),
           150: (0.014817, 0.045274, 0.847661, 0.814283)}


@pytest.mark.parametrize("g", SPHERES)
def test_phase_functions_and_centres_of_brightness(g):
    """Closed forms of Lambert and Lommel-Seeliger as printed, 6 digits; Lunar-Lambert from both."""
    lambert, seeliger = Lambert(normal_albedo=0.5), LommelSeeliger(single_scattering_albedo=0.5)
    phase = np.radians(g)
    got = (phase_function(lambert, phase), phase_function(seeliger, phase),
           centre_of_brightness(lambert, phase), centre_of_brightness(seeliger, phase))
    np.testing.assert_allclose(got, SPHERES[g], atol=6e-7)
    phi_l, phi_ls = SPHERES[g][:2]
    law = LunarLambert(normal_albedo=0.3, weight=(0.4,))
    np.testing.assert_allclose(disc_albedo(law, phase), 0.3 * (0.4 * phi_ls + 2 / 3 * 0.6 * phi_l), atol=2e-7)


def test_albedos():
    """Lambert: p = 2A/3, q = 3/2, Bond = A. Lommel-Seeliger: p = w/8, q = 16/3 (1 - ln 2)."""
    lambert, seeliger = Lambert(normal_albedo=0.4), LommelSeeliger(single_scattering_albedo=0.4)
    np.testing.assert_allclose([geometric_albedo(lambert), phase_integral(lambert), bond_albedo(lambert)],
                               [0.8 / 3, 1.5, 0.4], rtol=1e-9)
    np.testing.assert_allclose([geometric_albedo(seeliger), phase_integral(seeliger)],
                               [0.05, 16 / 3 * (1 - np.log(2))], rtol=1e-7)
    np.testing.assert_allclose(hemispherical_albedo(lambert, 1.0), 0.4, rtol=1e-9)


@pytest.mark.parametrize("w, tolerance", [(0.05, 0.002), (0.2, 0.009), (0.5, 0.02)])
def test_smooth_hapke_near_its_closed_form(w, tolerance):
    """p Phi = (w/8)[(1+B) p(g) - 1] Phi_LS + (r0/2)(1 - r0) Phi_LS + (2/3) r0^2 Phi_L (Hapke 2012)."""
    law = hapke(single_scattering_albedo=w, b=0.3, c=1.0, shoe_amplitude=1.0, shoe_width=0.05)
    gamma = np.sqrt(1 - w)
    r0 = (1 - gamma) / (1 + gamma)
    for g, (phi_l, phi_ls, *_) in SPHERES.items():
        phase = np.radians(g)
        p = truth.henyey_greenstein(phase, 0.3, 1.0)
        shoe = 1 / (1 + np.tan(phase / 2) / 0.05)
        closed = (w / 8 * ((1 + shoe) * p - 1) + r0 / 2 * (1 - r0)) * phi_ls + 2 / 3 * r0**2 * phi_l
        np.testing.assert_allclose(disc_albedo(law, phase), closed, rtol=tolerance + 0.01 * w)


def test_white_hapke_returns_all_light():
    """w = 1, isotropic, smooth: hemispherical albedo 1 within twice the H function's 0.77 %."""
    law = hapke(single_scattering_albedo=1.0)
    for incidence in (0.0, 0.5, 1.0, 1.4):
        np.testing.assert_allclose(hemispherical_albedo(law, incidence), 1.0, atol=0.016)


@pytest.mark.parametrize("law", [
    Lambert(normal_albedo=1.0), LommelSeeliger(single_scattering_albedo=1.0), OrenNayar(normal_albedo=1.0,
                                                                                       roughness_deg=20.0),
    EROS, MOON, COMET], ids=["lambert", "lommel_seeliger", "oren_nayar", "eros", "moon", "comet"])
def test_no_law_returns_more_light_than_falls(law):
    for incidence in (0.1, 0.8, 1.3, 1.5):
        assert hemispherical_albedo(law, incidence, 48) <= 1.0 + 1e-9


@pytest.mark.parametrize("name", PRESETS)
def test_presets_close_on_their_published_albedo(name):
    """A sphere at zero phase: within 4 % of the paper's geometric albedo."""
    preset = PRESETS[name]
    np.testing.assert_allclose(geometric_albedo(preset.law), preset.geometric_albedo, rtol=0.04)
    assert preset.source and preset.verification and preset.wavelength_nm > 0.0


@pytest.mark.parametrize("name", LUNAR_LAMBERT_WEIGHTS)
def test_isis_weights_span_all_phases(name):
    """0..180 deg, and never so negative that a sphere goes black."""
    law = LunarLambert(normal_albedo=0.2, weight=LUNAR_LAMBERT_WEIGHTS[name])
    assert law.max_phase == np.pi
    assert disc_albedo(law, np.radians(170.0)) > 0.0


# ---- Replacing a law by a cheaper one.


@pytest.mark.parametrize("name, weights, rms", [
    ("comet", (0.715, 0.520, 0.308, 0.112, -0.002, -0.028), (3.9, 3.8, 3.1, 3.5, 6.7, 2.7)),
    ("eros", (0.700, 0.507, 0.294, 0.097, -0.014, -0.033), (3.8, 3.6, 3.1, 3.7, 7.3, 3.0)),
    ("moon", (0.730, 0.563, 0.354, 0.127, -0.019, -0.041), (3.7, 3.8, 3.4, 2.9, 5.7, 3.3))])
def test_best_lunar_lambert_weights(name, weights, rms):
    """photometry.md sections 1.2 and 7: weights 0.001, RMS 0.3 %; flux and centre of brightness exact."""
    result = fit(BODIES[name], LunarLambert, (10.0, 30.0, 60.0, 90.0, 120.0, 150.0))
    np.testing.assert_allclose(result.law.weight.value, weights, atol=1.1e-3)
    np.testing.assert_allclose(100 * result.rms, rms, atol=0.3)
    np.testing.assert_allclose(result.flux, 0.0, atol=2e-4)
    np.testing.assert_allclose(result.centre_of_brightness, 0.0, atol=2e-4)


@pytest.mark.parametrize("kind", [LommelSeeliger, Akimov, LunarLambert])
def test_a_fitted_law_has_the_flux_also_between_its_phases(kind):
    """Fitted every 5 deg, checked half way: 0.3 % of the flux, beyond the 1 deg of the opposition surge."""
    result = fit(EROS, kind, np.arange(10.0, 121.0, 5.0))
    between = compare(result.law, EROS, np.arange(12.5, 118.0, 10.0))
    np.testing.assert_allclose(between.flux, 0.0, atol=3e-3)
    assert (between.rms < 0.35).all()


def test_leaving_roughness_out_brightens_as_published():
    """Section 7: x1.14-1.2 at 60 deg, x1.3-1.45 at 90; centre of brightness -0.012, -0.02."""
    from dataclasses import replace

    for law in BODIES.values():
        result = compare(replace(law, roughness_deg=0.0), law, (60.0, 90.0))
        assert 1.13 < 1.0 + result.flux[0] < 1.21 and 1.29 < 1.0 + result.flux[1] < 1.46
        np.testing.assert_allclose(result.centre_of_brightness, (-0.012, -0.02), atol=0.004)


def test_scaled_lambert_errs_as_published():
    """Section 7: RMS 27 %, 19-20, 11-12, 6 at 10, 30, 60, 90 deg; centre of brightness +0.005 to +0.0095."""
    for law in BODIES.values():
        result = compare(Lambert(normal_albedo=0.1), law, (10.0, 30.0, 60.0, 90.0), is_scaled=True)
        np.testing.assert_allclose(100 * result.rms, (27.0, 19.5, 11.5, 6.0), atol=1.5)
        np.testing.assert_allclose(result.centre_of_brightness, (0.005, 0.0095, 0.009, 0.005), atol=0.002)


def test_fitting_refuses_what_it_cannot_do():
    with pytest.raises(ConfigError, match="kind"):
        fit(EROS, Hapke, (10.0, 20.0))
    with pytest.raises(ConfigError, match="phase_deg"):
        fit(EROS, LunarLambert, (10.0, 180.0))


def test_fitting_a_black_body_names_the_truth():
    for kind in (Lambert, LommelSeeliger, LunarLambert):
        with pytest.raises(ConfigError, match="truth: must return light at a phase of 10 deg, got Hapke"):
            fit(hapke(single_scattering_albedo=0.0), kind, [10.0, 30.0])
    with pytest.raises(ConfigError, match="truth: must return light"):
        compare(Lambert(normal_albedo=0.1), Lambert(normal_albedo=0.0), [10.0])


def test_a_fitted_albedo_that_is_held_at_1_is_warned_of():
    bright = hapke(single_scattering_albedo=1.0, b=0.9, c=1.0, shoe_amplitude=5.0, shoe_width=0.1)
    with pytest.warns(UserWarning, match=r"fitted normal_albedo of \d[\d.]* is held at 1"):
        found = fit(bright, Lambert, [0.0, 30.0])
    assert found.law.normal_albedo == 1.0 and found.flux[0] < -0.5


@pytest.mark.parametrize("phase", [-0.1, 3.2, 180.0, np.nan])
def test_phases_beyond_pi_are_refused(phase):
    for of in (disc_albedo, centre_of_brightness, phase_function):
        with pytest.raises(ConfigError, match="phase: must be"):
            of(Lambert(normal_albedo=0.1), phase)
    assert disc_albedo(Lambert(normal_albedo=0.1), np.pi) == 0.0
    with pytest.raises(ConfigError, match="phase: must be one at which the law returns light"):
        centre_of_brightness(Lambert(normal_albedo=0.1), np.pi)


def test_a_table_interpolates_and_holds():
    table = Table(phase_deg=(10.0, 20.0, 40.0), value=(1.0, 0.5, 0.1))
    law = LunarLambert(normal_albedo=0.2, weight=table)
    np.testing.assert_allclose(law.weight_at(np.array([0.0, 10.0, 15.0, 30.0, 90.0])), [1.0, 1.0, 0.75, 0.3, 0.1])
    np.testing.assert_allclose(np.degrees(law.max_phase), 40.0)
