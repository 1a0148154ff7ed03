"""A small body's own grid of samples: shared among an image's pixels by area, or kept apart as points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from glrender_camera import PointSources
from scipy.sparse import csr_array

from ..planner.small_body_grid import CELL_PX


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallBody:
    """The light of a body of some pixels, or far less than one; of several where they touch.

    Attributes
    ----------
    names : tuple of str
    size_px : float [px]
        Larger side of its outline's box.
    irradiance_W_m2 : float [W/m2]
        All of its light at the camera, what the image cuts off included.
    xy_px : (2,) float64 [px]
        Centre of brightness, in `pixel`; of the outline's box while it is dark.
    is_apart : bool
        Whether it is not in the image.
    points : PointSources
        The same light where it comes from: cells of 0.3 px or less, each at its own centre of brightness.
    """

    names: tuple[str, ...]
    size_px: float
    irradiance_W_m2: float
    xy_px: np.ndarray
    is_apart: bool
    points: PointSources

    @classmethod
    def from_grid(cls, names: tuple[str, ...], samples: np.ndarray, bounds_px: tuple[float, float, float, float], *,
                  size_px: float, is_apart: bool) -> SmallBody:
        """From a grid of samples (rows, columns) [W/m2 per pixel] over x0, y0, x1, y1 [px]."""
        x0, y0, x1, y1 = bounds_px
        n_y, n_x = samples.shape
        # At least one sample a cell.
        each_y, each_x = (max(int(n * min(CELL_PX / side, 1.0)), 1) for n, side in ((n_y, y1 - y0), (n_x, x1 - x0)))
        rows, columns = -(-n_y // each_y), -(-n_x // each_x)
        light = np.zeros((rows * each_y, columns * each_x))
        light[:n_y, :n_x] = samples
        light *= (x1 - x0) * (y1 - y0) / samples.size
        # Light, and its moments about the first corner: float64 places of far smaller bodies do not cancel.
        x, y = ((np.arange(n) + 0.5) * side for n, side in ((light.shape[1], (x1 - x0) / n_x),
                                                            (light.shape[0], (y1 - y0) / n_y)))
        light = light.reshape(rows, each_y, -1)
        light, light_y = light.sum(axis=1), np.einsum("ijk,ij->ik", light, y.reshape(rows, each_y))
        cells, moment_x, moment_y = (part.reshape(rows, columns, each_x).sum(axis=2)
                                     for part in (light, light * x, light_y))
        lit = cells > 0.0
        places = np.stack([moment_x[lit], moment_y[lit]], axis=1)
        total = float(cells.sum())
        centre = places.sum(axis=0) / total if total > 0.0 else 0.5 * np.array([x1 - x0, y1 - y0])
        return cls(names=names, size_px=size_px, is_apart=is_apart, irradiance_W_m2=total,
                   xy_px=centre + (x0, y0), points=PointSources(places / cells[lit][:, None] + (x0, y0), cells[lit]))


def add_by_area(irradiance: np.ndarray, samples: np.ndarray, bounds_px: tuple[float, float, float, float]) -> None:
    """Add a grid of samples to the pixels that their cells overlap.

    Parameters
    ----------
    irradiance : (height, width) float32
        Changed in place.
    samples : (rows, columns) float32
        Means over their cells.
    bounds_px : (float, float, float, float) [px]
        Of the grid: x0, y0, x1, y1.
    """
    x0, y0, x1, y1 = bounds_px
    left, across = _overlaps(x0, x1, samples.shape[1], irradiance.shape[1])
    top, down = _overlaps(y0, y1, samples.shape[0], irradiance.shape[0])
    # Most do not overlap; and BLAS keeps threads of its own spinning for a tenth of a second.
    light = (csr_array(across) @ (csr_array(down) @ samples.astype(np.float64)).T).T
    irradiance[top:top + len(down), left:left + len(across)] += light.astype(np.float32)


def _overlaps(low: float, high: float, n_cells: int, n_px: int) -> tuple[int, np.ndarray]:
    """First pixel, and lengths [px] (pixels, cells) that pixels of an axis share with even cells from low to high."""
    first, last = max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5), n_px - 1)
    edge = low + np.arange(n_cells + 1) * (high - low) / n_cells
    pixel = np.arange(first, last + 1)[:, None]
    return first, np.maximum(np.minimum(edge[1:], pixel + 0.5) - np.maximum(edge[:-1], pixel - 0.5), 0.0)
