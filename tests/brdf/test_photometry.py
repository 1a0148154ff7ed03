"""Photometry's named truths: units, closed forms, published tables, and roughness.

Numbers are those printed in ../shared/photometry.md unless a docstring says otherwise.
"""

from __future__ import annotations

import warnings

import numpy as np
import photometry_truth as truth
import pytest
from glrender.base.errors import ConfigError
from glrender.brdf import Akimov, Hapke, Lambert, LommelSeeliger, LunarLambert, Minnaert, OrenNayar, Rolo
from glrender.brdf.integrals import disc_albedo
from glrender.brdf.presets import LUNAR_LAMBERT_WEIGHTS
from phase_functions import K_TABLE
from published_laws import BODIES, hapke

# ---- Units and consistency between laws.


def test_radf_of_lambert_is_albedo_times_cosine(brdf):
    """I/F = pi f mu0 = A cos i, whatever e and psi."""
    i = np.array([0.0, 30.0, 60.0, 85.0])
    for e, psi in ((0.0, 0.0), (50.0, 120.0)):
        radf = np.pi * brdf(Lambert(normal_albedo=0.37), i, e, psi) * np.cos(np.radians(i))
        np.testing.assert_allclose(radf, 0.37 * np.cos(np.radians(i)), rtol=brdf.rtol)


def test_lunar_lambert_of_weight_0_is_lambert(brdf):
    i, e = np.array([0.0, 40.0, 80.0]), np.array([10.0, 70.0, 85.0])
    np.testing.assert_allclose(brdf(LunarLambert(normal_albedo=0.2, weight=(0.0,)), i, e),
                               brdf(Lambert(normal_albedo=0.2), i, e), rtol=brdf.rtol)


@pytest.mark.parametrize("weight", ["mcewen", "gaskell", (1.0,), (0.5,), (0.0,), LUNAR_LAMBERT_WEIGHTS["mars"]])
def test_lunar_lambert_at_the_zenith_is_its_normal_albedo(weight, brdf):
    """D(0, 0, 0) = 1 for any L: the factor 2 that others leave out."""
    np.testing.assert_allclose(np.pi * brdf(LunarLambert(normal_albedo=0.2, weight=weight), 0.0, 0.0), 0.2,
                               rtol=brdf.rtol)


def test_lunar_lambert_of_weight_1_is_lommel_seeliger_with_its_factor_2(brdf):
    """2 A mu0/(mu0 + mu): single scattering of w = 8 A, which geometric albedos w/8 and A agree on."""
    np.testing.assert_allclose(brdf(LunarLambert(normal_albedo=0.1, weight=(1.0,)), 50.0, 20.0),
                               brdf(LommelSeeliger(single_scattering_albedo=0.8), 50.0, 20.0), rtol=brdf.rtol)


def test_dark_smooth_isotropic_hapke_is_lommel_seeliger(brdf):
    """As w -> 0 multiple scattering is w^2: w/(4 pi)/(mu0 + mu), with the same 1/(4 pi)."""
    w = 1e-6
    np.testing.assert_allclose(brdf(hapke(single_scattering_albedo=w), 50.0, 20.0),
                               brdf(LommelSeeliger(single_scattering_albedo=w), 50.0, 20.0), rtol=1e-5)


def test_minnaert_of_exponent_1_and_oren_nayar_of_roughness_0_are_lambert(brdf):
    expected = brdf(Lambert(normal_albedo=0.2), 50.0, 20.0, 30.0)
    np.testing.assert_allclose(brdf(Minnaert(normal_albedo=0.2, exponent=1.0), 50.0, 20.0, 30.0), expected,
                               rtol=brdf.rtol)
    np.testing.assert_allclose(brdf(OrenNayar(normal_albedo=0.2, roughness_deg=0.0), 50.0, 20.0, 30.0), expected,
                               rtol=brdf.rtol)


def test_rolo_without_surge_is_lommel_seeliger(brdf):
    """A0 mu0/(mu0 + mu) against w/4: I/F, not r."""
    np.testing.assert_allclose(brdf(Rolo(surge=(0.0, 1.0), coefficients=(0.1,)), 50.0, 20.0),
                               brdf(LommelSeeliger(single_scattering_albedo=0.4), 50.0, 20.0), rtol=brdf.rtol)


