"""Points in an order in which neighbours in space are neighbours in memory.

Source: Morton (1966), A computer oriented geodetic data base: bits of the axes by turns.
"""

from __future__ import annotations

import numpy as np

# Cells along an axis, in bits.
_BITS = 20


def morton_order(points: np.ndarray) -> np.ndarray:
    """Numbers (N,) of points (N, 3) along a curve through all of space."""
    low = points.min(axis=0)
    cells = ((points - low) / max(float(np.ptp(points, axis=0).max()), 1e-300) * (2**_BITS - 1)).astype(np.int64)
    key = np.zeros(len(cells), np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")
