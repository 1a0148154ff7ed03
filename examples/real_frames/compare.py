"""How like a real image ours is: correlation, and the residual after a gain and an offset."""

from __future__ import annotations

import numpy as np


def ncc(a: np.ndarray, b: np.ndarray) -> float:
    """Normalised cross-correlation of whole frames."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def fitted(ours: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Ours in the units of the real one: gain and offset by least squares."""
    gain, offset = np.polyfit(ours.ravel(), real.ravel(), 1)
    return gain * ours + offset


def residual_percent(ours: np.ndarray, real: np.ndarray) -> np.ndarray:
    """Real minus ours after `fitted`, in percent of the 99.9th percentile of the real one."""
    return 100.0 * (real - fitted(ours, real)) / np.quantile(real, 0.999)
