"""Checks of the values that a caller gives: a ValueError names field, rule, value and the way out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np

_MOST_TOLD = 60


def refuse(field: str, rule: str, value: object, hint: str = "") -> ValueError:
    """The error to raise: ``camera.width_px: must be an integer >= 1, got -1; hint``."""
    told = repr(value.tolist() if isinstance(value, np.ndarray) else value)
    told = told if len(told) <= _MOST_TOLD else f"{told[:_MOST_TOLD]}..."
    return ValueError(f"{field}: {rule}, got {told}{hint and f'; {hint}'}")


def whole(field: str, value: object, low: int = 1) -> int:
    """An integer from `low` on; a float of that value counts."""
    if not _is_number(value) or value != int(value) or value < low:
        raise refuse(field, f"must be an integer >= {low}", value, "count pixels")
    return int(value)


def number(field: str, value: object, hint: str, *, is_zero_allowed: bool = False) -> float:
    """A finite number above zero, or zero where that is allowed."""
    if not _is_number(value) or value < 0.0 or (value == 0.0 and not is_zero_allowed):
        raise refuse(field, f"must be {'>=' if is_zero_allowed else '>'} 0 and finite", value, hint)
    return float(value)


def array(field: str, value: object, shape: Sequence[int | None], hint: str) -> np.ndarray:
    """Finite numbers, float64, of a shape; None in it stands for any length from 1 on."""
    try:
        found = np.array(value, float)
    except (TypeError, ValueError):
        found = np.empty(0)
    fits = found.ndim == len(shape) and all(n == want or (want is None and n) for n, want in
                                            zip(found.shape, shape, strict=True))
    if not fits or not np.isfinite(found).all():
        told = ", ".join("N" if n is None else str(n) for n in shape)
        raise refuse(field, f"must be finite numbers of shape ({told}{',' * (len(shape) == 1)})", value, hint)
    return found


def quaternion(field: str, value: object) -> np.ndarray:
    """A rotation's [w, x, y, z], of any length but zero."""
    hint = "give [w, x, y, z], scalar first"
    found = array(field, value, (4,), hint)
    if not np.linalg.norm(found) > 0.0:
        raise refuse(field, "must not be of length zero", value, hint)
    return found


def member(field: str, table: object, key: str) -> Any:
    """An entry of a mapping."""
    if not hasattr(table, "keys"):
        raise refuse(field, "must be a mapping", table, "give a `State`, or its dictionary as `to_dict` makes it")
    if key not in table:
        raise refuse(f"{field}.{key}", "is missing", sorted(table), "a state names bodies as the scene does")
    return table[key]


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
