"""A coma that is the same in all directions: a power of distance, with scale lengths after Haser."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import MAX_DISTANCE_M, positive, within

from ...base.errors import ConfigError
from .source import EVERYWHERE


@dataclass(frozen=True, kw_only=True)
class Haser:
    """k(r) = k0 (r0 / r)^exponent, times the share that parents have formed, times the share left.

    Parameters
    ----------
    weight_m : float [m], > 0
        K = k r^2 at the reference radius, before scale lengths.
    exponent : float [1], > 1 and <= 4
        2 is an even outflow at constant speed.
    reference_radius_m : float [m], optional
        r0; needed unless the exponent is 2.
    scale_length_m : float [m], optional
        Scale of disintegration: exp(-r / scale_length).
    parent_length_m : float [m], optional
        Scale of the parents that the dust comes from, less than the scale length if both are given:
        1 - exp(-r / parent), or Haser's daughter with both.
    reach_m : float [m], optional
        The law is cut there.

    Source: Haser (1957), Bull. Acad. R. Belgique 43, 740.
    """

    weight_m: float
    exponent: float = 2.0
    reference_radius_m: float | None = None
    scale_length_m: float | None = None
    parent_length_m: float | None = None
    reach_m: float = EVERYWHERE

    feature_rad = math.inf
    most_directions = 2

    def __post_init__(self):
        positive("weight_m", self.weight_m)
        within("exponent", self.exponent, 1.0, 4.0)
        if self.exponent == 1.0:
            raise ConfigError("exponent", "must be > 1: the column of 1/r has no end", self.exponent)
        if self.exponent != 2.0 and self.reference_radius_m is None:
            raise ConfigError("reference_radius_m", "missing", hint="an exponent other than 2 needs it")
        for name in ("reference_radius_m", "scale_length_m", "parent_length_m"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))
        if self.reach_m != EVERYWHERE:
            within("reach_m", positive("reach_m", self.reach_m), 0.0, MAX_DISTANCE_M)
        if None not in (self.scale_length_m, self.parent_length_m) and self.parent_length_m >= self.scale_length_m:
            raise ConfigError("parent_length_m", "must be below scale_length_m", self.parent_length_m)

    def components(self, r_m: np.ndarray) -> np.ndarray:
        """K (1, N) [m] at points (N, 3) [m]."""
        return self.at(np.linalg.norm(r_m, axis=-1))[None]

    def at(self, distance_m: np.ndarray) -> np.ndarray:
        """K [m] at distances [m] from the origin."""
        r = np.asarray(distance_m, np.float64)
        value = np.full(r.shape, self.weight_m)
        if self.exponent != 2.0:
            value = value * (r / self.reference_radius_m) ** (2.0 - self.exponent)
        left, parent = self.scale_length_m, self.parent_length_m
        if left is not None and parent is not None:
            value = value * left / (left - parent) * (np.exp(-r / left) - np.exp(-r / parent))
        elif left is not None:
            value = value * np.exp(-r / left)
        elif parent is not None:
            value = value * -np.expm1(-r / parent)
        return np.where(r <= self.reach_m, value, 0.0)

    def activity(self, sun_direction_body: np.ndarray) -> np.ndarray:
        """(1,): day and night alike."""
        return np.ones(1)
