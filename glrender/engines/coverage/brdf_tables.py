"""A surface's BRDF in a table: interpolated for all facets of a frame, since the law itself takes ten times as long."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from ...scene.surface import Surface
from ...view.view import BodyView

# Steps of the table by a normal's place out of the plane of Sun and camera.
_STEPS = 24
# Steps by the root of the distance of the unit vectors to Sun and camera, about a phase angle [rad]: small near 0,
# where surfaces surge; powers of 2, so that frames share nodes; and the fewest steps in a table.
_LEAST_STEP = 0.0078125
_MOST_STEP = 0.03125
_LEAST_STEPS = 4.0
# Least angle off the limb and the terminator [rad], and least part of a normal.
_EDGE_ON = 1e-6


class BrdfTables:
    """BRDF of surfaces as `horizon_loops.shade_centroids` takes it; nodes are worked out once for all frames."""

    def __init__(self):
        self._made: dict[tuple[Surface, float], np.ndarray] = {}

    def of(self, surface: Surface, view: BodyView, radius_m: float, brightness: float
           ) -> tuple[np.ndarray, float, float]:
        """BRDF [1/sr] of facets times the sum of the cosines of incidence and emission, for all phase angles on a body.

        Beyond the terminator and the limb as on them.

        Parameters
        ----------
        surface : Surface
        view : BodyView
        radius_m : float [m]
        brightness : float
            What it is times as well.

        Returns
        -------
        table : (C, 2 S + 1, S + 1) float64
            By roots of the distance of the unit vectors to Sun and camera, by the normal's place around a square in
            their plane, and its part in that plane.
        first, step : float
            Of the roots.
        """
        aside = math.asin(min(radius_m / view.range_m, 1.0))
        first, last = (math.sqrt(2.0 * math.sin(0.5 * min(max(view.phase_rad + turn, 0.0), math.pi)))
                       for turn in (-aside, aside))
        step = max((last - first) / _LEAST_STEPS, _LEAST_STEP)
        step = min(2.0 ** math.floor(math.log2(step)), _MOST_STEP)
        node = math.floor(first / step)
        roots = [step * each for each in range(node, max(math.ceil(last / step), node + 1) + 1)]
        for root in roots:
            if (surface, root) not in self._made:
                self._made[surface, root] = _brdf_at(surface, root)
        return brightness * np.stack([self._made[surface, root] for root in roots]), roots[0], step


@cache
def _places() -> tuple[np.ndarray, ...]:
    """A table's angles in the plane, and parts of the normal along it and across."""
    place, part = np.meshgrid(np.arange(-_STEPS, _STEPS + 1) / _STEPS, np.arange(_STEPS + 1) / _STEPS, indexing="ij")
    part = np.maximum(part, _EDGE_ON)
    return np.arctan2(place, 1.0 - np.abs(place)), part, np.sqrt(1.0 - part * part)


def _brdf_at(surface: Surface, root: float) -> np.ndarray:
    """One root's part (2 S + 1, S + 1) of a table."""
    angle, part, aside = _places()
    phase_rad = 2.0 * math.asin(min(0.5 * root**2, 1.0))
    to_sun, to_camera = np.array([math.cos(phase_rad), math.sin(phase_rad), 0.0]), np.array([1.0, 0.0, 0.0])
    both = np.clip(angle, phase_rad - 0.5 * math.pi + _EDGE_ON, 0.5 * math.pi - _EDGE_ON)
    normal = np.stack([part * np.cos(both), part * np.sin(both), aside], axis=-1)
    brdf = surface.brdf(to_sun, to_camera[None], normal.reshape(-1, 3), np.ones(angle.size)).reshape(angle.shape)
    return brdf * (normal @ (to_sun + to_camera))
