"""Boxes of meshlets in the image that touch a mask: other meshlets need not be drawn again."""

from __future__ import annotations

import cv2
import numpy as np


def on_mask(boxes_px: np.ndarray, mask: np.ndarray, bounds_px: tuple[float, float, float, float]) -> np.ndarray:
    """Boxes (C,) bool that touch a pixel of a mask.

    Parameters
    ----------
    boxes_px : (C, 4) float64 [px]
        x0, y0, x1, y1.
    mask : (rows, columns) uint8
        0 or 1.
    bounds_px : (float, float, float, float) [px]
        What the mask covers: x0, y0, x1, y1.
    """
    below = cv2.integral(mask)
    x0, y0, x1, y1 = _cells(boxes_px, mask.shape, bounds_px)
    return below[y1, x1] - below[y0, x1] - below[y1, x0] + below[y0, x0] > 0


def _cells(boxes_px: np.ndarray, shape: tuple[int, int], bounds_px: tuple[float, float, float, float]
           ) -> tuple[np.ndarray, ...]:
    """First cells, and those past the last, that boxes touch: x0, y0, x1, y1 (C,) int64."""
    x0, y0, x1, y1 = bounds_px
    rows, columns = shape
    scale = np.array([columns / (x1 - x0), rows / (y1 - y0)] * 2)
    place = (boxes_px - (x0, y0, x0, y0)) * scale
    # A little more, for round-off.
    low, high = np.floor(place[:, :2] - 1e-3), np.ceil(place[:, 2:] + 1e-3)
    return tuple(np.clip(np.concatenate([low, high], axis=1), 0, (columns, rows) * 2).astype(np.int64).T)
