"""Points in an order in which neighbours in space are neighbours in memory.

Source: Morton (1966), A computer oriented geodetic data base: bits of the axes by turns.
"""

from __future__ import annotations

import numpy as np

# Cells along an axis, in bits.
_BITS = 20
# Shifts and masks that move up to 21 bits three places apart, in halves.
_SPREAD = ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
           (2, 0x1249249249249249))


def morton_order(points: np.ndarray) -> np.ndarray:
    """Numbers (N,) of points (N, 3) along a curve through all of space."""
    low = points.min(axis=0)
    cells = ((points - low) / max(float(np.ptp(points, axis=0).max()), 1e-300) * (2**_BITS - 1)).astype(np.int64)
    key = np.zeros(len(cells), np.int64)
    for axis in range(3):
        bits = np.ascontiguousarray(cells[:, axis])
        for shift, mask in _SPREAD:
            bits = (bits | bits << shift) & mask
        key |= bits << axis
    return np.argsort(key, kind="stable")
