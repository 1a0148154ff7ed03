"""Where formulas of photometry fail: geometry at the limb and at opposition, parameters at their ends.

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
from published_laws import hapke

# ---- Geometry where the angle form fails (photometry.md section 4.2).

ROUGH = {"b": 0.3, "c": 0.5, "shoe_amplitude": 1.0, "shoe_width": 0.01, "roughness_deg": 20.0}
ROUGH_TRUTH = {"w": 0.3, "b": 0.3, "c": 0.5, "b_s0": 1.0, "h_s": 0.01, "theta_deg": 20.0}


def check_against_truth(brdf, i, e, psi, rtol=1e-5):
    i, e, psi = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, float)) for x in (i, e, psi)))
    radians = [np.radians(x) for x in (i, e, psi)]
    expected = truth.hapke(truth.Angles(*radians, truth.phase(*radians)), **ROUGH_TRUTH)
    got = brdf(hapke(**ROUGH), i, e, psi)
    np.testing.assert_allclose(got, expected, rtol=rtol)
    return got


def test_sun_at_the_normal(brdf):
    """i = 0: psi is 0/0 and cot infinite; psi means nothing, E1 = E2 = 0, eta = chi."""
    got = check_against_truth(brdf, 0.0, [20.0, 60.0, 85.0], 77.0)
    np.testing.assert_allclose(got, brdf(hapke(**ROUGH), 0.0, np.array([20.0, 60.0, 85.0]), 0.0), rtol=1e-6)


def test_camera_at_the_normal(brdf):
    check_against_truth(brdf, [20.0, 60.0, 85.0], 0.0, 77.0)


def test_opposition_exactly(brdf):
    """g = 0 with s = v to the last bit: SHOE is 1 + B0, no NaN."""
    i = np.array([0.0, 10.0, 45.0, 80.0])
    check_against_truth(brdf, i, i, 0.0)


def test_beside_opposition(evaluate):
    """g = 0.001 to 0.1 deg, width 0.01: acos of a float32 dot is off by up to 1.2 % here."""
    g = np.array([0.001, 0.005, 0.02, 0.05, 0.1])
    s, v, n = (x.astype(np.float32) for x in truth.vectors(np.radians(40.0), np.radians(40.0 + g), 0.0))
    a = truth.angles(s, v, n)
    np.testing.assert_allclose(evaluate(hapke(**ROUGH), s, v, n), truth.hapke(a, **ROUGH_TRUTH), rtol=1e-5)


@pytest.mark.parametrize("psi", [0.0, 180.0, 180.0 - 1e-5])
def test_azimuth_of_0_and_pi(psi, brdf):
    """In the principal plane acos(psi) leaves its range in 36 % of samples; f(pi) = 0."""
    check_against_truth(brdf, [10.0, 30.0, 60.0, 80.0], [70.0, 30.0, 50.0, 40.0], psi)


def test_incidence_equal_to_emission_is_no_seam():
    """The two branches of 1984 meet: 1e-7 deg to either side changes r by less than 1e-8."""
    i = 50.0 + np.array([-1e-7, 0.0, 1e-7])
    s, v, n = truth.vectors(np.radians(i), np.radians(50.0), np.radians(110.0))
    value = hapke(**ROUGH).brdf(s, v, n)
    np.testing.assert_allclose(value, value[1], rtol=1e-8)


def test_grazing_incidence_goes_dark(brdf):
    """I/F = pi f mu0 -> 0 with mu0, from both sides of the terminator."""
    i = np.array([89.0, 89.9, 89.99])
    radf = np.pi * check_against_truth(brdf, i, 30.0, 60.0, rtol=5e-4) * np.cos(np.radians(i))
    assert (np.diff(radf) < 0.0).all() and radf[-1] < 1e-4
    assert brdf(hapke(**ROUGH), 90.5, 30.0, 60.0) == 0.0


def test_no_black_limb(brdf):
    """e -> 90: r is finite, and 0 only where the surface is turned away."""
    e = np.array([89.0, 89.9, 89.99])
    assert (check_against_truth(brdf, 30.0, e, 60.0, rtol=5e-4) > 1e-3).all()
    assert brdf(hapke(**ROUGH), 30.0, 90.5, 60.0) == 0.0


@pytest.mark.parametrize("law", [
    Lambert(normal_albedo=1.0), LommelSeeliger(single_scattering_albedo=1.0),
    LunarLambert(normal_albedo=1.0, weight="gaskell"),
    Minnaert(normal_albedo=1.0, exponent=0.5), Akimov(normal_albedo=1.0), hapke(**ROUGH), hapke(),
    OrenNayar(normal_albedo=1.0, roughness_deg=30.0), Rolo(surge=(0.1, 0.1), coefficients=(0.1,))],
    ids=lambda law: type(law).__name__)
def test_double_grazing_is_finite_and_dark(law, brdf):
    """mu0 + mu = 0 is 0/0: I/F is finite towards it and 0 at it."""
    for i, e in ((90.0 - 1e-6, 90.0 - 1e-6), (90.0, 90.0), (90.0 - 1e-7, 30.0)):
        for psi in (0.0, 90.0, 180.0):
            value = brdf(law, i, e, psi) * np.cos(np.radians(i))
            assert np.isfinite(value).all() and 0.0 <= value < 1.0


def test_the_direction_away_from_both_sides_is_dark(brdf):
    """Behind: exactly 0, not -0 and not negative."""
    for i, e in ((120.0, 30.0), (30.0, 120.0), (120.0, 130.0)):
        for law in (hapke(**ROUGH), Lambert(normal_albedo=1.0), LunarLambert(normal_albedo=1.0)):
            value = brdf(law, i, e, 40.0)
            assert value == 0.0 and not np.signbit(value)


# ---- Parameters where terms fail (photometry.md section 4.2).


def test_shoe_of_width_0_is_off(brdf):
    """A delta at g = 0, which no image sees: eradiate's default is NaN."""
    np.testing.assert_array_equal(brdf(hapke(shoe_amplitude=2.0, shoe_width=0.0), 30.0, 30.0),
                                  brdf(hapke(), 30.0, 30.0))


