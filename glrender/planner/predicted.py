"""The error of a frame in each unit that may be asked for, out of the RMS error that its engine tells. Pure.

Errors sit at silhouettes and boundaries of light, and neighbours err alike: by a body that covers A pixels, of whose
disc a share s is lit, the total errs by A^-1/4 s^-1/2 of the RMS error, the centre of brightness by A^1/4 s^-1/2 px,
the limb by A^1/4 s^1/2 px, the mean radius by A^-1/2 s^1/2. What is modelled otherwise takes a tenth of its RMS error
of the flux.
`benchmarks/heldout.py --units` holds the constants against frames that they were not fitted to.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from glrender_camera import PinholeCamera

from ..base.errors import ConfigError
from ..scene.tolerance import SIGMAS, UNITS
from ..view.regions import Group
from ..view.view import BodyView
from .error_budget import FLUX_SHARE, Budget
from .error_model import lit_share

# Errors over the RMS error and the powers above [1] or [px], of flux, centre, limb and range, by how bodies are drawn:
# of 600 frames (`benchmarks/heldout.py --units`, seeds from 5000, 7000, 9000) against float64 rays 95 % are within.
_SAMPLES_OVER_RMS = (0.6, 0.2, 0.45, 2.0)
_CENTROIDS_OVER_RMS = (0.8, 0.13, 0.23, 1.3)
# The same of rough facets, over that of others: 110 frames of 13 shapes (`benchmarks/fits/unit_errors.py`).
_ROUGH = 1.8
_OVER_RMS = {"coverage": (0.45, 0.15, 0.2, 1.15), "centroids": _CENTROIDS_OVER_RMS,
             "rough centroids": tuple(_ROUGH * each for each in _CENTROIDS_OVER_RMS),
             "rays": _SAMPLES_OVER_RMS, "raster": _SAMPLES_OVER_RMS}
# Least errors that are predicted, likewise: the same frames. That of range is of the mean limb [px].
_LEAST = (3e-5, 3e-4, 0.012, 0.002)


def allowed_rms(asked: Mapping[str, float], group: Group, how: str, error_gain: float = 1.0) -> float:
    """The largest RMS error [1], before the camera's point spread function, with which bodies meet tolerances by unit.

    The bodies are in view and drawn together: `how` is a `WindowPlan.how`. Of an error that is independent from pixel
    to pixel the point spread function leaves `error_gain` [1].
    """
    laws, found = _laws(group, how, error_gain), 1.0 / error_gain
    for unit, most in asked.items():
        drawn, modelled, least = laws[unit]
        left = Budget(tolerance=max(most, least)).left_after(least)
        found = min(found, left / max(drawn, modelled))
    return found


def rms_tolerance(max_error: float | Mapping[str, float], views: Sequence[BodyView], camera: PinholeCamera) -> float:
    """The RMS error that a frame by rays may have, of a tolerance in whatever units."""
    if not isinstance(max_error, Mapping):
        return max_error
    if SIGMAS in max_error:
        raise ConfigError(f"max_error.{SIGMAS}", "needs derivatives, which this backend does not draw",
                          max_error[SIGMAS], 'take the backend "auto", or a number for max_error')
    return min((allowed_rms(max_error, Group.of([view], camera), "rays") for view in views if view.is_visible),
               default=1.0)


def frame_errors(drawn: Iterable[tuple[Group, str, float, float]], error_gain: float = 1.0) -> dict[str, float]:
    """Predicted errors of a frame in each unit but `rms`: the largest of its regions.

    Of each region: its bodies, how they are drawn, its RMS error before the point spread function, and the part of
    that which is modelled otherwise.
    """
    found = dict.fromkeys(UNITS[1:], 0.0)
    for group, how, rms, modelling in drawn:
        laws, own = _laws(group, how, error_gain), math.sqrt(max(rms**2 - modelling**2, 0.0))
        for unit, error in found.items():
            of_drawn, of_modelled, least = laws[unit]
            found[unit] = max(error, math.hypot(own * of_drawn, min(modelling, rms) * of_modelled, least))
    return found


def with_eclipse(errors: Mapping[str, float], group: Group, flux_error: float) -> dict[str, float]:
    """Errors by unit, with an error of the total [1] of bodies in a penumbra: their centre moves with it."""
    centre_px = 0.5 * group.side_px * flux_error if flux_error else 0.0
    return {**errors, "flux": math.hypot(errors["flux"], flux_error),
            "centroid_px": math.hypot(errors["centroid_px"], centre_px)}


def _laws(group: Group, how: str, error_gain: float) -> dict[str, tuple[float, float, float]]:
    """Error of each unit over the RMS error of what is drawn, and over that of what is modelled, and the least."""
    side, share = group.side_px, math.sqrt(lit_share(group.phase_rad))
    # The point spread function moves neither flux nor centre, and averages the limb along it alone.
    root, along = math.sqrt(side), math.sqrt(error_gain)
    flux, centre, limb, size = _OVER_RMS[how]
    limb *= along * root * share
    return {"rms": (error_gain, error_gain, 0.0),
            "flux": (flux / root / share, FLUX_SHARE, _LEAST[0]),
            "centroid_px": (centre * root / share, FLUX_SHARE * root, _LEAST[1]),
            "limb_px": (limb, limb, along * _LEAST[2]),
            "range": (size * share / side, FLUX_SHARE / root, _LEAST[3] / side)}
