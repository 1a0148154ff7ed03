"""The error of shadow maps where a part of a body is seen: rays look at some pixels of what OpenGL has drawn."""

from __future__ import annotations

import math

import numpy as np

from ..planner.plan import WindowPlan
from .raster.surface_pass import Frame
from .rays.engine import R2, RayEngine, places_in

# Pixels that are looked at: an error of 1 % in RMS is in 1 of 10,000 pixels, if it is as large as the mean.
_PIXELS = 1 << 14


class ShadowCheck:
    """Pixels of a window that are spread over it, as OpenGL and as rays from the same samples light them.

    A part of a body may show no shadow's edge, or edges alone, near or far: neither its outline nor the contrast of its
    image tells them from the edges of facets.

    Parameters
    ----------
    rays : RayEngine
    window : WindowPlan
    frame : Frame
    """

    def __init__(self, rays: RayEngine, window: WindowPlan, frame: Frame):
        self._rays, self._window, self._frame = rays, window, frame
        x0, y0, x1, y1 = window.roi
        n_px = (x1 - x0) * (y1 - y0)
        share = 0.5 + np.arange(min(_PIXELS, n_px))[:, None] * R2
        place = np.floor((share - np.floor(share)) * [x1 - x0, y1 - y0]).astype(int)
        self._column, self._row = np.unique(place, axis=0).T
        self._light, self._n_lit = 0.0, 0
        self._difference: list[np.ndarray] = []

    @staticmethod
    def is_needed(window: WindowPlan, frame: Frame) -> bool:
        """Whether a map is drawn for a body of which only a part is seen."""
        return any(view.name in window.bodies and not view.is_whole and body.shadow_map_px is not None
                   for view, body in zip(frame.views, frame.bodies, strict=True))

    def look(self, tile: tuple[slice, slice], samples: np.ndarray) -> None:
        """Look at the pixels that are in a tile of rows and columns, of which OpenGL has drawn samples."""
        rows, columns = tile
        inside = np.flatnonzero((self._row >= rows.start) & (self._row < rows.stop)
                                & (self._column >= columns.start) & (self._column < columns.stop))
        count, (x0, y0, *_) = self._window.samples, self._window.roi
        row, column = places_in(self._row[inside], self._column[inside], count)
        drawn = samples[row - count * rows.start, column - count * columns.start].astype(np.float64)
        pixel = np.stack([x0 - 0.5 + (column + 0.5) / count, y0 - 0.5 + (row + 0.5) / count], axis=1)
        seen = self._frame.only(self._window.bodies)
        lit, exact = self._rays.are_lit(pixel, self._frame.camera, seen), drawn.copy()
        other = np.flatnonzero(lit != (exact > 0.0))
        exact[other] = self._rays.irradiance(pixel[other], self._frame.camera, seen, None)
        drawn, exact = (each.reshape(-1, count**2) for each in (drawn, exact))
        self._light += float(exact.sum()) / count**2
        self._difference.append((drawn - exact).mean(axis=1))
        self._n_lit += int((np.maximum(drawn, exact) > 0.0).any(axis=1).sum())

    @property
    def error(self) -> float:
        """RMS error [1] over the mean of the lit pixels, with a deviation of its own; 0 where none is lit."""
        if not self._light > 0.0:
            return 0.0
        squared = (np.concatenate(self._difference) / (self._light / self._n_lit)) ** 2
        return math.sqrt((squared.sum() + math.sqrt((squared**2).sum())) / self._n_lit)

    @property
    def flux_error(self) -> float:
        """Error of the total light [1], with a deviation of its own; 0 where none is lit."""
        if not self._light > 0.0:
            return 0.0
        difference = np.concatenate(self._difference) / self._light
        return abs(float(difference.sum())) + math.sqrt(float((difference**2).sum()))
