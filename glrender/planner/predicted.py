"""The error of a frame in each unit that may be asked for, out of the RMS error that its engine tells. Pure.

Errors sit at silhouettes and at boundaries of light, and those of neighbouring pixels are alike: of A pixels that a
body covers, the total errs by A^-1/8 of the RMS error, the centre of brightness by A^1/8 px, the limb by A^1/8 px and
less the thinner the crescent, the mean radius by the limb's error over the root of A. The constants hold 96.5 % of the
frames of `benchmarks/heldout.py --units` that they were fitted to; other seeds check them (docs/accuracy.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from glrender_camera import PinholeCamera

from ..scene.tolerance import UNITS
from ..view.regions import outline, region
from ..view.view import BodyView
from .error_model import lit_share

# Errors over the RMS error and the powers above [1] or [px], of flux, centre, limb and range: seeds 1000 to 1399.
_OVER_RMS = {"coverage": (0.29, 0.35, 0.86, 0.42), "centroids": (0.18, 0.265, 0.425, 0.73),
             "rays": (0.48, 0.49, 1.15, 1.74), "raster": (0.48, 0.49, 1.15, 1.74)}
# Least errors that are predicted, likewise: the same seeds. That of range is of the mean limb [px].
_LEAST = (3e-5, 3e-4, 0.012, 0.002)
# Of a tolerance, or of the least error where that is more [1], what the RMS error may take at least.
_LEAST_LEFT = 0.3


def allowed_rms(asked: Mapping[str, float], members: Sequence[BodyView], camera: PinholeCamera, how: str,
                error_gain: float = 1.0) -> float:
    """The largest RMS error, before the camera's point spread function, with which bodies meet all that is asked.

    Parameters
    ----------
    asked : mapping
        Tolerances by unit: `tolerance.UNITS`.
    members : sequence of BodyView
        Bodies in view that are drawn together.
    camera : PinholeCamera
    how : "coverage", "centroids", "rays" or "raster"
    error_gain : float [1]
        What the point spread function leaves of an error that is independent from pixel to pixel.
    """
    laws, found = _laws(members, camera, how, error_gain), 1.0 / error_gain
    for unit, most in asked.items():
        slope, least = laws[unit]
        found = min(found, max(math.sqrt(max(most**2 - least**2, 0.0)), _LEAST_LEFT * max(most, least)) / slope)
    return found


def rms_tolerance(max_error: float | Mapping[str, float], views: Sequence[BodyView], camera: PinholeCamera) -> float:
    """The RMS error that a frame by rays may have, of a tolerance in whatever units."""
    if not isinstance(max_error, Mapping):
        return max_error
    return min((allowed_rms(max_error, [view], camera, "rays") for view in views if view.is_visible), default=1.0)


def frame_errors(drawn: Iterable[tuple[Sequence[BodyView], str, float]], camera: PinholeCamera,
                 error_gain: float = 1.0) -> dict[str, float]:
    """Predicted errors of a frame in each unit but `rms`: the largest of its regions.

    Each region is told by its bodies, how they are drawn, and its RMS error after the point spread function.
    """
    found = dict.fromkeys(UNITS[1:], 0.0)
    for members, how, rms in drawn:
        laws = _laws(members, camera, how, error_gain)
        found = {unit: max(error, math.hypot(rms / error_gain * laws[unit][0], laws[unit][1]))
                 for unit, error in found.items()}
    return found


def _laws(members: Sequence[BodyView], camera: PinholeCamera, how: str, error_gain: float
          ) -> dict[str, tuple[float, float]]:
    """Error of each unit over the RMS error before the point spread function, and the least that is predicted."""
    # The point spread function moves neither flux nor centre, and averages the limb along it alone.
    along = math.sqrt(error_gain)
    side, eighth = _side(members, camera), _side(members, camera) ** 0.25
    share = math.sqrt(lit_share(max(view.phase_rad for view in members)))
    powers = (1.0 / eighth, eighth, along * eighth * share, share / side)
    least = (_LEAST[0], _LEAST[1], along * _LEAST[2], _LEAST[3] / side)
    slopes = [over * power for over, power in zip(_OVER_RMS[how], powers, strict=True)]
    return {"rms": (error_gain, 0.0), **dict(zip(UNITS[1:], zip(slopes, least, strict=True), strict=True))}


def _side(members: Sequence[BodyView], camera: PinholeCamera) -> float:
    """Root of the area [px] of the part of the bodies' box that is in the image."""
    x0, y0, x1, y1 = region(members, camera)
    width, height = float(x1 - x0), float(y1 - y0)
    if all(view.bounds_px is not None for view in members):
        left, top, right, bottom = outline(members)
        width, height = min(right - left, width), min(bottom - top, height)
    return math.sqrt(max(width * height, 1e-6))