def test_one_term_phase_function_in_both_writings(brdf):
    """(Hg1, Hg2 = 1) of ISIS is a single backward lobe: one_term(-b) == Hapke(b, c=1)."""
    a = Hapke.one_term(asymmetry=-0.3, single_scattering_albedo=0.3)
    np.testing.assert_array_equal(brdf(a, 40.0, 50.0, 60.0), brdf(hapke(b=0.3, c=1.0), 40.0, 50.0, 60.0))
    forward = Hapke.one_term(asymmetry=0.3, single_scattering_albedo=0.3)
    # One minus the other's phase angle: p(g) of one lobe is p(pi - g) of the other.
    assert brdf(forward, 10.0, 10.0) < brdf(a, 10.0, 10.0)


@pytest.mark.parametrize("b, value", [(0.9, 4.5), (0.99, 475.0)])
def test_a_spike_of_a_phase_function_at_opposition(b, value, brdf):
    """p(0) = (1 + b)/(1 - b)^2: r = 4.5 and 475 for w = 0.3 (to 2 digits as printed), refused at b = 1."""
    with pytest.warns(UserWarning, match="b > 0.9") if b > 0.9 else warnings.catch_warnings():
        law = hapke(single_scattering_albedo=0.6, b=b, c=1.0)
    single = 0.6 / (4 * np.pi) / 2 * (1 + b) / (1 - b) ** 2
    np.testing.assert_allclose(brdf(law, 0.0, 0.0), single, rtol=0.02)
    np.testing.assert_allclose(single, value, rtol=0.011)


# ---- Anchors of single formulas.


def test_mcewen_is_in_degrees():
    """L(60 deg) = 0.416, L(90) = 0.186, L = 0 at 103.95: not radians."""
    law = LunarLambert(normal_albedo=0.2)
    np.testing.assert_allclose(law.weight_at(np.array([60.0, 90.0])), [0.416, 0.186], atol=5e-4)
    np.testing.assert_allclose(law.weight_at(np.array([103.95])), 0.0, atol=5e-5)
    np.testing.assert_allclose(LunarLambert(normal_albedo=0.2, weight="gaskell").weight_at(60.0), np.exp(-1.0))


def test_akimov_check_values(brdf):
    """D(30, 40, 60 deg) = 1.020429441, D(45, 30, g = 60 deg) = 0.855660659."""
    law = Akimov(normal_albedo=1.0)
    np.testing.assert_allclose(np.pi * brdf(law, 30.0, 40.0, 60.0) * np.cos(np.radians(30)), 1.020429441,
                               rtol=max(brdf.rtol, 1e-9))
    i, e, g = np.radians([45.0, 30.0, 60.0])
    psi = np.degrees(np.arccos((np.cos(g) - np.cos(i) * np.cos(e)) / (np.sin(i) * np.sin(e))))
    np.testing.assert_allclose(np.pi * brdf(law, 45.0, 30.0, psi) * np.cos(i), 0.855660659,
                               rtol=max(brdf.rtol, 2e-9))


def test_akimov_at_opposition_is_flat(brdf):
    """g = 0: longitude is 0/0; D = 1 everywhere."""
    i = np.array([0.0, 20.0, 60.0, 88.0])
    np.testing.assert_allclose(np.pi * brdf(Akimov(normal_albedo=1.0), i, i) * np.cos(np.radians(i)), 1.0,
                               rtol=max(brdf.rtol, 1e-7))


@pytest.mark.parametrize("w, h_1981, h_2002", [
    (0.1, 0.0038, 0.00005), (0.5, 0.020, 0.0017), (0.9, 0.039, 0.0076), (0.99, 0.040, 0.0096)])
