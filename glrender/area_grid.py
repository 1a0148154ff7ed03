"""A small body's own grid of samples, shared among an image's pixels by area."""

from __future__ import annotations

import math

import numpy as np


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
    light = down @ samples.astype(np.float64) @ across.T
    irradiance[top:top + len(down), left:left + len(across)] += light.astype(np.float32)


def _overlaps(low: float, high: float, n_cells: int, n_px: int) -> tuple[int, np.ndarray]:
    """First pixel, and lengths [px] (pixels, cells) that pixels of an axis share with even cells from low to high."""
    first, last = max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5), n_px - 1)
    edge = low + np.arange(n_cells + 1) * (high - low) / n_cells
    pixel = np.arange(first, last + 1)[:, None]
    return first, np.maximum(np.minimum(edge[1:], pixel + 0.5) - np.maximum(edge[:-1], pixel - 0.5), 0.0)
