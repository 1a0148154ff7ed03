"""A surface's BRDF in a table: interpolated for all facets of a frame, since the law itself takes ten times as long."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from ...scene.surface import Surface
from ...view.view import BodyView
from .horizon_loops import N_AZIMUTHS, shade_centroids

# Steps of the table by a normal's place out of the plane of Sun and camera.
_STEPS = 24
# Steps by the root of the distance of the unit vectors to Sun and camera, about a phase angle [rad]: small near 0,
# where surfaces surge; powers of 2, so that frames share nodes; and the fewest steps in a table.
_LEAST_STEP = 0.0078125
_MOST_STEP = 0.03125
_LEAST_STEPS = 4.0
# Least angle off the limb and the terminator [rad], and least part of a normal: a round choice, far from float64's
# rounding and from all that has light.
_EDGE_ON = 1e-6


class BrdfTables:
    """BRDF of surfaces as `horizon_loops.shade_centroids` takes it; nodes are worked out once for all frames."""

    def __init__(self):
        self._made: dict[tuple[Surface, float], np.ndarray] = {}
        self._errors: dict[tuple[Surface, float, float], tuple[float, float]] = {}

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

    def errors(self, surface: Surface, view: BodyView, radius_m: float) -> tuple[float, float]:
        """RMS error over the mean, and of the flux [1], of a sphere's facets by the table: midway between its nodes."""
        table, first, step = self.of(surface, view, radius_m, 1.0)
        root = math.sqrt(2.0 * math.sin(0.5 * view.phase_rad))
        k = min(max(int((root - first) / step), 0), len(table) - 2)
        key = surface, first + k * step, step
        if key not in self._errors:
            self._errors[key] = _errors_of(surface, first + (k + 0.5) * step, table, first, step)
        return self._errors[key]


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


@cache
def _rings() -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) around +x, the denser the nearer, and their solid angles (N,)."""
    edges = np.concatenate([[0.0], np.geomspace(_LEAST_STEP, 0.5 * math.pi, _STEPS)])
    angle, turn = np.meshgrid(0.5 * (edges[1:] + edges[:-1]),
                              (np.arange(_STEPS) + 0.5) * 2.0 * math.pi / _STEPS, indexing="ij")
    normal = np.stack([np.cos(angle), np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)], axis=-1)
    return normal.reshape(-1, 3), np.repeat(-np.diff(np.cos(edges)), _STEPS)


def _lune(half_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) between terminator and limb, the denser the nearer to them, and their solid angles (N,)."""
    (place, share), (height, part) = (np.polynomial.legendre.leggauss(n) for n in (_STEPS, _STEPS))
    angle, aside = np.meshgrid((0.5 * math.pi - half_rad) * place, 0.5 * math.pi * height, indexing="ij")
    normal = np.stack([np.cos(aside) * np.cos(angle), np.cos(aside) * np.sin(angle), np.sin(aside)], axis=-1)
    return normal.reshape(-1, 3), (np.outer(share, part) * np.cos(aside)).ravel()


def _errors_of(surface: Surface, root: float, table: np.ndarray, first: float, step: float) -> tuple[float, float]:
    """Errors of a table as `BrdfTables.errors` has them, at one root: the larger by either set of directions."""
    half_rad = math.asin(min(0.5 * root**2, 1.0))
    to_sun, to_camera = (np.array([math.cos(half_rad), side * math.sin(half_rad), 0.0]) for side in (1.0, -1.0))
    rms = flux = 0.0
    for normal, weight in (_rings(), _lune(half_rad)):
        incidence, emission = normal @ to_sun, normal @ to_camera
        faces = np.flatnonzero((incidence > _EDGE_ON) & (emission > _EDGE_ON))
        normal, weight, n = normal[faces], weight[faces] * emission[faces], len(faces)
        facets = np.zeros((n, 6), np.float32)
        facets[:, :3] = normal
        found, asked, is_asked = np.empty(n), np.empty(n, np.intp), np.empty((2, n), bool)
        shade_centroids(facets, np.zeros((n, N_AZIMUTHS), np.uint8), 0, n, 1, to_sun, to_camera, table, first,
                        1.0 / step, False, found, asked, is_asked)
        truth = incidence[faces] * surface.brdf(to_sun[None], to_camera[None], normal, np.ones(n))
        light = float((weight * truth).sum())
        if light > 0.0:
            error = found - truth
            rms = max(rms, math.sqrt(float((weight * error * error).sum()) * float(weight.sum())) / light)
            flux = max(flux, abs(float((weight * error).sum())) / light)
    return rms, flux
