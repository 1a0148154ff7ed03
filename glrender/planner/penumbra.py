"""The penumbras on a body, of its own shadows and of other bodies': their widths, and the error of hard edges. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..base.rotations import sun_from_body
from ..scene.shape.convex_hull import Hull
from ..view.occluders import Caster
from ..view.sun_disc import on_disc
from ..view.view import BodyView
from .error_budget import PENUMBRA_SHARE, Budget

SUN_POINTS = ((4, 0.4), (8, 0.25))
"""Points of the Sun's disc, and the share of a hard edge's error [1] that steps of so many leave (test_penumbra.py)."""
# RMS error of hard edges in place of a body's own penumbras at 1 rad and 1 au: Itokawa at 500 px has 0.0039, a contact
# binary of 400 px 0.0052 (test_penumbra.py); and the size from which it is that.
_OWN_ERROR = 0.0055
_OWN_PX = 300.0
# Width of a body's own penumbras over its size at 1 au [1]: the Sun's angle times a tenth of the size.
_OWN_WIDTH = 1e-3
# Brightness of a sphere's middle at full phase over the mean of its disc by Lambert's law [1]: where a shadow may fall.
_HARD_EDGE = 1.5
# Points of the lit part of a sphere's image at which an eclipse is computed.
_POINTS = 400
# Most distance of a shadow from where a sphere's is, along the line to its light, over its radius [1]: bodies are no
# spheres.
_ASIDE = 0.3
# Penumbra width over body size [1] above which rays sample the Sun's disc.
_WITHIN = 0.3
# Width of a penumbra from which it is more than an edge [px], and over the body's size [1].
_LEAST_PX, _LEAST = 0.25, 0.02
# Least and largest share of the light [1] that an eclipse may leave: it is computed for spheres, not for the shapes.
_LEAST_LIGHT, _MOST_LIGHT = 0.02, 0.5


@dataclass(frozen=True, kw_only=True)
class Penumbra:
    """The penumbras on one body in one frame: none of a point Sun."""

    hard_error: float = 0.0
    """RMS error [1] of hard edges in their place."""
    hard_flux: float = 0.0
    """Error of the body's light [1] with hard edges in place of other bodies' penumbras."""
    own_px: float = 0.0
    """Width of the widest that the body casts on itself."""
    cast_px: float = 0.0
    """Width of the widest that another body casts on it, no wider than that body."""
    eclipse_px: float = 0.0
    """The same, however small that body: the Sun's angle times the distance."""
    annular_error: float = 0.0
    """The part of `hard_error` by bodies that nowhere hide all of the Sun: a small dark shadow in place of a faint wide
    one, which may pass between the corners of facets."""
    left: float = 1.0
    """Share of the light in view that other bodies leave, all being spheres."""

    @property
    def width_px(self) -> float:
        """Width of the widest."""
        return max(self.own_px, self.cast_px)

    def surrounds(self, size_px: float, budget: Budget) -> bool:
        """Whether another body's penumbra sharpens no edge on a body of that size, or ends outside it."""
        return (self.cast_px > _WITHIN * size_px or self.hard_flux > PENUMBRA_SHARE * budget.flux
                or self.annular_error > PENUMBRA_SHARE * budget.tolerance)

    def sampled_px(self, size_px: float) -> float:
        """Width [px] of another body's penumbra on a body of that size, by whose noise rays err; 0 for an edge."""
        return self.eclipse_px if self.eclipse_px > min(_LEAST_PX, _LEAST * size_px) else 0.0

    def noise(self, size_px: float) -> float:
        """Share of a body of that size which another's penumbra may cover, about, times dark over lit samples there."""
        left = min(max(self.left, _LEAST_LIGHT), _MOST_LIGHT)
        return min(self.eclipse_px / max(size_px, 1e-9), 1.0) * (1.0 - left) / left