def test_h_functions_are_as_far_from_the_exact_one_as_published(w, h_1981, h_2002):
    """Largest relative error over 0..1 against Chandrasekhar's H, to the printed digits.

    Of isotropic grains the BRDF at equal angles is w / (8 pi x) H(x)^2.
    """
    x = np.linspace(1e-4, 1.0, 400)
    exact = truth.h_exact(x, w)
    for name, published in (("1981", h_1981), ("2002", h_2002)):
        law = hapke(single_scattering_albedo=w, h_function=name)
        sun, camera, normal = truth.vectors(np.arccos(x), np.arccos(x), 0.0)
        h = np.sqrt(law.brdf(sun, camera, normal) * 8.0 * np.pi * x / w)
        error = np.abs(h / exact - 1.0).max()
        np.testing.assert_allclose(error, published, rtol=0.06, atol=0.00001)


def test_the_exact_h_function_is_chandrasekhars():
    """H(1; w = 1) = 2.90776: the truth above is right."""
    np.testing.assert_allclose(truth.h_exact(1.0, 1.0 - 1e-12), 2.90776, rtol=1e-4)


def test_porosity_factor():
    """K -> 1 as phi -> 0 (0/0); K at phi = 0.4 is -ln(1 - x)/x of Hapke (2008); refused at its pole."""
    assert hapke(filling_factor=0.0).porosity_factor == 1.0
    np.testing.assert_allclose(hapke(filling_factor=1e-12).porosity_factor, 1.0, atol=1e-7)
    x = 1.209 * 0.4 ** (2 / 3)
    np.testing.assert_allclose(hapke(filling_factor=0.4).porosity_factor, -np.log(1 - x) / x)
    with pytest.raises(ConfigError, match="filling_factor"):
        hapke(filling_factor=0.7523)


def test_multiple_scattering_is_there_without_an_opposition_effect(brdf):
    """visnav added H H - 1 only where B0 != 0. w = 0.9, i = e = 60: H(0.5)^2 of the total, no 1.

    H exact: (w/4 pi)/(2 mu0) H^2, within H02's 0.76 % twice.
    """
    h = truth.h_exact(0.5, 0.9)[0]
    np.testing.assert_allclose(brdf(hapke(single_scattering_albedo=0.9), 60.0, 60.0, 90.0),
                               0.9 / (4 * np.pi) * h * h, rtol=0.016)


def test_anisotropic_scattering_of_an_even_phase_function_is_the_isotropic(brdf):
    """c = 0: only odd Legendre terms count, so AMSA is IMSA."""
    a, b = (hapke(single_scattering_albedo=0.8, b=0.4, c=0.0, multiple_scattering=kind)
            for kind in ("isotropic", "anisotropic"))
    np.testing.assert_array_equal(brdf(a, 40.0, 50.0, 60.0), brdf(b, 40.0, 50.0, 60.0))


@pytest.mark.parametrize("name, published", [
    ("comet", [0.999, 0.998, 0.995, 0.991, 0.991, 0.996]), ("eros", [0.98, 0.977, 0.969, 0.964, 0.971, 0.987]),
    ("moon", [0.99, 0.988, 0.984, 0.984, 0.989, 0.996])])
def test_anisotropic_scattering_changes_a_spheres_flux_as_published(name, published):
    """photometry.md section 7, g = 10..150 deg; printed to 3 digits for sets close to these: 0.004."""
    from dataclasses import replace

    law = BODIES[name]
    for g, ratio in zip((10, 30, 60, 90, 120, 150), published, strict=True):
        other = replace(law, multiple_scattering="anisotropic")
        got = disc_albedo(other, np.radians(g), 48) / disc_albedo(law, np.radians(g), 48)
        np.testing.assert_allclose(got, ratio, atol=4e-3)


@pytest.mark.parametrize("name, published", [
    ("comet", [1.000, 1.000, 0.999, 0.998, 0.995, 0.993]), ("eros", [0.994, 0.992, 0.989, 0.982, 0.971, 0.957]),
    ("moon", [0.993, 0.990, 0.986, 0.981, 0.974, 0.969])])
def test_h_of_1981_changes_a_spheres_flux_as_published(name, published):
    """photometry.md section 7 (w = 0.03, 0.33, 0.40): 0.002."""
    from dataclasses import replace

    law = BODIES[name]
    for g, ratio in zip((10, 30, 60, 90, 120, 150), published, strict=True):
        got = disc_albedo(replace(law, h_function="1981"), np.radians(g), 48) / disc_albedo(law, np.radians(g), 48)
        np.testing.assert_allclose(got, ratio, atol=2e-3)


