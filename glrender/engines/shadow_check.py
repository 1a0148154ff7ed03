"""The error of shadows where a part of a body is seen: rays look at some pixels of what OpenGL has drawn."""

from __future__ import annotations

import math

import numpy as np

from ..planner.plan import WindowPlan
from .raster.surface_pass import Frame
from .rays.engine import R2, RayEngine, draws, places_in

# Pixels that are looked at, by one ray each: a shadow of a few pixels may be all that errs.
_PIXELS = 1 << 18


class ShadowCheck:
    """Pixels of a window that are spread over it, as OpenGL and as rays from the same samples light them.

    A part of a body may show no shadow's edge, or edges alone, near or far: neither its outline nor the contrast of its
    image tells them from the edges of facets. Rays of the Sun's disc see penumbras, of which OpenGL draws hard edges.

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
        self._row, self._column = np.divmod(np.unique(place @ [1, x1 - x0]), x1 - x0)
        # The sample that is looked at first, of each pixel.
        self._first = np.random.default_rng(0).integers(window.samples**2, size=len(self._row))
        self._light = self._n_lit = 0.0
        self._difference, self._weight = [np.zeros(0)], [np.zeros(0)]

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
        row, column, first, n = self._row[inside], self._column[inside], self._first[inside], self._window.samples
        down, across = row - rows.start, column - columns.start
        light = samples.reshape(samples.shape[0] // n, n, -1, n).mean(axis=(1, 3), dtype=np.float64)[down, across]
        is_other, _ = self._differences(n * row + first // n, n * column + first % n,
                                        samples[n * down + first // n, n * across + first % n])
        other = np.flatnonzero(is_other)
        drawn = samples[places_in(down[other], across[other], n)]
        are_other, difference = (each.reshape(-1, n**2) for each in self._differences(
            *places_in(row[other], column[other], n), drawn))
        # A pixel is found the more rarely, the fewer of its samples differ.
        self._weight.append(n**2 / np.maximum(are_other.sum(axis=1), 1))
        self._difference.append(difference.mean(axis=1))
        self._light += float(light.sum() - self._weight[-1] @ self._difference[-1])
        is_new = (light[other] == 0.0) & difference.any(axis=1)
        self._n_lit += np.count_nonzero(light) + float(self._weight[-1][is_new].sum())

    def _differences(self, row: np.ndarray, column: np.ndarray, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which samples (K,) by their rows and columns in the window rays find lit or dark otherwise, and by how much.

        Light (K,) [W/m2 per pixel] that was drawn less that of rays.
        """
        n, (x0, y0, *_), seen = self._window.samples, self._window.roi, self._frame.only(self._window.bodies)
        pixel = np.stack([x0 - 0.5 + (column + 0.5) / n, y0 - 0.5 + (row + 0.5) / n], axis=1)
        draw, difference = draws(row, column, n), np.zeros(len(drawn))
        is_other = self._rays.are_lit(pixel, self._frame.camera, seen, draw) != (drawn > 0.0)
        some = np.flatnonzero(is_other)
        difference[some] = drawn[some] - self._rays.irradiance(pixel[some], self._frame.camera, seen, draw[some])
        return is_other, difference

    @property
    def error(self) -> float:
        """RMS error [1] over the mean of the lit pixels, with a deviation of its own; 0 where none is lit."""
        if not self._light > 0.0:
            return 0.0
        squared = np.concatenate(self._weight) * (np.concatenate(self._difference) / (self._light / self._n_lit)) ** 2
        return math.sqrt((squared.sum() + math.sqrt((squared**2).sum())) / self._n_lit)

    @property
    def flux_error(self) -> float:
        """Error of the total light [1], with a deviation of its own; 0 where none is lit."""
        if not self._light > 0.0:
            return 0.0
        difference = np.concatenate(self._weight) * np.concatenate(self._difference) / self._light
        return abs(float(difference.sum())) + math.sqrt(float((difference**2).sum()))
