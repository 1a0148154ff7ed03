"""Dust given in cells: a grid of cross-section around a body, fixed in the body or in inertial space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import integer, one_of, position

from ...base.errors import ConfigError
from ..fields import CartesianField
from ..interpolation import refined

_MAX_CELLS = 160
"""Cells along a side of the finer grid: 16 MiB of weights."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Volume:
    """Geometric cross-section of dust in cells.

    Parameters
    ----------
    cross_section_per_m : (n_x, n_y, n_z) float [1/m], >= 0
        k, means of cells; at least 2 cells along each side.
    low_m, high_m : (3,) float64 [m]
        Corners of the grid, from the body's origin.
    frame : {"body", "inertial"}
    refine : int, 1..8
        Cells made of each by cubic interpolation that is limited to the range of the cells around, so that
        it neither overshoots nor turns negative.
    """

    cross_section_per_m: np.ndarray
    low_m: np.ndarray
    high_m: np.ndarray
    frame: str = "body"
    refine: int = 1

    def __post_init__(self):
        values = np.asarray(self.cross_section_per_m)
        if values.ndim != 3 or min(values.shape, default=0) < 2:
            raise ConfigError("grid", "must have three axes of at least 2 cells", values.shape)
        if values.dtype.kind not in "fiu" or not np.isfinite(values).all() or values.min() < 0.0:
            raise ConfigError("grid", "must hold finite numbers >= 0")
        if not values.max() > 0.0:
            raise ConfigError("grid", "must hold some dust: all of its cells are 0")
        object.__setattr__(self, "cross_section_per_m", values)
        for name in ("low_m", "high_m"):
            object.__setattr__(self, name, position(name, getattr(self, name)))
        if not (self.high_m > self.low_m).all():
            raise ConfigError("high_m", "must be above low_m on each axis", self.high_m.tolist())
        one_of("frame", self.frame, ("body", "inertial"))
        integer("refine", self.refine, 1, 8)
        if max(values.shape) * self.refine > _MAX_CELLS and self.refine > 1:
            raise ConfigError("refine", f"must leave at most {_MAX_CELLS} cells a side", self.refine)

    def field(self, least_m: float) -> CartesianField:
        """Weights K = k r^2 of the cells, without the empty ones around."""
        values = self.cross_section_per_m
        cell = (self.high_m - self.low_m) / values.shape
        middle = [self.low_m[k] + (np.arange(values.shape[k]) + 0.5) * cell[k] for k in range(3)]
        squared = sum(np.square(axis).reshape([-1 if k == j else 1 for j in range(3)])
                      for k, axis in enumerate(middle))
        # The mean of r^2 over a cell, not that of its middle: the cell at the origin would be empty.
        weights = refined(values * (squared + np.sum(cell**2) / 12.0), self.refine)
        return CartesianField(values_m=weights.astype(np.float32), low_m=self.low_m, high_m=self.high_m,
                              least_m=least_m).cropped()

    def field_from_body(self, body_from_inertial: np.ndarray, sun_direction_body: np.ndarray) -> np.ndarray:
        """(3, 3) float64 rotation into the grid's axes."""
        return np.eye(3) if self.frame == "body" else body_from_inertial.T
