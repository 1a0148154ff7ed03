"""Checks of numbers that a scenario is made of."""

from __future__ import annotations

import numpy as np
from glrender_camera.validate import MAX_DISTANCE_M, finite, positive, vector, within

from ..base.constants import SPEED_OF_LIGHT_M_S
from ..base.errors import ConfigError

MAX_DURATION_S = 1e11
"""Three thousand years; a longer time is a mistake of units."""
MAX_RATE_RAD_S = 1e3
"""The largest rate of a `Pose` [rad/s]."""
MAX_GM_M3_S2 = 1e30
"""More than a galaxy's."""


def numbers(name: str, value: object) -> np.ndarray:
    """An array of finite float64 numbers, of any shape.

    Raises
    ------
    ConfigError
        A value that is not numbers, not rectangular, or not finite.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise TypeError
    except (TypeError, ValueError):
        raise ConfigError(name, "must be numbers", value) from None
    if not np.isfinite(array).all():
        raise ConfigError(name, "must be finite", value)
    return array.astype(np.float64)


def at_most(name: str, value: object, most: float) -> float:
    """A number > 0 up to a limit."""
    number = positive(name, value)
    if not number <= most:
        raise ConfigError(name, f"must be at most {most:g}", value)
    return number


def duration(name: str, value: object) -> float:
    """A duration [s], > 0."""
    return at_most(name, value, MAX_DURATION_S)


def length(name: str, value: object) -> float:
    """A length [m], from a millimetre to a light year."""
    return within(name, positive(name, value), 1e-3, MAX_DISTANCE_M)


def speed(name: str, value: object) -> float:
    """A speed [m/s], > 0, below that of light."""
    return at_most(name, value, SPEED_OF_LIGHT_M_S)


def gm(name: str, value: object) -> float:
    """A gravitational parameter [m3/s2], > 0."""
    return at_most(name, value, MAX_GM_M3_S2)


def velocity(name: str, value: object) -> np.ndarray:
    """A velocity (3,) [m/s], below that of light."""
    array = vector(name, value)
    if not (np.abs(array) < SPEED_OF_LIGHT_M_S).all():
        raise ConfigError(name, "must be below the speed of light", array.tolist())
    return array


def rates(name: str, value: object) -> np.ndarray:
    """An angular velocity (3,) [rad/s], each component within 1e3."""
    array = vector(name, value)
    if not (np.abs(array) <= MAX_RATE_RAD_S).all():
        raise ConfigError(name, f"must be within {MAX_RATE_RAD_S:g} rad/s", array.tolist())
    return array


def unit(name: str, value: object) -> np.ndarray:
    """A direction (3,) of any length but zero, made a unit vector."""
    array = vector(name, value)
    largest = float(np.abs(array).max())
    if not largest > 0.0:
        raise ConfigError(name, "must not be zero", array.tolist())
    # Scaled first: squares of huge or tiny numbers leave float64.
    array = array / largest
    return array / np.linalg.norm(array)


def angle_deg(name: str, value: object) -> float:
    """An angle [deg] within a thousand turns."""
    number = finite(name, value)
    if not abs(number) <= 360e3:
        raise ConfigError(name, "must be within 360000 degrees", value)
    return number
