"""The cells that one draw fills: the pixels themselves, or finer ones across a body of few pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from glrender_camera import PinholeCamera

from ...view.regions import Group

# A body that is smaller than the first has this many cells across its outline; below the second they are fitted to it.
_SMALL_PX, _TINY_PX, _CELLS = 32.0, 2.0, 64
_MARGIN = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Lens:
    """The image that Blender draws: cells, of which a region is drawn, and the pixels that they give.

    Attributes
    ----------
    size : (int, int)
        Cells across and down.
    region : (int, int, int, int)
        Cells that are drawn: x0, y0, x1, y1, one past the last.
    focal_length, centre : float, (2,) float [cells]
        Of the camera; `centre` is the principal point, (0, 0) the middle of the first cell.
    extent : float [cells]
        Larger side of the bodies' box; infinite where a body reaches behind the camera's plane.
    roi : (int, int, int, int) [px]
        Pixels that the cells give.
    left_top_px : (2,) float [px]
        Edge of the first cell.
    cells_per_px : float
    """

    size: tuple[int, int]
    region: tuple[int, int, int, int]
    focal_length: float
    centre: np.ndarray
    extent: float
    roi: tuple[int, int, int, int]
    left_top_px: np.ndarray
    cells_per_px: float

    @classmethod
    def of(cls, group: Group, camera: PinholeCamera) -> Lens:
        """The lens for bodies that are drawn together."""
        roi, low, sides = group.roi, np.full(2, -0.5), np.full(2, np.inf)
        if group.outline is not None:
            low, high = np.reshape(group.outline, (2, 2))
            sides = high - low
        extent_px = float(sides.max())
        principal = np.array(camera.principal_point_px)
        if extent_px >= _SMALL_PX:
            return cls(size=(camera.width_px, camera.height_px), region=roi, focal_length=camera.focal_length_px,
                       centre=principal, extent=extent_px, roi=roi, left_top_px=np.full(2, -0.5), cells_per_px=1.0)
        if extent_px >= _TINY_PX:
            # Whole cells to a pixel: what a cell blurs stays in its pixel.
            corner, per_px = np.array(roi[:2]) - 0.5, float(np.ceil(_CELLS / extent_px))
            across, down = (int(per_px) * (high - low) for low, high in (roi[::2], roi[1::2]))
        else:
            corner, per_px = low - _MARGIN * extent_px, _CELLS / extent_px
            across, down = (int(n) for n in np.ceil((sides + 2.0 * _MARGIN * extent_px) * per_px))
        return cls(size=(across, down), region=(0, 0, across, down), focal_length=per_px * camera.focal_length_px,
                   centre=(principal - corner) * per_px - 0.5, extent=per_px * extent_px, roi=roi, left_top_px=corner,
                   cells_per_px=per_px)

    def solid_angles_sr(self) -> np.ndarray:
        """Solid angle [sr] of a whole pixel at each cell of the region, (rows, columns)."""
        x0, y0, x1, y1 = self.region
        x, y = ((np.arange(low, high) - c) / self.focal_length for low, high, c in (
            (x0, x1, self.centre[0]), (y0, y1, self.centre[1])))
        return (self.cells_per_px / self.focal_length) ** 2 * (1.0 + x[None, :] ** 2 + y[:, None] ** 2) ** -1.5

    def pixels(self, cells: np.ndarray) -> np.ndarray:
        """Pixels of `roi` (rows, columns) out of the region's cells: each takes part by the area that it shares."""
        if self.cells_per_px == 1.0:
            return cells
        x0, y0, x1, y1 = self.roi
        across, down = (_shares(self.left_top_px[axis], self.size[axis], 1.0 / self.cells_per_px, low, high)
                        for axis, (low, high) in enumerate(((x0, x1), (y0, y1))))
        return down @ cells @ across.T

    @property
    def min_cosine(self) -> float:
        """Least cosine of the angle off the boresight: that of the farthest corner."""
        corner = np.array([[x, y] for x in (-0.5, self.size[0] - 0.5) for y in (-0.5, self.size[1] - 0.5)])
        return float(1.0 / np.sqrt(1.0 + (((corner - self.centre) / self.focal_length) ** 2).sum(axis=1)).max())


def _shares(start_px: float, n_cells: int, cell_px: float, first: int, last: int) -> np.ndarray:
    """Lengths [px] (pixels, cells) that pixels of an axis share with cells."""
    edge = start_px + np.arange(n_cells + 1) * cell_px
    pixel = np.arange(first, last)[:, None]
    return np.maximum(np.minimum(edge[1:], pixel + 0.5) - np.maximum(edge[:-1], pixel - 0.5), 0.0)
