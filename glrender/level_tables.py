"""What a level of detail costs an image by areas, in tables of size and phase angle: measured by `area_levels`."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .render_plan import LevelPlan
from .view import BodyView

SIZES_PX = 2.0 ** np.arange(3, 10)
"""Diameters of the bounding sphere in the image, at which errors are told."""
PHASES_RAD = np.radians([2.0, 30.0, 60.0, 90.0, 120.0, 150.0])
FEWEST_KEPT = 100_000
"""Facets from which it is kept from frame to frame what of them is seen and lit."""
# Least phase angle for that [rad], anywhere on the body: below it surfaces surge.
_LEAST_KEPT_RAD = 0.17
_PHASES = PHASES_RAD.tolist()
_LEAST_PX, _MOST_PX = SIZES_PX[[0, -1]].tolist()


@dataclass(frozen=True, kw_only=True, eq=False)
class AreaLevel:
    """What a level of detail costs an image by areas; P phase angles, S sizes.

    Attributes
    ----------
    kind : LevelPlan
        What is drawn.
    n_facets : int
    n_normals : int
        Of the full shape, which its facets stand for; 0 where they are flat.
    crease_rad : float [rad]
        RMS angle between neighbouring facets.
    error : (P, S) float64
        RMS error over the mean of the lit pixels, the largest of all aspects.
    flux_ratio : (P, S) float64
        Flux of the full shape over the level's, mean over aspects: images are multiplied by it.
    flux_scatter : (P, S) float64
        Standard deviation of that from aspect to aspect, relative.
    centre : (P,) float64
        Distance of the centre of brightness from the full shape's over the diameter, the largest of all aspects.
    told : (P, S) float64
        RMS error that frames tell of themselves, the mean of all aspects; 0 of kinds that tell none.
    """

    kind: LevelPlan
    n_facets: int
    n_normals: int
    crease_rad: float
    error: np.ndarray
    flux_ratio: np.ndarray
    flux_scatter: np.ndarray
    centre: np.ndarray
    told: np.ndarray

    def error_at(self, phase_rad: float, size_px: float) -> float:
        """RMS error; that of the smallest size below it, infinite beyond the largest and beyond the last phase."""
        if phase_rad > _PHASES[-1] or size_px > _MOST_PX:
            return math.inf
        errors, *_ = self._lists
        return _at_size(errors, phase_rad, size_px)

    def told_at(self, phase_rad: float, size_px: float) -> float:
        """RMS error that frames tell, about; of sizes and phases beyond the table that at its edge."""
        *_, told = self._lists
        return _at_size(told, phase_rad, min(size_px, _MOST_PX))

    def flux_at(self, phase_rad: float, n_cells: float) -> tuple[float, float]:
        """Mean and scatter of the flux's ratio, of a body so many cells wide; beyond the table those at its edge."""
        _, ratio, scatter, *_ = self._lists
        n_cells = min(n_cells, _MOST_PX)
        return _at_size(ratio, phase_rad, n_cells), _at_size(scatter, phase_rad, n_cells)

    def centre_at(self, phase_rad: float) -> float:
        """Distance of the centre of brightness from the full shape's, over the diameter."""
        *_, centre, _ = self._lists
        return _at(centre, phase_rad)

    @cached_property
    def _lists(self) -> tuple[list, ...]:
        """Errors, ratios and their scatters by size and phase, centres by phase, what is told by size and phase.

        A number of an array takes longer.
        """
        return tuple(each.tolist() for each in (self.error.T, self.flux_ratio.T, self.flux_scatter.T, self.centre,
                                                self.told.T))


def _at_size(values: list[list[float]], phase_rad: float, size_px: float) -> float:
    """Between values of the sizes and phases."""
    place = math.log2(max(size_px, _LEAST_PX) / _LEAST_PX)
    k = min(int(place), len(SIZES_PX) - 2)
    low, high = _at(values[k], phase_rad), _at(values[k + 1], phase_rad)
    return low + (place - k) * (high - low)


def _at(values: list[float], phase_rad: float) -> float:
    """Between values of the phases."""
    k = min(max(bisect_right(_PHASES, phase_rad) - 1, 0), len(_PHASES) - 2)
    share = min(max((phase_rad - _PHASES[k]) / (_PHASES[k + 1] - _PHASES[k]), 0.0), 1.0)
    return values[k] + share * (values[k + 1] - values[k])


def is_kept(n_facets: int, view: BodyView, radius_m: float) -> bool:
    """Whether it is kept what is seen and lit of the facets."""
    return n_facets >= FEWEST_KEPT and view.phase_rad - radius_m / view.range_m >= _LEAST_KEPT_RAD
