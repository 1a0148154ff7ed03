"""The camera model against photometry.md's worked values, closed forms and counting statistics."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import CameraModel, Detector, Optics, spectrum

SIMPLE = dict(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12,
              offset_DN=50.0)


def camera_model(exposure_s=0.1, optics=None, **detector):
    return CameraModel(optics=Optics(aperture_diameter_m=0.0151, transmission=0.8, **(optics or {})),
                       detector=Detector(**(SIMPLE | detector)), exposure_s=exposure_s)


def test_electrons_of_the_worked_example():
    """photometry.md 1.6: 3.1619e-8 W/m2, D 15.1 mm, tau 0.8, 0.1 s, QE 0.5: 7.54e5 e-; black body 1 %."""
    model = camera_model(optics=dict(band_nm=(450.0, 950.0)))
    electrons = 3.1619e-8 * model.optics.aperture_area_m2 * 0.1 * model.electrons_per_joule
    np.testing.assert_allclose(electrons, 7.54e5, rtol=0.01)


@pytest.mark.parametrize("band_nm, watts, photons", [
    ((400.0, 700.0), 530.105, 1.45384e21), ((400.0, 1000.0), 841.264, 2.76047e21),
    ((350.0, 1000.0), 893.920, 2.86006e21), ((500.0, 600.0), 184.878, 5.11473e20),
    ((300.0, 1100.0), 999.519, 3.27511e21)])
def test_photons_per_joule_against_the_solar_spectrum(band_nm, watts, photons):
    """ASTM E490-00a integrals (photometry.md 1.6); a black body stands in for the lines: 1 %."""
    np.testing.assert_allclose(spectrum.electrons_per_joule(band_nm, 1.0, 1.0), photons / watts, rtol=0.01)
