"""The cells of an image to which areas are added, and the light of their sums."""

from __future__ import annotations

import numpy as np
from glrender_camera import PinholeCamera, threads

from . import accumulate

# Rows of an image that a thread adds up in a turn.
_ROWS = 64


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

    def light(self, changes: np.ndarray, solar_W_m2: float, least_share: float = 1.0, is_even: bool = False
              ) -> tuple[np.ndarray, float]:
        """Means over cells (rows, columns) [W/m2 per pixel], and a sum of squares that is unsure where areas overlap.

        Parameters
        ----------
        changes : (rows, columns + 2) complex128
            In radiance and cover: `accumulate`.
        solar_W_m2 : float [W/m2]
            Irradiance of the Sun at 1 au.
        least_share : float [1]
            The least part of an excess that is taken off where areas overlap.
        is_even : bool
            All pixels have the solid angle of that on the boresight; radiance has the cosines.
        """
        image, cover = np.empty((2, *self.shape))
        across, down = (np.zeros_like(each) if is_even else each for each in self.tangents_squared)
        scale = solar_W_m2 / self.camera.focal_length_px**2
        least = accumulate.ROUNDING * max(threads.run_in_parts(
            lambda part: accumulate.means(changes, part.start, part.stop, image, cover), len(image), _ROWS))
        unsure = threads.run_in_parts(
            lambda part: accumulate.settle(image, cover, part.start, part.stop, least, scale, across, down,
                                           least_share), len(image), _ROWS)
        return image, sum(unsure)
