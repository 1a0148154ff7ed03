"""The error tolerance `max_error`: a number, or a table with one for each unit that is asked for."""

from __future__ import annotations

from collections.abc import Mapping

from glrender_camera.validate import finite, known_keys, within

from ..base.errors import ConfigError

UNITS = ("rms", "flux", "centroid_px", "limb_px", "range")
"""Units of a frame's errors: docs/accuracy.md defines them."""
SIGMAS = "sigmas"
"""Name of a tolerance in deviations of the place that the camera's noise lets be known; may go with `UNITS`."""
LEAST = 2.0**-24
"""Least tolerance of any unit [1] or [px]: half a step of the float32 in which pixels are stored."""
LEAST_DEADLINE_S, _MAX_DEADLINE_S = 1e-6, 1e6
"""Least time [s] of a frame: what is left of one that has passed."""
_MOST_PX = 1e4


def checked_max_error(value: object, name: str = "max_error") -> float | dict[str, float]:
    """An error tolerance: the number, or those of `UNITS` and `SIGMAS` that a table names, in their order.

    Raises
    ------
    ConfigError
        Unknown units; an empty table; numbers that are not > 0, are below `LEAST`, or above 1, of pixels and
        deviations 1e4.
    """
    if not isinstance(value, Mapping):
        return _checked(value, name, 1.0)
    units = (*UNITS, SIGMAS)
    if not known_keys(name, value, units):
        raise ConfigError(name, f"must name one of {', '.join(units)}, or be a number", dict(value))
    return {unit: _checked(value[unit], f"{name}.{unit}", _MOST_PX if unit.endswith(("_px", SIGMAS)) else 1.0)
            for unit in units if unit in value}


def by_unit(max_error: float | Mapping[str, float]) -> dict[str, float]:
    """A checked tolerance by unit; a number is that of `rms`."""
    return dict(max_error) if isinstance(max_error, Mapping) else {"rms": max_error}


def _checked(value: object, name: str, most: float) -> float:
    number = finite(name, value)
    if 0.0 < number < LEAST:
        raise ConfigError(name, f"must be at least {LEAST:.2g}: float32 pixels hold no less", value)
    if not 0.0 < number <= most:
        percent = f"{number:g} % is {number / 100.0:g}" if most == 1.0 and number < 100.0 else ""
        raise ConfigError(name, f"must be > 0 and <= {most:g}", value,
                          percent if number > 0.0 else f"the least is {LEAST:.2g}, which float32 pixels hold")
    return number


def checked_deadline(seconds: object) -> float:
    """The time [s] that a frame may take, 1e-6..1e6.

    Raises
    ------
    ConfigError
    """
    return within("deadline_s", seconds, LEAST_DEADLINE_S, _MAX_DEADLINE_S)
