"""How fast a body's lines move in the image: sides of facets, and the cuts where light ends within them.

Sides, and what divides facets, stay on the body. So does a cut by a shadow while the Sun stands still; where the Sun
turns about the body it slides along the facet, by the distance of what shades. A cut by what hides the rest goes with
that, which is nearer to the camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...view.view import BodyView
from ..coverage.sunlit_areas import SunlitAreas
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import loops
from .parameters import Rates

# Shares of the way from a cut to the dark corner at which it is asked what makes it: farther where nothing is met.
_BEYOND = (0.02, 0.1, 0.3, 1.0)
LEAST_COSINE = 1e-3
"""Of the Sun's incidence, below which a shadow slides no faster [1]: it would cross the whole facet at once."""
# Least share of the way to the camera that is left beyond what hides [1].
_LEAST_DEPTH = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Cuts:
    """The lines at which light ends within a body's facets, and what makes them; two ends each.

    Attributes
    ----------
    r_m : (3, 2 N) float64 [m]
        All begins, then all ends, with the light on the side of polygons that run so.
    facet : (2 N,) int
    hides_m, shades_m : (2 N,) float64 [m]
        Distance of what hides the place just beyond from the camera, or from the Sun; infinite of what does not.
    by : (2 N,) int
        The body's facet that does so, by its number in the shape; -1 where nothing was met.
    """

    r_m: np.ndarray
    facet: np.ndarray
    hides_m: np.ndarray
    shades_m: np.ndarray
    by: np.ndarray

    @classmethod
    def of(cls, areas: SunlitAreas, rays: RayEngine, views: list[BodyView], slides: bool) -> Cuts:
        """Ask what makes each cut, just beyond it; of those that a shadow makes only where shadows slide.

        Of the views of all bodies, the areas' own is as the point of the Sun's disc lights it that they are of.
        """
        cutter, view, number = areas.seen.cutter, areas.seen.view, areas.seen.facets.number
        views = [view if view.name == each.name else each for each in views]
        point, dark, facet = cutter.cuts()
        r_m = cutter.points.r_m.take(point, axis=1)
        way_m = cutter.points.r_m.take(dark, axis=1) - r_m
        hides_m, shades_m = np.full((2, len(point)), np.inf)
        by, may_hide, is_open = np.full(len(point), -1), ~cutter.points.is_seen.take(dark), np.ones(len(point), bool)
        is_open &= may_hide | slides
        for part in _BEYOND:
            def ask(which: np.ndarray, ranges_m: np.ndarray, ranges: Callable[..., tuple[np.ndarray, np.ndarray]],
                    share: float = part) -> None:
                beyond_m = r_m.take(which, axis=1) + share * way_m.take(which, axis=1)
                ranges_m[which], by[which] = ranges(beyond_m, number.take(facet[which]), view, views)
                is_open[which] = np.isinf(ranges_m[which])

            # The camera sees the dark corner of a cut by a shadow; one that it does not see may be in shadow too.
            ask(np.flatnonzero(is_open & may_hide), hides_m, rays.hides)
            ask(np.flatnonzero(is_open), shades_m, rays.shades)
        return cls(r_m=r_m, facet=facet, hides_m=hides_m, shades_m=shades_m, by=by)

    def own_rates(self, areas: SunlitAreas, rates: Rates, focal_length_px: float) -> np.ndarray:
        """Rates (2 N, 2, K) [px] of the ends in the image, less those of the places on the body where they are."""
        view, found = areas.seen.view, np.zeros((len(self.facet), 2, len(rates.focal_length_px)))
        hidden, shaded = np.flatnonzero(np.isfinite(self.hides_m)), np.flatnonzero(np.isfinite(self.shades_m))
        at_m = in_camera(self.r_m, view)
        far_m, hides_m = at_m.take(hidden, axis=1), self.hides_m.take(hidden)
        near_m = far_m * np.maximum(1.0 - hides_m / np.sqrt(dot(far_m, far_m)), _LEAST_DEPTH)
        found[hidden] = (place_rates(near_m, rates, focal_length_px) - place_rates(far_m, rates, focal_length_px))
        at_m, range_m = at_m.take(shaded, axis=1), self.shades_m.take(shaded)
        normal, to_sun = areas.seen.facets.normal.take(self.facet[shaded], axis=1), view.sun_direction_body[:, None]
        cosine, across = np.maximum(dot(normal, to_sun), LEAST_COSINE), focal_length_px / at_m[2]
        for k, turned in enumerate(sun_rates_body(rates, view)):
            if turned.any():
                slide_m = range_m * (to_sun * (dot(normal, turned[:, None]) / cosine) - turned[:, None])
                slide_m = np.stack([dot(axis, slide_m) for axis in view.camera_from_body])
                for axis in range(2):
                    found[shaded, axis, k] = across * (slide_m[axis] - at_m[axis] / at_m[2] * slide_m[2])
        return found


def sun_rates_body(rates: Rates, view: BodyView) -> np.ndarray:
    """Rates (K, 3) [1] of the direction towards the Sun in the body's frame."""
    to_sun = view.camera_from_body @ view.sun_direction_body
    return np.cross(rates.sun_turns_rad - rates.turns_rad, to_sun) @ view.camera_from_body


def in_camera(r_body_m: np.ndarray, view: BodyView) -> np.ndarray:
    """Points (3, N) [m] of a body's frame, in `camera`."""
    r_m = r_body_m - view.r_camera_body_m[:, None]
    return np.stack([dot(axis, r_m) for axis in view.camera_from_body])


def place_rates(r_camera_m: np.ndarray, rates: Rates, focal_length_px: float) -> np.ndarray:
    """Rates (P, 2, K) [px] of the places in the image of points (3, P) [m] of a body, in `camera`."""
    return loops.place_rates(r_camera_m, rates.shifts_m, rates.turns_rad, rates.focal_length_px, focal_length_px)
