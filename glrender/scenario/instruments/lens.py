"""Lenses of CSM sensor models: from a place in the image to the ideal one, both in mm on the focal plane."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from glrender_camera import BrownConrady
from glrender_camera.validate import finite, known_keys, one_of

from ...base.errors import ConfigError
from ..checks import numbers

Lens = Callable[[np.ndarray], np.ndarray]
"""Takes distorted places (..., 2) [mm] from the boresight to undistorted ones."""
_LO_KEYS = ("perspective_x", "perspective_y", "center_point_x", "center_point_y")
# Lenses near unity halve the error at least at each step.
_STEPS = 100


def lens_of(model: str, coefficients: Any, focal_length_mm: float) -> Lens:
    """The lens of a distortion model of an ISD or an instrument kernel.

    Parameters
    ----------
    model : str
        ``radial`` (k0, k1, k2): u = d (1 - k0 - k1 |d|^2 - k2 |d|^4), as OD_K of NAIF's and ISIS's kernels; of one
        number k alone u = d (1 + k |d|^2), as K1 of Galileo's and Voyager's.
        ``cahvor`` (k0, k1, k2, x0, y0): the same about a place off the boresight.
        ``dawnfc`` (k): d = u (1 + k |u|^2), as RAD_DIST_COEFF of Dawn's.
        ``radtan`` (k1, k2, p1, p2, k3): OpenCV's, in units of the focal length.
        ``ocams`` (k0, k1, k2, k3, k4, x0, y0): d = u + (u - c) (k0 + k1 s + ... + k4 s^4), s = |u - c|, of OSIRIS-REx.
        ``lunarorbiter`` {perspective_x, perspective_y, center_point_x, center_point_y, coefficients (k0, k1, k2)}:
        p = d (1 + perspective . d), u = p - (p - c) (k0 + k1 s^2 + k2 s^4), s = |p - c|.
        ``transverse`` {x: 10, y: 10}: d is a cubic polynomial of u, in 1, x, y, x2, xy, y2, x3, x2y, xy2, y3.
    coefficients : list of float, or table of such
        Coefficients for lengths in mm.
    focal_length_mm : float [mm]

    Raises
    ------
    ConfigError
        A model of another kind of sensor, a number of coefficients that is not the model's.

    Source: usgscsm, Distortion.cpp, `removeDistortion` and `applyDistortion`; ISIS, OsirisRexDistortionMap.cpp,
    RadialDistortionMap.cpp, LoHighDistortionMap.cpp.
    """
    return _LENSES[one_of("model", model, _LENSES)](coefficients, focal_length_mm)


def _radial(coefficients: Any, focal_length_mm: float) -> Lens:
    if np.shape(coefficients) == (1,):
        coefficients = [0.0, -float(_listed(coefficients, 1)[0]), 0.0]
    return _cahvor([*_listed(coefficients, 3), 0.0, 0.0], focal_length_mm)


def _cahvor(coefficients: Any, focal_length_mm: float) -> Lens:
    k0, k1, k2, *centre = _listed(coefficients, 5)

    def ideal(distorted: np.ndarray) -> np.ndarray:
        from_centre = distorted - centre
        r2 = np.sum(from_centre**2, axis=-1, keepdims=True)
        return from_centre * (1.0 - k0 - r2 * (k1 + r2 * k2)) + centre
    return ideal


def _lunarorbiter(coefficients: Any, focal_length_mm: float) -> Lens:
    known_keys("", coefficients, (*_LO_KEYS, "coefficients"), required=_LO_KEYS)
    px, py, x0, y0 = (finite(key, coefficients[key]) for key in _LO_KEYS)
    k = numbers("coefficients", coefficients.get("coefficients", [0.0]))
    if k.ndim != 1 or not 1 <= len(k) <= 3:
        raise ConfigError("coefficients", "must be one to three numbers", coefficients["coefficients"])

    def ideal(distorted: np.ndarray) -> np.ndarray:
        seen = distorted * (1.0 + distorted @ [[px], [py]])
        from_centre = seen - [x0, y0]
        r2 = np.sum(from_centre**2, axis=-1, keepdims=True)
        return seen - from_centre * np.polynomial.polynomial.polyval(r2, k)
    return ideal


def _dawnfc(coefficients: Any, focal_length_mm: float) -> Lens:
    (k,) = _listed(coefficients, 1)
    return _brown_conrady(BrownConrady(k1=k * focal_length_mm**2), focal_length_mm)


def _radtan(coefficients: Any, focal_length_mm: float) -> Lens:
    return _brown_conrady(BrownConrady.from_opencv(_listed(coefficients, 5)), focal_length_mm)


def _brown_conrady(distortion: BrownConrady, focal_length_mm: float) -> Lens:
    return lambda distorted: distortion.undistort(distorted / focal_length_mm) * focal_length_mm


def _transverse(coefficients: Any, focal_length_mm: float) -> Lens:
    if not isinstance(coefficients, Mapping) or set(coefficients) != {"x", "y"}:
        raise ConfigError("coefficients", "must be a table of x and y, ten numbers each", coefficients)
    rows = np.array([_listed(coefficients[axis], 10) for axis in "xy"])

    def distort(ideal: np.ndarray) -> np.ndarray:
        x, y = ideal[..., 0], ideal[..., 1]
        powers = [np.ones_like(x), x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3]
        return np.stack(powers, axis=-1) @ rows.T

    return _inverse(distort, coefficients, focal_length_mm)


def _ocams(coefficients: Any, focal_length_mm: float) -> Lens:
    *k, x0, y0 = _listed(coefficients, 7)

    def distort(ideal: np.ndarray) -> np.ndarray:
        from_centre = ideal - [x0, y0]
        return ideal + from_centre * np.polynomial.polynomial.polyval(
            np.linalg.norm(from_centre, axis=-1, keepdims=True), k)
    return _inverse(distort, coefficients, focal_length_mm)


def _inverse(distort: Lens, coefficients: Any, focal_length_mm: float) -> Lens:
    """The inverse of a lens near unity, by iteration."""
    def ideal(distorted: np.ndarray) -> np.ndarray:
        found = distorted
        for _ in range(_STEPS):
            step = distorted - distort(found)
            found = found + step
            if np.abs(step).max() <= 1e-13 * focal_length_mm:
                return found
        raise ConfigError("coefficients", "leave no ideal place: they are too far from unity", coefficients)
    return ideal


def _listed(coefficients: Any, count: int) -> list[float]:
    array = numbers("coefficients", coefficients)
    if array.shape != (count,):
        raise ConfigError("coefficients", f"must be {count} numbers", coefficients)
    return array.tolist()


_LENSES: dict[str, Callable[[Any, float], Lens]] = {
    "radial": _radial, "transverse": _transverse, "dawnfc": _dawnfc, "radtan": _radtan, "cahvor": _cahvor,
    "ocams": _ocams, "lunarorbiter": _lunarorbiter}
