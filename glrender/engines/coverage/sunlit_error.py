"""The error to expect of sunlit areas that are found by their corners, out of the light of facets and parts. Pure.

Squared errors are sums over an image, in units of radiance squared times pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...planner.error_model import CRESCENT_RAD, crescent_gain

# Errors are estimated from the light of triangles that are clipped: 35 low-poly and 12 finer shapes at 20 to 160 deg
# against rays (test_coverage_engine.py, benchmarks/heldout.py).
CLIPPED_ERROR = 0.006625
"""Squared error of one of many clipped triangles over its squared light [1]."""
# Share [1] of their light that clipped triangles are too dark by, at 60 deg.
_CLIPPED_BIAS = 0.003
# Safety factor [1] of that error over 1, times the root of the number of triangles that matter.
_SAFETY_OF_FEW = 16.0
# Squared error of boundaries that pass between corners that agree, over squared light of clipped triangles [1] up to
# 60 deg, per radian between neighbouring facets, of this much at least: 100 frames of seven shapes, against rays.
_MISSED_PER_RAD = 5e-3
_LEAST_CREASE_RAD = 0.2
# Share of the squared light of the brightest facet that another body may take between its corners unseen [1].
_MISSED_BEHIND = 0.1
# RMS error of a hard edge over that of the ramp in its place [1]: Itokawa at 60 and 120 deg (test_penumbra.py).
_PENUMBRA = 0.65
# Least error [1] that is estimated: a facet's radiance at its centroid for the whole facet, and rays in float32.
_LEAST = 5e-4


class CoverageError(NamedTuple):
    """The estimated error of an image [1]: RMS over the mean of lit pixels, or flux over a share where that is more.

    Attributes
    ----------
    judged : float
        By `Budget.flux_share`: what the tolerance is compared with.
    rms : float
        By `FLUX_SHARE`, which no point spread function changes: what errors in every unit are predicted from.
    """

    judged: float
    rms: float


NOTHING_DRAWN = CoverageError(math.inf, math.inf)
"""The error where nothing is drawn."""


@dataclass(frozen=True, kw_only=True)
class ErrorScale:
    """An image's RMS error over the mean of its lit pixels [1], or its flux error over its share, by a squared error.

    Attributes
    ----------
    light : float
        All light of the image, in units of radiance times pixels.
    n_px : float
        Pixels that are lit.
    phase_rad : float [rad]
    flux_share : float [1]
        Tolerance of the total light over that of the RMS error: `Budget.flux_share`.
    """

    light: float
    n_px: float
    phase_rad: float
    flux_share: float

    def over(self, lit_px: float) -> ErrorScale:
        """The same where thin parts of bodies share that many pixels with the sky: half of them count at least.

        Outlines are in what errors were fitted to, and crescents have a factor of their own.
        """
        return self if self.phase_rad > CRESCENT_RAD else replace(self, n_px=max(self.n_px, 0.5 * lit_px))

    @property
    def per_root(self) -> float:
        """RMS error [1] over the root of a squared error."""
        return crescent_gain(self.phase_rad) * max(math.sqrt(self.n_px), 1.0 / self.flux_share) / self.light

    @property
    def flux_weight(self) -> float:
        """Weight of the squared error of the total light in a squared error."""
        return (self.flux_share * self.per_root * self.light) ** -2

    def rms(self, squared: float) -> float:
        """RMS error [1] of a squared error."""
        return self.per_root * math.sqrt(squared)

    def error(self, squared: float) -> float:
        """The same with the least that is estimated."""
        return math.hypot(self.rms(squared), _LEAST)

    def most_squared(self, tolerance: float) -> float:
        """Squared error that is within a tolerance [1]."""
        return max(tolerance**2 - _LEAST**2, _LEAST**2) / self.per_root**2

    def of_penumbras(self, hard: float, low: list[tuple[float, float]]) -> float:
        """Squared error of hard edges in place of penumbras, and of bodies' facets (squared, light) in a low Sun.

        By pixels alone: penumbras take no flux, a low Sun does.
        """
        return hard * min(self.n_px * self.flux_share**2, 1.0) + max(
            sum(squared for squared, _ in low), self.flux_weight * sum(missed for _, missed in low) ** 2)


def pixels_squared(radiance: np.ndarray | float, area_px: np.ndarray) -> np.ndarray:
    """Squared light (N,) of areas (N,), of a pixel's share of each."""
    return radiance**2 * area_px * np.minimum(area_px, 1.0)


