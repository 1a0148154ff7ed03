"""The mean charge of a frame, how it changes with the light, and how it scatters: of estimators, not of frames."""

from __future__ import annotations

import numpy as np

from .camera import CameraModel
from .detector import Detector
from .light import light_on_frame

# Variance of rounding to whole numbers [DN2].
_ROUNDING = 1.0 / 12.0


def mean_electrons(model: CameraModel, irradiance_W_m2: np.ndarray, exposure_s: float, *,
                   relative_illumination: np.ndarray | None = None, margin_px: int = 0) -> np.ndarray:
    """Photo-electrons (H, W) float32 that a frame has in the mean, with stray light and smear.

    Without the pixels' own pattern, which is none of the light's, and without full well and dark current.

    Parameters
    ----------
    model : CameraModel
    irradiance_W_m2 : (H, W) float32 [W/m2], >= 0
    exposure_s : float [s]
    relative_illumination, margin_px
        As of `CameraModel.expose`.

    Raises
    ------
    ConfigError
    """
    light = light_on_frame(model.optics, irradiance_W_m2, relative_illumination=relative_illumination,
                           margin_px=margin_px)
    electrons = light.signal * np.float32(model.optics.aperture_area_m2 * model.electrons_per_joule * exposure_s)
    smear = model.detector.frame_transfer_row_s / exposure_s
    return electrons + np.float32(smear) * electrons.sum(axis=0) if smear > 0.0 else electrons


def changed_electrons(model: CameraModel, changes_W_m2: np.ndarray, exposure_s: float, *,
                      relative_illumination: np.ndarray | None = None, margin_px: int = 0) -> np.ndarray:
    """Changes (K, H, W) float32 [e-] of the mean charge by changes of the irradiance of either sign.

    Optics are linear: what rises and what falls are spread apart.

    Parameters
    ----------
    model, exposure_s, relative_illumination, margin_px
        As of `mean_electrons`.
    changes_W_m2 : (K, H, W) float32 [W/m2]

    Raises
    ------
    ConfigError
    """
    options = {"relative_illumination": relative_illumination, "margin_px": margin_px}
    return np.stack([np.subtract(*(mean_electrons(model, np.maximum(sign * each, 0.0), exposure_s, **options)
                                   for sign in (1.0, -1.0))) for each in changes_W_m2])


def gathered_weights(model: CameraModel, weights: np.ndarray, exposure_s: float, *,
                     relative_illumination: np.ndarray | None = None) -> np.ndarray:
    """Weights (K, H, W) float64 of an irradiance image by those of its electrons (K, H, W): the sums are the same.

    Optics turned by half a turn gather what they spread; where their point spread function varies over the frame, and
    for ghosts, that holds of those which are symmetric about the axis.

    Parameters
    ----------
    model, exposure_s, relative_illumination
        As of `mean_electrons`.

    Raises
    ------
    ConfigError
    """
    gathered = []
    for each in weights:
        # Float32 of all sizes.
        size = float(np.abs(each).max()) or 1.0
        turned = (each[::-1, ::-1] / size).astype(np.float32)
        gathered.append(size * changed_electrons(model, turned[None], exposure_s)[0][::-1, ::-1].astype(np.float64))
    found = np.array(gathered)
    return found if relative_illumination is None else found * relative_illumination


def scatter_electrons(detector: Detector, electrons: np.ndarray, exposure_s: float) -> np.ndarray:
    """Variance (H, W) [e-2] of the charge that is read out of pixels whose mean is known.

    Of photons, dark current, the pixels' own response, dark current and offset, read-out and rounding.
    """
    dark = detector.dark_rate_electrons_per_s * exposure_s
    fixed = (dark + (detector.dark_current_nonuniformity * dark) ** 2 + detector.read_noise_electrons**2
             + detector.dark_signal_nonuniformity_electrons**2 + _ROUNDING / detector.gain_DN_per_electron**2)
    return electrons + (detector.photo_response_nonuniformity * electrons) ** 2 + fixed


def are_full(detector: Detector, electrons: np.ndarray, exposure_s: float) -> np.ndarray:
    """Pixels (H, W) bool that a mean charge fills: to the full well, or the largest digital number."""
    charge = electrons + detector.dark_rate_electrons_per_s * exposure_s
    largest = (largest_ideal_DN(detector) - detector.offset_DN) / detector.gain_DN_per_electron
    return charge >= min(detector.full_well_electrons, largest)


def ideal_DN(detector: Detector, dn: np.ndarray) -> np.ndarray:
    """Digital numbers (...) float64 [DN] as a linear detector would have read them, by the table of a bent one."""
    if detector.nonlinearity_DN is None:
        return np.asarray(dn, np.float64)
    ideal, actual = np.array(detector.nonlinearity_DN).T
    return np.interp(dn, actual, ideal)


def largest_ideal_DN(detector: Detector) -> float:
    """The same [DN] of the largest number that the detector reads."""
    pairs = detector.nonlinearity_DN
    return float(ideal_DN(detector, np.array(min(detector.max_DN, np.inf if pairs is None else np.rint(pairs[-1][1])))))
