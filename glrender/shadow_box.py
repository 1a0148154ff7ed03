"""Which part of a body its shadow map covers: no more than what the camera sees of it in sunlight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# A texel is then 2^-20 radii of a map of 4096: float32 coordinates have 2^-24.
_MOST_HALVINGS = 8
# The box moves in steps of a quarter of its side, so that a map serves while the camera drifts.
_STEPS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class ShadowBox:
    """A part of a body's box in frame `sun`.

    Attributes
    ----------
    low_m, high_m : (3,) float64 [m]
    halvings : int
        The body's sides over the box's, as a power of two.
    """

    low_m: np.ndarray
    high_m: np.ndarray
    halvings: int


def shadow_box(whole: tuple[np.ndarray, np.ndarray], seen: tuple[np.ndarray, np.ndarray] | None) -> ShadowBox:
    """The body's own box, or a part of it on a grid that holds all that is seen.

    Parameters
    ----------
    whole : (3,) and (3,) float64 [m]
        Least and largest coordinates of the body in frame `sun`.
    seen : the same, or None
        Of what is seen of it; None for all.
    """
    low, high = whole
    if seen is not None:
        side = (high - low)[:2]
        seen_low = np.maximum(seen[0], low)[:2]
        share = float(np.max((np.minimum(seen[1], high)[:2] - seen_low) / side))
        # All of it fits although the grid may put a step of the box before it.
        halvings = math.floor(math.log2((1.0 - 1.0 / _STEPS) / max(share, 2.0**-_MOST_HALVINGS)))
        if halvings > 0:
            halvings = min(halvings, _MOST_HALVINGS)
            side = side / 2**halvings
            corner = low[:2] + np.floor((seen_low - low[:2]) / side * _STEPS) * side / _STEPS
            return ShadowBox(low_m=np.append(corner, low[2]), high_m=np.append(corner + side, high[2]),
                             halvings=halvings)
    return ShadowBox(low_m=low, high_m=high, halvings=0)
