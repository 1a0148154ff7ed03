"""The error of a frame in each unit that may be asked for, out of the RMS error of its regions. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from glrender_camera import PinholeCamera

from ..scene.tolerance import UNITS
from ..view.regions import region
from ..view.view import BodyView

_FACTORS = {how: dict.fromkeys(UNITS[1:], 1.0) for how in ("centroids", "coverage", "rays", "raster")}


def per_rms(members: Sequence[BodyView], camera: PinholeCamera, how: str, error_gain: float = 1.0) -> dict[str, float]:
    """Error of each unit over the RMS error before the camera's point spread function.

    Parameters
    ----------
    members : sequence of BodyView
        Bodies that are drawn together.
    camera : PinholeCamera
    how : "centroids", "coverage", "rays" or "raster"
    error_gain : float [1]
        What the point spread function leaves of an error that is independent from pixel to pixel.
    """
    x0, y0, x1, y1 = region(members, camera)
    return {unit: 1.0 for unit in UNITS} | {"rms": error_gain}


def allowed_rms(asked: Mapping[str, float], members: Sequence[BodyView], camera: PinholeCamera, how: str,
                error_gain: float = 1.0) -> float:
    """The largest RMS error, before the point spread function, with which bodies meet all that is asked."""
    factors = per_rms(members, camera, how, error_gain)
    return min(asked[unit] / factors[unit] for unit in asked)


def rms_tolerance(max_error: float | Mapping[str, float], views: Sequence[BodyView], camera: PinholeCamera) -> float:
    """The RMS error that a frame by rays may have, of a tolerance in whatever units."""
    if not isinstance(max_error, Mapping):
        return max_error
    return min([allowed_rms(max_error, [view], camera, "rays") for view in views if view.is_visible] + [1.0])


def frame_errors(drawn: Iterable[tuple[Sequence[BodyView], str, float]], camera: PinholeCamera,
                 error_gain: float = 1.0) -> dict[str, float]:
    """Predicted errors of a frame in each unit but `rms`: the largest of its regions.

    Each region is told by its bodies, how they are drawn, and its RMS error after the point spread function.
    """
    found = dict.fromkeys(UNITS[1:], 0.0)
    for members, how, rms in drawn:
        factors = per_rms(members, camera, how, error_gain)
        found = {unit: max(error, rms / error_gain * factors[unit]) for unit, error in found.items()}
    return found
