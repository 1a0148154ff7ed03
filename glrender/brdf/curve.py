"""Numbers that depend on the phase angle: tables and polynomials in degrees, as laws take them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender_camera.validate import known_keys, within

from ..base.errors import ConfigError

# Two vec4 of a uniform block.
MAX_TERMS = 8
_MAX_KNOTS = 128
# Every number's bound, so that no power of 180 deg overflows float32.
_MAX_NUMBER = 1e9


@dataclass(frozen=True, kw_only=True)
class Table:
    """Values at phase angles, straight lines between them, held beyond the ends.

    Parameters
    ----------
    phase_deg : (2..128) float [deg], 0..180, increasing
    value : as many float
    """

    phase_deg: tuple[float, ...]
    value: tuple[float, ...]

    def __post_init__(self):
        for name in ("phase_deg", "value"):
            object.__setattr__(self, name, _numbers(name, getattr(self, name)))
        if not 2 <= len(self.phase_deg) <= _MAX_KNOTS:
            raise ConfigError("phase_deg", f"must be 2 to {_MAX_KNOTS} numbers", self.phase_deg)
        if len(self.value) != len(self.phase_deg):
            raise ConfigError("value", f"must be as many as phase_deg, {len(self.phase_deg)}", self.value)
        if not (np.diff(self.phase_deg) > 0.0).all() or self.phase_deg[0] < 0.0 or self.phase_deg[-1] > 180.0:
            raise ConfigError("phase_deg", "must increase within 0..180", self.phase_deg)

    @property
    def max_phase(self) -> float:
        """Largest phase angle [rad] of the table."""
        return math.radians(self.phase_deg[-1])

    def knots(self, value: np.ndarray) -> np.ndarray:
        """(n, 4) phase [deg], value, slope to the next knot [1/deg], 0; for `piecewise` in GLSL."""
        slope = np.append(np.diff(value) / np.diff(self.phase_deg), 0.0)
        return np.stack([self.phase_deg, value, slope, np.zeros_like(slope)], axis=1)


def table_or_terms(name: str, value: object) -> Table | tuple[float, ...]:
    """A Table out of a mapping with `phase_deg` and `value`, or a tuple of coefficients."""
    if isinstance(value, Table):
        return value
    if isinstance(value, Mapping):
        known_keys(name, value, ("phase_deg", "value"), required=("phase_deg", "value"))
        try:
            return Table(**value)
        except ConfigError as error:
            error.path = f"{name}.{error.path}"
            raise
    terms = _numbers(name, value)
    if len(terms) > MAX_TERMS:
        raise ConfigError(name, f"must be at most {MAX_TERMS} coefficients", value, "or a table")
    return terms


def _numbers(name: str, value: object) -> tuple[float, ...]:
    if isinstance(value, str) or not isinstance(value, (Sequence, np.ndarray)):
        raise ConfigError(name, "must be a list of numbers", value)
    return tuple(within(f"{name}[{i}]", v, -_MAX_NUMBER, _MAX_NUMBER) for i, v in enumerate(value))


def bounded(name: str, value: np.ndarray, limit: float) -> None:
    """Refuse a curve, sampled over 0..180 deg, that exceeds a limit.

    Raises
    ------
    ConfigError
    """
    largest = float(np.max(np.abs(value)))
    if not largest <= limit:
        raise ConfigError(name, f"must stay within {limit:g} over 0..180 deg of phase", largest,
                          "a table holds its last value")


def polynomial(terms: Sequence[float], x: np.ndarray) -> np.ndarray:
    """terms[0] + terms[1] x + ... by Horner's rule."""
    total = np.zeros_like(x)
    for term in reversed(terms):
        total = total * x + term
    return total


def vec4_pair(name: str, terms: Sequence[float]) -> dict[str, tuple[float, ...]]:
    """Up to 8 coefficients as the two uniforms `<name>_low` and `<name>_high`."""
    padded = (*terms, *[0.0] * (MAX_TERMS - len(terms)))
    return {f"{name}_low": padded[:4], f"{name}_high": padded[4:]}


SAMPLED_DEG = np.linspace(0.0, 180.0, 1801)
"""Phase angles at which curves are tested against their bounds."""
MAX_FACTOR = 1e6
"""Largest factor of a phase function: with it, float32 holds every BRDF."""


class PhaseFunction:
    """f(g), the factor that a law's albedo takes with phase; 1 unless given otherwise.

    Parameters
    ----------
    value : None, sequence of float, or table
        Coefficients (c1, c2, ...) of exp(c1 g + c2 g^2 + ...), g in degrees; at most 7. Or a table of f > 0,
        interpolated in its logarithm. f must stay within 1e6 over 0..180 deg.

    Twin: shaders/brdf/phase_curve.glsl.
    """

    def __init__(self, value: object):
        self.value = table_or_terms("phase_function", () if value is None else value)
        self.is_table = isinstance(self.value, Table)
        if self.is_table:
            if min(self.value.value) <= 0.0:
                raise ConfigError("phase_function.value", "must be > 0", self.value.value)
            self._logarithm = np.log(self.value.value)
        elif len(self.value) >= MAX_TERMS:
            raise ConfigError("phase_function", f"must be at most {MAX_TERMS - 1} coefficients", value,
                              "or a table")
        with np.errstate(over="ignore"):
            bounded("phase_function", self(SAMPLED_DEG), MAX_FACTOR)

    @property
    def max_phase(self) -> float:
        """Largest phase angle [rad] at which f is more than held."""
        return self.value.max_phase if self.is_table else math.pi

    def __call__(self, phase_deg: np.ndarray) -> np.ndarray | float:
        """f [1] at phase angles [deg]."""
        if self.is_table:
            return np.exp(np.interp(phase_deg, self.value.phase_deg, self._logarithm))
        return np.exp(phase_deg * polynomial(self.value, phase_deg)) if self.value else 1.0

    def defines(self) -> dict[str, int]:
        return {"LAW_PHASE_KNOTS": len(self.value.value) if self.is_table else 0,
                "LAW_PHASE_TERMS": int(not self.is_table and bool(self.value))}

    def knots(self) -> np.ndarray:
        """(n, 4) of log2 f; none unless it is a table."""
        return self.value.knots(self._logarithm / math.log(2.0)) if self.is_table else np.empty((0, 4))

    def uniforms(self) -> dict[str, Any]:
        """`law_phase_low`, `law_phase_high`: exponent in powers of 2."""
        terms = () if self.is_table else tuple(term * math.log2(math.e) for term in self.value)
        return vec4_pair("law_phase", (0.0, *terms) if terms else ())


PHASE_FIELDS = {"law_phase_low": "vec4", "law_phase_high": "vec4"}
