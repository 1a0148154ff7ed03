"""Camera models and frames for their tests."""

from __future__ import annotations

import numpy as np
from glrender_camera import CameraModel, Detector, Optics

SIMPLE = dict(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12,
              offset_DN=50.0)
BUSY = dict(hot_pixel_fraction=1e-3, hot_pixel_electrons_per_s=500.0, frame_transfer_row_s=1e-6,
            nonlinearity_DN=((0.0, 0.0), (4095.0, 4090.0)), read_noise_electrons=10.0,
            dark_current_electrons_per_s=5.0, photo_response_nonuniformity=0.01,
            dark_signal_nonuniformity_electrons=3.0, dark_current_nonuniformity=0.1,
            cosmic_ray_hits_per_px_s=1e-3, dead_pixel_fraction=0.02)


def camera_model(exposure_s=0.1, optics=None, **detector):
    return CameraModel(optics=Optics(aperture_diameter_m=0.0151, transmission=0.8, **(optics or {})),
                       detector=Detector(**(SIMPLE | detector)), exposure_s=exposure_s)


def irradiance_of(electrons, model):
    """Irradiance [W/m2] that gives so many mean electrons in the model's exposure."""
    return electrons / (model.optics.aperture_area_m2 * model.electrons_per_joule * model.exposure_s)


def flat(model, electrons, shape=(256, 256)):
    return np.full(shape, irradiance_of(electrons, model), np.float32)


def disc(shape=(300, 400), peak_electrons=5000.0, model=None):
    y, x = np.indices(shape)
    height = np.clip(1.0 - ((x - 180.5) ** 2 + (y - 140.2) ** 2) / 60.0**2, 0.0, None) ** 0.5
    return (irradiance_of(peak_electrons, model) * height).astype(np.float32)
