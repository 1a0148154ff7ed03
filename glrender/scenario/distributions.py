"""Distributions of one number: what random states are drawn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from ..base.errors import ConfigError
from .checks import numbers

KINDS = ("uniform", "log_uniform", "solid_angle", "normal")


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """A distribution of one number, within bounds.

    Parameters
    ----------
    kind : str
        "uniform" or "log_uniform" from a to b; "solid_angle": an angle [deg] from a to b off an axis, evenly over the
        sphere; "normal" of mean a and standard deviation b, cut off at the bounds.
    a, b : float
    bounds : (float, float)
        The least and the largest value that the number may have.

    Raises
    ------
    ConfigError
    """

    kind: str
    a: float
    b: float
    bounds: tuple[float, float]

    def __post_init__(self):
        low, high = self.bounds
        if self.kind == "normal":
            if not (self.b > 0.0 and low <= self.a <= high):
                raise ConfigError("", f"must be a mean between {low:g} and {high:g} and a deviation > 0",
                                  [self.a, self.b])
            return
        if not low <= self.a <= self.b <= high:
            raise ConfigError("", f"must rise and be between {low:g} and {high:g}", [self.a, self.b])
        if self.kind == "log_uniform" and not self.a > 0.0:
            raise ConfigError("", "must be > 0 for log_uniform", [self.a, self.b])

    @property
    def span(self) -> tuple[float, float]:
        """The least and the largest value that is drawn; of "normal" those within 3 deviations."""
        if self.kind != "normal":
            return self.a, self.b
        return max(self.a - 3.0 * self.b, self.bounds[0]), min(self.a + 3.0 * self.b, self.bounds[1])

    def of(self, share: np.ndarray) -> np.ndarray:
        """The values (N,) below which shares (N,) of the distribution, 0..1, are."""
        if self.kind == "normal":
            low, high = ndtr((np.array(self.bounds) - self.a) / self.b)
            return np.clip(self.a + self.b * ndtri(low + share * (high - low)), *self.bounds)
        if self.kind == "log_uniform":
            return self.a * (self.b / self.a) ** share
        if self.kind == "solid_angle":
            # 1 - cos, by half angles: exact near 0.
            low, high = np.sin(0.5 * np.radians([self.a, self.b])) ** 2
            return np.degrees(2.0 * np.arcsin(np.sqrt(low + share * (high - low))))
        return self.a + share * (self.b - self.a)

    def __str__(self) -> str:
        if self.kind == "normal":
            return f"normal, {self.a:g} +- {self.b:g}"
        return f"{self.a:g}" if self.a == self.b else f"{self.a:g} to {self.b:g}, {self.kind}"


def distribution(value: object, low: float, high: float) -> Distribution:
    """The distribution of a number, of a pair [a, b], which is uniform, or of a table such as {log_uniform = [a, b]}.

    Raises
    ------
    ConfigError
    """
    kind = "uniform"
    if isinstance(value, dict):
        if len(value) != 1 or next(iter(value)) not in KINDS:
            raise ConfigError("", f"must have one key of {', '.join(KINDS)}", sorted(value))
        (kind, value), = value.items()
    array = numbers("", value)
    if array.shape == () and kind == "uniform":
        array = np.array([array, array])
    if array.shape != (2,):
        raise ConfigError("", "must be a number, or two: [low, high]", value)
    return Distribution(kind=kind, a=float(array[0]), b=float(array[1]), bounds=(low, high))