def test_shoe_at_half_its_height(brdf):
    """1 + B0 at g = 0, 1 + B0/2 where tan(g/2) = h; only on single scattering (w -> 0 here)."""
    dark = {"single_scattering_albedo": 1e-7}
    law, plain = hapke(shoe_amplitude=2.0, shoe_width=0.05, **dark), hapke(**dark)
    half = np.degrees(2 * np.arctan(0.05))
    for e, factor in ((30.0, 3.0), (30.0 + half, 2.0)):
        np.testing.assert_allclose(brdf(law, 30.0, e) / brdf(plain, 30.0, e), factor, rtol=2e-6)


@pytest.mark.parametrize("z, factor", [(0.0, 1.0), (1e-4, 0.9997500), (0.05, 0.8960055), (1.0, 0.2040151),
                                       (10.0, 0.004545417)])
def test_cboe_at_given_widths(z, factor, brdf):
    """[1 + (1 - exp(-z))/z] / (2 (1 + z)^2), computed by hand; not 1 - exp(-z)/z, and 1 at z = 0."""
    width = 0.02
    e = 30.0 + np.degrees(2 * np.arctan(z * width))
    law = hapke(cboe_amplitude=0.8, cboe_width=width)
    ratio = brdf(law, 30.0, e) / brdf(hapke(), 30.0, e)
    expected = (1 + (1 - np.exp(-z)) / z) / (2 * (1 + z) ** 2) if z > 0 else 1.0
    np.testing.assert_allclose(expected, factor, rtol=3e-4)
    # The shader's vectors are rounded to float32: z = 1e-4 of a width of 0.02 is 0.0002 deg.
    np.testing.assert_allclose(ratio, 1 + 0.8 * expected, rtol=2e-5)


def test_single_scattering_albedo_of_0_and_1(brdf):
    """0 is black; 1 is white: H02 within 0.77 % of Chandrasekhar twice."""
    assert brdf(hapke(single_scattering_albedo=0.0), 30.0, 40.0) == 0.0
    h = truth.h_exact(0.5, 1.0 - 1e-12)[0]
    np.testing.assert_allclose(brdf(hapke(single_scattering_albedo=1.0), 60.0, 60.0, 90.0), h * h / (4 * np.pi),
                               rtol=0.016)


@pytest.mark.parametrize("parameters, path", [
    ({"single_scattering_albedo": 1.1}, "single_scattering_albedo"), ({"single_scattering_albedo": np.nan},
                                                                     "single_scattering_albedo"),
    ({"b": 1.0}, "b"), ({"b": -0.3}, "b"), ({"c": np.inf}, "c"), ({"shoe_amplitude": -1.0}, "shoe_amplitude"),
    ({"cboe_width": -1.0}, "cboe_width"), ({"filling_factor": 0.76}, "filling_factor"),
    ({"h_function": "1993"}, "h_function"), ({"multiple_scattering": "none"}, "multiple_scattering")])
def test_bad_parameters_are_refused_by_name(parameters, path):
    with pytest.raises(ConfigError) as caught:
        hapke(**parameters)
    assert caught.value.path == path