def penumbra_of(view: BodyView, cast: Sequence[Caster], hulls: Mapping[str, Hull],
                sun_radius_rad: float) -> Penumbra:
    """The penumbras on a body.

    Parameters
    ----------
    view : BodyView
    cast : sequence of Caster
        Bodies that may cast a shadow on it: `occluders.casters`.
    hulls : mapping of str to Hull
    sun_radius_rad : float [rad]
        Angular radius of the Sun; 0 for a point.
    """
    if not sun_radius_rad > 0.0:
        return Penumbra()
    own, own_px = (0.0, 0.0) if hulls[view.name].is_convex else _own(view)
    if not cast:
        return Penumbra(hard_error=own, own_px=own_px)
    error, annular_error, cast_px = _cast(view, cast, hulls, sun_radius_rad)
    left, hard_flux, width_m = _eclipse(view, cast, hulls, sun_radius_rad)
    return Penumbra(hard_error=math.hypot(own, error), own_px=own_px, cast_px=cast_px, hard_flux=hard_flux,
                    eclipse_px=width_m / view.footprint_m, annular_error=annular_error, left=left)


def sun_points(error: float, tolerance: float) -> tuple[int, float]:
    """The fewest points of the Sun's disc by which a penumbra's error [1] fits a tolerance, or the most.

    And the share [1] of the error that they leave.
    """
    return next(((n_points, share) for n_points, share in ((1, 1.0), *SUN_POINTS)
                 if share * error <= PENUMBRA_SHARE * tolerance), SUN_POINTS[-1])


def _own(view: BodyView) -> tuple[float, float]:
    """RMS error [1] of hard edges in place of the penumbras of a body's shadows on itself, and the widest one's [px].

    Itokawa, 500 px across at 1 au, has 0.0041 at 60 deg, 0.0094 at 120; a contact binary of 400 px 0.0054 at 60 deg.
    """
    size_px = view.finest_px
    error = _OWN_ERROR * view.phase_rad * min(size_px / _OWN_PX, 1.0) / math.sqrt(view.sun_distance_au)
    return error, _OWN_WIDTH * size_px / view.sun_distance_au


def _cast(receiver: BodyView, cast: Sequence[Caster], hulls: Mapping[str, Hull],
          sun_radius_rad: float) -> tuple[float, float, float]:
    """RMS error [1] of hard edges in place of the casters' penumbras, over the mean of the lit pixels; widest [px].

    Between them the same error of casters that nowhere hide all of the Sun. Each edge is taken to be as long as the
    outline of the smaller body, and the receiver to be lit as a sphere is.
    """
    squared = annular = widest_px = 0.0
    radius_px = hulls[receiver.name].radius_m / receiver.footprint_m
    for caster in cast:
        sunward_m = max(float(caster.shift_m @ receiver.sun_direction_body), 0.0)
        caster_px = hulls[caster.name].radius_m / receiver.footprint_m
        eclipse_px, caster_wide_px = 2.0 * sun_radius_rad * sunward_m / receiver.footprint_m, 2.0 * max(caster_px, 1e-9)
        wide_px, edge_px = min(eclipse_px, caster_wide_px), 2.0 * math.pi * min(caster_px, radius_px)
        of_caster = _HARD_EDGE**2 * edge_px * wide_px * min(wide_px, 1.0) ** 2 / 12.0
        squared, annular = squared + of_caster, annular + of_caster * (eclipse_px > caster_wide_px)
        widest_px = max(widest_px, wide_px)
    lit_px = 0.5 * math.pi * radius_px**2 * (1.0 + math.cos(receiver.phase_rad))
    return *(min(math.sqrt(each / max(lit_px, 1e-9)), 1.0) for each in (squared, annular)), widest_px


