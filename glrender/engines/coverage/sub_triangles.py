"""Parts of facets, and the points between which they are: divided parts share points, and knowledge about them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from glrender_camera import PinholeCamera, threads

from ...view.view import BodyView
from . import facet_loops

FACETS_AT_ONCE = 16_384
"""Facets, or points, that a thread takes in a turn: what they need stays in a core's cache."""


class Points:
    """Points of a surface that grow in number; of each, whether it is seen, and in sunlight as well.

    Parameters
    ----------
    r_m : (3, N) float64 [m]
    is_seen, is_lit : (N,) bool
    """

    def __init__(self, r_m: np.ndarray, is_seen: np.ndarray, is_lit: np.ndarray):
        self._n = len(is_seen)
        self._r_m, self._is_seen, self._is_lit = r_m, is_seen, is_lit

    @property
    def r_m(self) -> np.ndarray:
        """(3, N) float64 [m]."""
        return self._r_m[:, :self._n]

    @property
    def is_seen(self) -> np.ndarray:
        """(N,) bool."""
        return self._is_seen[:self._n]

    @property
    def is_lit(self) -> np.ndarray:
        """(N,) bool."""
        return self._is_lit[:self._n]

    def add(self, r_m: np.ndarray, is_seen: np.ndarray | bool, is_lit: np.ndarray | bool) -> np.ndarray:
        """Add some (3, K); returns their numbers (K,)."""
        begin, self._n = self._n, self._n + r_m.shape[1]
        if self._n > len(self._is_seen):
            room = 2 * self._n
            for name in ("_r_m", "_is_seen", "_is_lit"):
                had = getattr(self, name)
                grown = np.empty((*had.shape[:-1], room), had.dtype)
                grown[..., :begin] = had[..., :begin]
                setattr(self, name, grown)
        self.r_m[:, begin:], self.is_seen[begin:], self.is_lit[begin:] = r_m, is_seen, is_lit
        return np.arange(begin, self._n)


@dataclass(eq=False)
class FacetParts:
    """Triangles within facets: numbers of their corners among points (3, N), facet (N,), area_px (N,)."""

    corner: np.ndarray
    facet: np.ndarray
    area_px: np.ndarray

    def at(self, chosen: np.ndarray) -> FacetParts:
        """Parts of given numbers (M,)."""
        return FacetParts(*(getattr(self, field.name).take(chosen, axis=-1) for field in fields(self)))

    def sides_squared(self, r_m: np.ndarray) -> np.ndarray:
        """Squared lengths (3, N) [m2] of the sides from each corner to the next, between points (3, P) [m]."""
        place = r_m.take(self.corner, axis=1)
        return np.square(np.roll(place, -1, axis=1) - place).sum(axis=0)

    @classmethod
    def none(cls) -> FacetParts:
        """No part."""
        return cls(np.zeros((3, 0), np.intp), np.zeros(0, np.intp), np.zeros(0))

    @classmethod
    def joined(cls, several: list[FacetParts]) -> FacetParts:
        """All parts, one after the other."""
        return cls(*(np.concatenate([getattr(one, field.name) for one in several], axis=-1) for field in fields(cls)))


def projected(r_body_m: np.ndarray, view: BodyView, camera: PinholeCamera) -> np.ndarray:
    """Places (2, N) [px] of points (3, N) [m] in the image; infinite behind the camera."""
    lens = camera.lens_map
    if lens is not None:
        xy = normalised(r_body_m, view)
        return np.where(np.isinf(xy), xy, lens.places_px(xy))
    return _scaled(r_body_m, view, camera.focal_length_px, np.array(camera.principal_point_px, float))


def normalised(r_body_m: np.ndarray, view: BodyView) -> np.ndarray:
    """X / Z, Y / Z in `camera` (2, N) [1] of points (3, N) [m]."""
    return _scaled(r_body_m, view, 1.0, np.zeros(2))


def _scaled(r_body_m: np.ndarray, view: BodyView, focal_length: float, middle: np.ndarray) -> np.ndarray:
    found = np.empty((2, r_body_m.shape[1]))

    def project(part: slice) -> None:
        facet_loops.project(r_body_m, part.start, part.stop, view.camera_from_body, view.r_camera_body_m,
                            focal_length, middle, found)

    threads.run_in_parts(project, r_body_m.shape[1], FACETS_AT_ONCE)
    return found