def test_a_phase_function_that_turns_negative_gives_no_negative_light(brdf):
    """c = 1.1 of Mercury's published set, far out at large phases."""
    with pytest.warns(UserWarning, match="c"):
        law = Hapke(single_scattering_albedo=0.001, b=0.9, c=1.3)
    assert brdf(law, 89.0, 89.0, 180.0) == 0.0


def test_a_held_weight_keeps_the_sphere_lit(brdf):
    """McEwen's cubic, clamped, turns a whole sphere black beyond 132.67 deg; held at -0.05 it does not."""
    law = LunarLambert(normal_albedo=0.2)
    with pytest.warns(UserWarning, match="beyond the phase of 10"):
        assert disc_albedo(law, np.radians(140.0)) > 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert brdf(law, 60.0, 80.0, 180.0) > 0.0
        np.testing.assert_allclose(law.weight_at(np.array([120.0, 180.0])), -0.05, atol=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        disc_albedo(law, np.radians(100.0))


def test_a_forgotten_leading_1_is_warned_of():
    """SISPO's Bennu and Itokawa lists start at -7.4e-3: L(0) = -0.0074, nearly Lambert."""
    with pytest.warns(UserWarning, match="constant term"):
        LunarLambert(normal_albedo=0.2, weight=(-7.4364e-03, 4.0259e-05, -2.2650e-06, 2.1524e-08, -5.7964e-11))


@pytest.mark.parametrize("make, path", [
    (lambda: LunarLambert(normal_albedo=0.2, weight="lunar"), "weight"),
    (lambda: LunarLambert(normal_albedo=0.2, weight=()), "weight"),
    (lambda: LunarLambert(normal_albedo=0.2, weight=(1.0, np.nan)), "weight[1]"),
    (lambda: LunarLambert(normal_albedo=0.2, weight={"phase_deg": [0.0, 10.0]}), "weight.value"),
    (lambda: LunarLambert(normal_albedo=0.2, weight={"phase_deg": [10.0, 0.0], "value": [1.0, 1.0]}),
     "weight.phase_deg"),
    (lambda: LommelSeeliger(single_scattering_albedo=0.2, phase_function={"phase_deg": [0, 9], "value": [1, 0]}),
     "phase_function.value"),
    (lambda: Akimov(normal_albedo=0.2, phase_function=(1.0,) * 8), "phase_function"),
    (lambda: LommelSeeliger(single_scattering_albedo=0.2, phase_function=(5.0,)), "phase_function"),
    (lambda: Akimov(normal_albedo=0.2, phase_function=(50.0,)), "phase_function"),
    (lambda: Akimov(normal_albedo=0.2, phase_function={"phase_deg": [0, 9], "value": [1, 1e300]}),
     "phase_function.value[1]"),
    (lambda: LunarLambert(normal_albedo=0.2, weight=(1.0, 50.0)), "weight"),
    (lambda: LunarLambert(normal_albedo=0.2, weight={"phase_deg": [0, 9], "value": [1, -1e4]}), "weight"),
    (lambda: LunarLambert(normal_albedo=0.2, weight=(1.0, 1e300)), "weight[1]"),
    (lambda: Minnaert(normal_albedo=0.2, exponent=-1.0), "exponent"),
    (lambda: Rolo(surge=(1.0, 1.0), coefficients=(0.1, 1e5)), "coefficients"),
    (lambda: Rolo(surge=(1.0, 1e300), coefficients=(0.1,)), "surge[1]"),
    (lambda: hapke(c=1e300), "c"), (lambda: hapke(shoe_amplitude=1e300), "shoe_amplitude"),
    (lambda: hapke(shoe_width=1e-46), "shoe_width"), (lambda: hapke(cboe_width=1e300), "cboe_width"),
    (lambda: hapke(b=0.9999), "b"), (lambda: hapke(b=0.98, c=1.0, multiple_scattering="anisotropic"), "b"),
    (lambda: hapke(roughness_deg=75.1), "roughness_deg"),
    (lambda: Rolo(surge=(1.0,), coefficients=(1.0,)), "surge"),
    (lambda: Rolo(surge=(1.0, 1.0), coefficients=()), "coefficients"),
    (lambda: OrenNayar(normal_albedo=0.2, roughness_deg=90.0), "roughness_deg"),
    (lambda: Lambert(normal_albedo=True), "normal_albedo")])
def test_bad_parameters_of_the_other_laws_are_refused_by_name(make, path):
    with pytest.raises(ConfigError) as caught:
        make()
    assert caught.value.path == path
