"""Watts and photons: bands of the solar spectrum, distance, the chain to electrons."""

from __future__ import annotations

import numpy as np
import pytest
from glrender.base.constants import AU_M, PLANCK_J_S, SPEED_OF_LIGHT_M_S
from glrender.base.errors import ConfigError
from glrender.brdf import Lambert, LommelSeeliger
from glrender.scene.solar_irradiance import Band, radiance, solar_irradiance, solar_spectrum, sphere_irradiance


@pytest.mark.parametrize("low_nm, high_nm, watts, photons", [
    (400, 700, 530.105, 1.45384e21), (400, 1000, 841.264, 2.76047e21), (350, 1000, 893.920, 2.86006e21),
    (500, 600, 184.878, 5.11473e20), (545, 555, 18.727, 5.18512e19), (300, 1100, 999.519, 3.27511e21)])
def test_bands_of_e490(low_nm, high_nm, watts, photons):
    """photometry.md section 1.6, integrated with sbpy's copy of the spectrum: 1e-4."""
    band = Band.box(low_nm, high_nm)
    np.testing.assert_allclose(band.irradiance_1au_W_m2, watts, rtol=1e-4)
    np.testing.assert_allclose(band.photon_irradiance_1au_m2_s, photons, rtol=1e-4)


def test_the_whole_spectrum_is_the_solar_constant():
    """E490's own total, 1366.1 W/m2, and E(550 nm) = 1.8785 W/m2/nm."""
    wavelength_nm, irradiance = solar_spectrum()
    np.testing.assert_allclose(Band.box(*wavelength_nm[[0, -1]]).irradiance_1au_W_m2, 1366.09, rtol=2e-5)
    np.testing.assert_allclose(np.interp(550.0, wavelength_nm, irradiance), 1.8785, rtol=1e-4)
    assert (irradiance >= 0.0).all() and (np.diff(wavelength_nm) > 0.0).all()


def test_photons_of_the_middle_wavelength_are_wrong_by_the_published_amount():
    """The integral, not E lam/(hc) at mid-band: +0.95 % (400-700), +6.2 % (350-1000), +7.5 % (300-1100)."""
    for low, high, excess in ((400, 700, 0.0095), (350, 1000, 0.062), (300, 1100, 0.075)):
        band = Band.box(low, high)
        # Watts to photons by the mid wavelength gives too few or too many.
        naive = band.irradiance_1au_W_m2 * 0.5e-9 * (low + high) / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)
        np.testing.assert_allclose(naive / band.photon_irradiance_1au_m2_s - 1.0, excess, atol=6e-4)


def test_a_filter_curve_weighs_the_spectrum():
    """Half transmission is half the light; refining a straight line changes nothing."""
    half = Band(wavelength_nm=[400, 700], transmission=[0.5, 0.5])
    np.testing.assert_allclose(half.irradiance_1au_W_m2, 0.5 * 530.105, rtol=1e-4)
    triangle = Band(wavelength_nm=[400, 550, 700], transmission=[0, 1, 0])
    x = np.linspace(400, 700, 3001)
    fine = Band(wavelength_nm=x, transmission=1 - np.abs(x - 550) / 150)
    np.testing.assert_allclose(triangle.irradiance_1au_W_m2, fine.irradiance_1au_W_m2, rtol=1e-9)
    np.testing.assert_allclose(triangle.photons_per_joule, fine.photons_per_joule, rtol=1e-9)
    assert 0.45 < triangle.irradiance_1au_W_m2 / 530.105 < 0.55


@pytest.mark.parametrize("curve, path", [
    (([400], [1]), "wavelength_nm"), (([700, 400], [1, 1]), "wavelength_nm"),
    (([50, 400], [1, 1]), "wavelength_nm"),
    (([400, 700], [1, 1, 1]), "transmission"), (([400, 700], [0, 80]), "transmission"),
    (([400, 700], [0, np.nan]), "transmission"), (([400, 700], "ab"), "transmission")])
def test_a_bad_filter_is_refused_by_name(curve, path):
    with pytest.raises(ConfigError) as caught:
        Band(wavelength_nm=curve[0], transmission=curve[1])
    assert caught.value.path == path


def test_distance():
    """Inverse square; the total solar irradiance is the special case of all wavelengths."""
    np.testing.assert_allclose(solar_irradiance(AU_M), 1360.8)
    np.testing.assert_allclose(solar_irradiance(2 * AU_M, 100.0), 25.0)
    with pytest.raises(ConfigError):
        solar_irradiance(0.0)


def test_the_chain_to_electrons():
    """photometry.md section 1.6's worked value: I/F 0.02 at 1.2 au, 450-950 nm, to 7.54e5 electrons."""
    band = Band.box(450.0, 950.0)
    sun = solar_irradiance(1.2 * AU_M, band.irradiance_1au_W_m2)
    light = radiance(0.02, sun)
    np.testing.assert_allclose(light, 3.1619, rtol=2e-4)
    aperture = light * (1e-4) ** 2
    np.testing.assert_allclose(aperture, 3.1619e-8, rtol=2e-4)
    watts = aperture * np.pi / 4 * 0.0151**2 * 0.8
    np.testing.assert_allclose(watts, 4.530e-12, rtol=5e-4)
    np.testing.assert_allclose(watts * 0.1 * 0.5 * band.photons_per_joule, 7.54e5, rtol=1e-3)


def test_an_unresolved_sphere():
    """F (R / range)^2 p Phi(g): 2/3 A at full phase, 2 A/(3 pi) at quarter; Lommel-Seeliger w/8."""
    arguments = {"radius_m": 100.0, "range_m": 1e5, "irradiance_W_m2": 1000.0}
    law = Lambert(normal_albedo=0.3)
    np.testing.assert_allclose(sphere_irradiance(law, 0.0, **arguments), 1e-3 * 0.2, rtol=1e-9)
    np.testing.assert_allclose(sphere_irradiance(law, np.pi / 2, **arguments), 1e-3 * 0.2 / np.pi, rtol=1e-9)
    seeliger = LommelSeeliger(single_scattering_albedo=0.4)
    np.testing.assert_allclose(sphere_irradiance(seeliger, 0.0, **arguments), 1e-3 * 0.05, rtol=1e-9)