# ---- Roughness.

@pytest.mark.parametrize("g", K_TABLE)
def test_roughness_dims_a_sphere_as_hapkes_table(g):
    """K = flux rough / smooth of a dark sphere: visnav multiplied pixels by it. 0.0015 (3 digits printed).

    To 100 deg; further on the table, computed in 1984, is coarser: 1.5 % of the value, 0.002.
    """
    smooth = disc_albedo(hapke(single_scattering_albedo=1e-6), np.radians(g))
    got = [disc_albedo(hapke(single_scattering_albedo=1e-6, roughness_deg=t), np.radians(g)) / smooth
           for t in range(10, 70, 10)]
    np.testing.assert_allclose(got, K_TABLE[g], atol=1.5e-3 if g <= 100 else 3e-3, rtol=0 if g <= 100 else 0.015)


def test_roughness_limb_anchor(brdf):
    """photometry.md 4.2, dark sphere: the limb does not go dark. r(i = 30, e -> 90, slope 20) is finite.

    Against the printed branches of Hapke (1984) at 89.99 deg, all azimuths.
    """
    psi = np.array([0.0, 60.0, 120.0, 180.0])
    a = truth.Angles(np.radians(np.full(4, 30.0)), np.radians(np.full(4, 89.99)), np.radians(psi),
                     truth.phase(np.radians(30.0), np.radians(89.99), np.radians(psi)))
    law = hapke(roughness_deg=20.0)
    got = brdf(law, 30.0, 89.99, psi)
    np.testing.assert_allclose(got, truth.hapke(a, w=0.3, b=0.0, c=0.0, theta_deg=20.0), rtol=5e-4)
    assert (got > 1e-3).all()


def test_roughness_uses_the_azimuth_not_the_phase(brdf):
    """visnav put g for psi: at i = e = 60, psi = 90 deg (g = 75.5) the factors differ by 8 %."""
    a = truth.Angles(*(np.radians([x]) for x in (60.0, 60.0, 90.0)), truth.phase(*np.radians([[60.0], [60.0], [90.0]])))
    wrong = truth.Angles(a.i, a.e, a.g, a.g)
    right = truth.hapke(a, w=0.3, b=0.3, c=1.0, theta_deg=30.0)
    got = brdf(hapke(b=0.3, c=1.0, roughness_deg=30.0), 60.0, 60.0, 90.0)
    np.testing.assert_allclose(got, right, rtol=max(brdf.rtol, 1e-9))
    assert abs(truth.hapke(wrong, w=0.3, b=0.3, c=1.0, theta_deg=30.0) / right - 1.0) > 0.01


@pytest.mark.parametrize("theta_deg, size", [(1.0, 3.2e-5), (5.0, 8e-4)])
def test_small_roughness_fades_smoothly(theta_deg, size):
    """No 1/T blow-up: the correction at i = 30, e = 20 is of the printed order and falls with its square."""
    s, v, n = truth.vectors(np.radians(30.0), np.radians(20.0), np.radians(60.0))
    smooth = hapke().brdf(s, v, n)
    change = hapke(roughness_deg=theta_deg).brdf(s, v, n) / smooth - 1.0
    assert -3.0 * size < change < 0.0


@pytest.mark.parametrize("theta_deg", [0.0, 1e-9, 9.9e-4, 1.1e-3, 0.05])
def test_roughness_of_nothing_is_smooth(theta_deg, brdf):
    """Up to 85 deg of incidence and emission, within 1e-6 at 0.05 deg; across the switch at 0.001 deg."""
    i, e = np.array([0.0, 30.0, 85.0]), np.array([0.0, 85.0, 85.0])
    np.testing.assert_allclose(brdf(hapke(roughness_deg=theta_deg), i, e, 100.0), brdf(hapke(), i, e, 100.0),
                               rtol=max(brdf.rtol, 1e-6))


def test_too_much_roughness_is_warned_of_then_refused():
    with pytest.warns(UserWarning, match="roughness_deg > 60"):
        hapke(roughness_deg=61.0)
    for bad in (90.0, -1.0, np.nan):
        with pytest.raises(ConfigError, match="roughness_deg"):
            hapke(roughness_deg=bad)
