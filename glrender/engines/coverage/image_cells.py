"""The cells of an image to which areas are added, and the light of their sums."""

from __future__ import annotations

import numpy as np
from glrender_camera import PinholeCamera, threads
from glrender_camera.lens_map import LensMap

from . import accumulate

ROWS = 64
"""Rows of an image that are added up in a turn."""


class ImageCells:
    """Cells of a grid in a camera's image.

    Parameters
    ----------
    camera : PinholeCamera
    bounds_px : (float, float, float, float) [px]
        x0, y0, x1, y1 of the grid.
    grid : (int, int)
        Columns and rows.

    Attributes
    ----------
    camera : PinholeCamera
    bounds_px : (4,) float64 [px]
    shape : (int, int)
        Rows and columns.
    per_px : (2,) float64 [1/px]
        Cells across and down.
    """

    def __init__(self, camera: PinholeCamera, bounds_px: tuple[float, float, float, float], grid: tuple[int, int]):
        self.camera, self.bounds_px, self.shape = camera, np.array(bounds_px, float), (grid[1], grid[0])
        self.per_px = np.array(grid) / (self.bounds_px[2:] - self.bounds_px[:2])

    @property
    def origin_px(self) -> np.ndarray:
        """Place (2,) [px] where the first cell begins."""
        return self.bounds_px[:2]

    @property
    def tangents_squared(self) -> tuple[np.ndarray, np.ndarray]:
        """Squares of the tangents of angles off the boresight, of the cells' centres across (C,) and down (R,).

        A pixel's solid angle is (1 + both)^-1.5 of that on the boresight.
        """
        camera, counts = self.camera, self.shape[::-1]
        across, down = (np.square((self.origin_px[k] + (np.arange(counts[k]) + 0.5) / self.per_px[k]
                                   - camera.principal_point_px[k]) / camera.focal_length_px) for k in range(2))
        return across, down

    def light(self, changes: np.ndarray, solar_W_m2: float, is_even: bool = False,
              slopes: np.ndarray | None = None) -> tuple[np.ndarray, float, np.ndarray]:
        """Means over cells (rows, columns) [W/m2 per pixel], and a sum of squares that is unsure where areas overlap.

        And the cover (rows, columns) [1].

        Parameters
        ----------
        changes : (rows, columns + 2) complex128
            In radiance and cover: `accumulate`.
        solar_W_m2 : float [W/m2]
            Irradiance of the Sun at 1 au.
        is_even : bool
            All pixels have the solid angle of that on the boresight; radiance has the cosines.
        slopes : (rows, columns + 2) complex128, optional
            Of a radiance that is that at the first corner of the grid: `SunlitAreas.add_planes_to`.
        """
        image, cover = np.empty((2, *self.shape))
        lens = self.camera.lens_map
        across, down = (np.zeros_like(each) if is_even or lens is not None else each for each in self.tangents_squared)
        scale = solar_W_m2 / self.camera.focal_length_px**2
        largest = max(threads.run_in_parts(
            lambda part: accumulate.means(changes, part.start, part.stop, image, cover), len(image), ROWS))
        if slopes is not None:
            by_x, by_y = np.empty((2, *self.shape))
            accumulate.means(slopes, 0, len(image), by_x, by_y)
            x, y = ((np.arange(count) + 0.5) / per_px
                    for count, per_px in zip(self.shape[::-1], self.per_px, strict=True))
            image += by_x * x + by_y * y[:, None]
            largest = float(image.max())
        least = accumulate.ROUNDING * largest
        unsure = threads.run_in_parts(
            lambda part: accumulate.settle(image, cover, part.start, part.stop, least, scale, across, down),
            len(image), ROWS)
        if lens is not None and not is_even:
            image *= self._solid_angles(lens)
        return image, sum(unsure), cover

    def _solid_angles(self, lens: LensMap) -> np.ndarray:
        """Solid angle of a pixel at each cell's middle (rows, columns) over that on the boresight without the lens."""
        (x0, y0), (rows, columns) = self.origin_px, self.shape
        if (self.per_px == 1.0).all() and not ((self.origin_px + 0.5) % 1.0).any():
            left, top = int(x0 + 0.5), int(y0 + 0.5)
            return lens.pixels_solid_angles[top:top + rows, left:left + columns]
        x, y = (start + (np.arange(n) + 0.5) / each
                for start, n, each in zip((x0, y0), (columns, rows), self.per_px, strict=True))
        xy = self.camera.normalised(np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2))
        # A small body's own grid may reach beyond what the lens images: where there is no light.
        return np.nan_to_num(lens.solid_angles(xy.T)).reshape(rows, columns)

    def sums(self, changes: np.ndarray) -> np.ndarray:
        """Amounts (rows, columns) that changes (rows, columns + 2) add up to, without what is rounding."""
        image, cover = np.empty((2, *self.shape))
        largest = accumulate.means(changes, 0, len(image), image, cover)
        image[image < accumulate.ROUNDING * largest] = 0.0
        return image