def safety_squared(squared: np.ndarray) -> float:
    """Squared safety factor of an estimate from squared lights (N,): it falls with the number of those that matter.

    No triangle errs by more than half of its light.
    """
    n_clipped = float(squared.sum()) ** 2 / max(float((squared * squared).sum()), 1e-300)
    return min((1.0 + _SAFETY_OF_FEW / math.sqrt(max(n_clipped, 1.0))) ** 2, 0.25 / CLIPPED_ERROR)


def clipped_bias(light: np.ndarray) -> float:
    """Light that clipped triangles (N,) are too dark by."""
    return _CLIPPED_BIAS * float(light.sum())


def missed(squared: float, crease_rad: float, phase_rad: float) -> float:
    """Squared error of boundaries that pass between corners that agree, of the squared light of clipped triangles.

    The lower the Sun, the longer are the shadows of features narrower than a facet.
    """
    low_sun = max(math.tan(min(0.5 * phase_rad, 1.5)) / math.tan(math.radians(30.0)), 1.0)
    return _MISSED_PER_RAD * max(crease_rad, _LEAST_CREASE_RAD) * low_sun * squared


def missed_behind(squared: np.ndarray) -> float:
    """Squared error of what another body, smaller than facets (N,) of squared light, may hide between their corners."""
    return _MISSED_BEHIND * float(squared.max(initial=0.0))


def hard_edges(radiance: np.ndarray, area_px: np.ndarray, wide_px: np.ndarray) -> np.ndarray:
    """Squared errors (N,) of hard edges of shadows across triangles (N,) in place of ramps of a width (N,) [px].

    Within a pixel a ramp has the light of a hard edge, and errs where the pixels' sides cross it: the mean over how
    the sides lie, as one along a ramp may cross the whole ramp.
    """
    squared = radiance**2 * np.sqrt(area_px) * wide_px * np.minimum(wide_px, 1.0) ** 2
    return _PENUMBRA**2 / 12.0 * squared


def low_sun(brdf: np.ndarray, cosines: np.ndarray, area_px: np.ndarray, sun_radius_rad: float, set_px: float,
            all_px: float) -> tuple[float, float]:
    """Squared error, and light, of facets (N,) that part of the Sun's disc lights, drawn with a Sun without a disc.

    A facet at which the Sun's middle stands as high as a share u of its radius has the mean of max(0, u + t) over the
    disc (closed form) in place of u. Those of an area `set_px` for which it has set are taken to be alike, with the
    mean over u from -1 to 0, a sixteenth, and as bright as all are, which have an area `all_px`.
    """
    set_light = set_px * sun_radius_rad / 16.0 * float((brdf * area_px).sum()) / max(all_px, 1e-300)
    low = np.flatnonzero(cosines < sun_radius_rad)
    u, area_px = cosines.take(low) / sun_radius_rad, area_px.take(low)
    root = np.sqrt(np.maximum(1.0 - u * u, 0.0))
    more = u * ((u * root + np.arcsin(np.minimum(u, 1.0))) / np.pi - 0.5) + 2.0 / (3.0 * np.pi) * root**3
    light = brdf.take(low) * sun_radius_rad * more
    # Those of a pixel are alike.
    squared = float(pixels_squared(light, area_px).sum()) + set_light**2 / max(set_px, 1.0)
    return squared, float((light * area_px).sum()) + set_light
