"""Which part of a body its shadow map covers: no more than what the camera sees of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

# Texels beside what must be covered: a lookup at its edge still meets the map.
_MARGIN = 2
# A part moves and grows in steps of an eighth of itself, so that a map serves while the camera drifts.
_STEPS, _LEAST_STEP = 8, 16


@dataclass(frozen=True, kw_only=True, eq=False)
class ShadowBox:
    """A box in frame `sun`, a whole number of texels.

    Attributes
    ----------
    low_m, high_m : (3,) float64 [m]
    size_px : (int, int)
        Texels along x and y.
    texel_m : (2,) float64 [m]
        Along x and y: a low Sun sees flat ground foreshortened, and texels with it.
    """

    low_m: np.ndarray
    high_m: np.ndarray
    size_px: tuple[int, int]
    texel_m: np.ndarray


def shadow_box(low_m: np.ndarray, high_m: np.ndarray, seen: tuple[np.ndarray, np.ndarray] | None,
               texels: int) -> ShadowBox:
    """The body's own box, or the part of it, on a grid, that holds what is seen.

    Parameters
    ----------
    low_m, high_m : (3,) float64 [m]
        Least and largest coordinates of the body in frame `sun`.
    seen : (3,) and (3,) float64 [m], or None
        The same of what is seen of it; None for all.
    texels : int
        Along each of the body's sides.
    """
    texel_m = (high_m - low_m)[:2] / texels
    first, last = np.zeros(2), np.full(2, float(texels))
    if seen is not None:
        part = [np.clip((edge - low_m)[:2] / texel_m, first, last) for edge in seen]
        # Steps of a power of two: as the part grows, the grid changes seldom.
        step = max(2 ** math.ceil(math.log2(max(float(np.max(part[1] - part[0])), 1.0) / _STEPS)), _LEAST_STEP)
        first, last = np.floor(part[0] / step) * step, np.minimum(np.ceil(part[1] / step) * step, last)
    first, last = first - _MARGIN, last + _MARGIN
    width, height = (last - first).astype(int)
    return ShadowBox(low_m=np.append(low_m[:2] + first * texel_m, low_m[2]),
                     high_m=np.append(low_m[:2] + last * texel_m, high_m[2]),
                     size_px=(int(width), int(height)), texel_m=texel_m)