def _eclipse(receiver: BodyView, cast: Sequence[Caster], hulls: Mapping[str, Hull],
             sun_radius_rad: float) -> tuple[float, float, float]:
    """Share of the light [1] that casters leave, error of the total [1] with hard edges, and the widest penumbra [m].

    All bodies are spheres, and the receiver is as bright as Lambert's. Hard edges err where a penumbra ends outside the
    part that is seen and lit, and where that is not evenly bright.
    """
    hull, sun = hulls[receiver.name], receiver.sun_direction_body
    point_m, light = _lit_points(receiver, hull.radius_m)
    # At full phase half the distance of neighbouring points.
    edge_m = hull.radius_m * max(0.5 * math.sqrt(math.pi / _POINTS) * math.cos(0.5 * receiver.phase_rad), 1.0 / _POINTS)
    places = (0.0, -_ASIDE, _ASIDE)
    (soft, hard), width_m = np.ones((2, len(places), len(light))), 0.0
    for caster in cast:
        caster_m, to_caster_m = hulls[caster.name].radius_m, caster.shift_m - point_m
        sunward_m = np.maximum(to_caster_m @ sun, 0.0)
        aside_m = to_caster_m - np.outer(to_caster_m @ sun, sun)
        to_light = light @ aside_m
        moved_m = np.multiply.outer(places, hull.radius_m * to_light / max(np.linalg.norm(to_light), 1e-300))
        apart_m = np.linalg.norm(aside_m + moved_m[:, None], axis=-1)
        half_m = np.maximum(sun_radius_rad * sunward_m, 1e-9 * caster_m)
        is_shaded = sunward_m > 0.0
        for left, disc_m in ((soft, half_m), (hard, np.minimum(half_m, edge_m))):
            left *= 1.0 - is_shaded * shared_area(caster_m, disc_m, apart_m) / (math.pi * disc_m**2)
        width_m = max(width_m, 2.0 * float(half_m.max()))
    total = float(light.sum())
    if not total > 0.0:
        return 1.0, 0.0, width_m
    soft, hard = soft @ light / total, hard @ light / total
    return float(soft[0]), float(np.max(np.abs(soft - hard) / np.maximum(soft, 1e-3))), width_m


def _lit_points(receiver: BodyView, radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) [m] of a sphere that camera and Sun see, evenly in the image, and their light (N,) [1]."""
    x, y = on_disc(_POINTS).T
    camera_from_body = sun_from_body(receiver.r_camera_body_m / receiver.range_m)
    sun = camera_from_body @ receiver.sun_direction_body
    # From the terminator to the limb, the Sun being towards x.
    x = 0.5 * ((1.0 + sun[2]) * x + (1.0 - sun[2]) * np.sqrt(np.maximum(1.0 - y**2, 0.0)))
    length = math.hypot(sun[0], sun[1])
    towards_x, towards_y = sun[:2] / length if length > 0.0 else (1.0, 0.0)
    normal = np.stack([towards_x * x - towards_y * y, towards_y * x + towards_x * y,
                       np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))], axis=-1)
    return radius_m * normal @ camera_from_body, np.maximum(normal @ sun, 0.0)


def shared_area(one: float, other: np.ndarray | float, apart: np.ndarray) -> np.ndarray:
    """Area that two discs share, by their radii and the distances (...) of their middles: closed form, in squares."""
    small, gap = np.minimum(one, other), np.abs(one - other)
    # Circles that touch from within or without are those that are nearest and farthest.
    d = np.clip(apart, np.maximum(gap, 1e-12 * small), one + other)
    triangle = (one + other - d) * (d + one - other) * (d - one + other) * (one + other + d)
    root = np.sqrt(np.maximum(triangle, 0.0))
    # An arc cosine is good to 1e-8 rad, which is more than all of a small disc by the edge of a large one.
    angle_one, angle_other = (np.arctan2(root, (d - b) * (d + b) + a**2) for a, b in ((one, other), (other, one)))
    shared = one**2 * angle_one + other**2 * angle_other - 0.5 * root
    return np.where(apart <= gap, math.pi * small**2, shared)
