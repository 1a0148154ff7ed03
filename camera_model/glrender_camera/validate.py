"""Checks that turn values from a user or the wire into trusted ones, or raise ConfigError.

Each takes the field's name first and returns the checked value. `not x > 0` is
written so that NaN fails.
"""

from __future__ import annotations

import difflib
import logging
import math
from collections.abc import Iterable, Mapping
from numbers import Integral, Real

import numpy as np

from .errors import ConfigError, path_of, shortened

# A norm this far from 1 is round-off, or seven digits: renormalised.
UNIT_TOLERANCE = 1e-6
# A norm this far from 1 has the four digits that people type: renormalised, with a warning. Beyond it the
# quaternion is a mistake and is refused.
ROUNDED_UNIT_TOLERANCE = 1e-3
# A light year: beyond it a position is a mistake of units, and float32 irradiance is 0.
MAX_DISTANCE_M = 1e16

_log = logging.getLogger(__name__)
# Fields that were warned of: some of their names come from the wire, so there is an end.
_warned: set[str] = set()
_MOST_WARNINGS = 1000


def finite(name: str, value: object) -> float:
    """A finite real number as float."""
    try:
        # An integer of any size is a number; one beyond 1.8e308 is none here.
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ConfigError(name, "must be a finite number", value)
    return number


def positive(name: str, value: object) -> float:
    """A finite number > 0."""
    number = finite(name, value)
    if not number > 0.0:
        raise ConfigError(name, "must be > 0", value)
    return number


def within(name: str, value: object, low: float, high: float) -> float:
    """A finite number in the closed interval [low, high]."""
    number = finite(name, value)
    if not low <= number <= high:
        percent = f"{number:g} % is {number / 100.0:g}" if low == 0.0 and high == 1.0 and 2.0 <= number <= 100.0 else ""
        raise ConfigError(name, f"must be between {low:g} and {high:g}", value, percent)
    return number


def integer(name: str, value: object, low: int, high: int) -> int:
    """An integer in the closed interval [low, high]; a float with an integer value counts (MATLAB)."""
    if isinstance(value, Real) and not isinstance(value, (bool, Integral)) and float(value).is_integer():
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, Integral) or not low <= value <= high:
        raise ConfigError(name, f"must be an integer between {low} and {high}", value)
    return int(value)


def text(name: str, value: object) -> str:
    """A string that is not empty."""
    if not isinstance(value, str) or not value:
        raise ConfigError(name, "must be a string that is not empty", value)
    return value


def name_of(name: str, value: object) -> str:
    """A name: 1 to 128 printable characters, as it will stand in messages, logs and on terminals."""
    if not isinstance(value, str) or not 0 < len(value) <= 128 or not value.isprintable():
        raise ConfigError(name, "must be a name of 1 to 128 printable characters", value)
    return value


def one_of(name: str, value: object, allowed: Iterable[str]) -> str:
    """A string out of `allowed`."""
    allowed = list(allowed)
    if value not in allowed:
        raise ConfigError(name, f"must be one of {', '.join(map(repr, allowed))}", value, did_you_mean(value, allowed))
    return value


def did_you_mean(value: object, known: Iterable[str]) -> str:
    """The question which of the known words a misspelt one stands for; empty where none is like it."""
    if not isinstance(value, str):
        return ""
    folded = {word.casefold(): word for word in known}
    like = difflib.get_close_matches(shortened(value, 64).casefold(), folded, n=1)
    return f"did you mean {folded[like[0]]!r}?" if like else ""


def vector(name: str, value: object, length: int = 3) -> np.ndarray:
    """A read-only (length,) float64 array of finite numbers."""
    try:
        # NumPy would take True for 1 and "1" for 1.
        if any(isinstance(entry, (bool, np.bool_, str, bytes)) for entry in value):
            raise TypeError
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(name, f"must be {length} numbers", value) from None
    if array.shape != (length,):
        raise ConfigError(name, f"must have shape ({length},)", value)
    if not np.isfinite(array).all():
        raise ConfigError(name, "must be finite", value)
    array.setflags(write=False)
    return array


def position(name: str, value: object) -> np.ndarray:
    """A read-only (3,) float64 position [m], each component within a light year, 1e16 m."""
    array = vector(name, value)
    if not (np.abs(array) <= MAX_DISTANCE_M).all():
        raise ConfigError(name, f"must be within {MAX_DISTANCE_M:g} m", value)
    return array


def unit_quaternion(name: str, value: object) -> np.ndarray:
    """A read-only (4,) float64 unit quaternion [w, x, y, z], renormalised as `unit_vectors` does it."""
    array = unit_vectors(name, vector(name, value, 4), "normalise [w, x, y, z] before sending")
    array.setflags(write=False)
    return array


def unit_vectors(name: str, array: np.ndarray, hint: str) -> np.ndarray:
    """(..., N) float64 vectors of norm 1, renormalised: from within 1e-6 in silence, from within 1e-3 with a warning.

    Raises
    ------
    ConfigError
        A norm farther from 1, with its index.
    """
    norm = np.linalg.norm(array, axis=-1)
    off = np.abs(norm - 1.0)
    if not (off <= UNIT_TOLERANCE).all():
        index = np.unravel_index(np.argmax(off), off.shape)
        near_unit(name + "".join(f"[{i}]" for i in index), float(off[index]),
                  f"norm must be 1 within {{:g}}, is {norm[index]:.9g}", array[index].tolist(), hint)
    return array / np.expand_dims(norm, -1)


def near_unit(name: str, off: float, rule: str, got: object, hint: str) -> None:
    """Refuse a norm farther than 1e-3 from unity; warn of one farther than 1e-6, once a process for each field.

    Parameters
    ----------
    name : str
    off : float
        How far it is from unity.
    rule : str
        The rule that must hold, with `{:g}` in the tolerance's place.
    got, hint : object, str
        The value received, and the way out.
    """
    if not off <= ROUNDED_UNIT_TOLERANCE:
        raise ConfigError(name, rule.format(ROUNDED_UNIT_TOLERANCE), got, hint)
    path = path_of(name)
    if off > UNIT_TOLERANCE and path not in _warned and len(_warned) < _MOST_WARNINGS:
        _warned.add(path)
        _log.warning("%s: %s: renormalised; %s, or write 7 digits", path, rule.format(UNIT_TOLERANCE), hint)


def known_keys(name: str, table: object, allowed: Iterable[str], required: Iterable[str] = ()) -> Mapping:
    """A mapping with string keys out of `allowed`, all of `required` present."""
    if not isinstance(table, Mapping):
        raise ConfigError(name, "must be a table", table)
    allowed = list(allowed)
    for key in table:
        if key not in allowed:
            key = shortened(str(key), 64)
            raise ConfigError(f"{name}.{key}" if name else key, "unknown key", hint=" ".join(
                (did_you_mean(key, allowed), f"known keys are {', '.join(sorted(allowed))}")).strip())
    for key in required:
        if key not in table:
            raise ConfigError(f"{name}.{key}" if name else key, "missing")
    return table
