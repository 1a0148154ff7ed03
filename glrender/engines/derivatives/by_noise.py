"""The error tolerance of a frame whose pose errs by less than the camera's noise lets be known."""

from __future__ import annotations

from typing import Any

import numpy as np

LOOSE = 0.05
"""Tolerance [1] of the frame of which the information is taken: its deviations hold to some percent."""
_PLACE = {"spacecraft": (0, 1, 2)}


def tolerance_of_sigmas(image: Any, sigmas: float) -> float:
    """The RMS error [1], before the camera, that moves no estimate of the place by more than so many deviations.

    The pixels' errors are taken as independent, of one size over the lit ones. The attitude is known, the gain and the
    level are not; infinite where nothing can be known.

    Parameters
    ----------
    image : Image
        With derivatives by ``spacecraft``, of a camera with a model.
    sigmas : float [1]
    """
    known = image.information(components=_PLACE)
    light, deviations = image.irradiance_W_m2, np.sqrt(np.diag(known.covariance))
    is_lit = light > 0.0
    if not is_lit.any():
        return np.inf
    moves = np.sqrt(np.square(known.fit.pixel_weights()[:, is_lit]).sum(axis=1))
    worst = float((moves / deviations).max()) * float(light[is_lit].mean())
    return sigmas / worst if worst > 0.0 else np.inf
