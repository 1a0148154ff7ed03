"""Radiance of a body's facets in one frame."""

from __future__ import annotations

import numpy as np
from glrender_camera import PinholeCamera, threads

from ...view.view import BodyView
from ..rays.mesh import dot
from . import facet_loops
from .facet_tables import FacetTables
from .sub_triangles import FACETS_AT_ONCE, normalised

# Area [px2] below which a facet is drawn as bright all over: its slope moves no light by as much as a pixel.
_LEAST_PX2 = 1.0
# Error of what is not linear, over the distance of the centroid's radiance from the mean of the corners' [1]: of what
# varies as a square along any line it is 0.38 to 0.5 about the mean (test_uneven_facets.py).
_REST = 0.5


class FacetRadiance:
    """Radiance of facets at their centroids, in 1/sr of the Sun's irradiance at 1 au; computed once where asked for.

    Parameters
    ----------
    facets : FacetTables
    view : BodyView
    facing : (N,) int
        Facets that face camera and Sun.
    cos_incidence : (N,) float64
        Cosines of the Sun's incidence on them.
    """

    def __init__(self, facets: FacetTables, view: BodyView, facing: np.ndarray, cos_incidence: np.ndarray):
        self._facets, self._view = facets, view
        self._radiance, self._cos_off_axis, self._cos_incidence = np.zeros((3, facets.n_facets))
        self._cos_incidence[facing] = cos_incidence if facets.shading_normal is facets.normal else np.maximum(
            dot(facets.shading_normal.take(facing, axis=1), view.sun_direction_body[:, None]), 0.0)
        self._is_known = np.zeros(facets.n_facets, bool)

    def of(self, facet: np.ndarray) -> np.ndarray:
        """Radiance (N,) of facets (N,) that face camera and Sun, each once at first."""
        is_known = self._is_known.take(facet)
        if not is_known.all():
            self._compute(facet[~is_known])
        return self._radiance.take(facet)

    def times_solid_angle(self, facet: np.ndarray, is_wanted: bool, camera: PinholeCamera) -> np.ndarray:
        """The same, if wanted times the solid angle (N,) of a pixel at the facets over that on the boresight."""
        radiance = self.of(facet)
        if not is_wanted:
            return radiance
        radiance = radiance * self._cos_off_axis.take(facet) ** 3.0
        if camera.lens_map is not None:
            middle_m = self._facets.corner_m(facet).mean(axis=0)
            radiance /= camera.lens_map.area_scales(normalised(middle_m, self._view))
        return radiance

    def planes(self, facet: np.ndarray, xy_px: np.ndarray, origin_px: np.ndarray) -> tuple[np.ndarray, ...]:
        """Radiance of facets (N,) as it varies linearly in the image, with its mean over each.

        Values (N,) at an origin (2,) [px], slopes (N,) along x and y [1/px], and errors (N,) of the rest. Their
        vertices are at places (2, V) [px]; a facet of less than `_LEAST_PX2` has no slope.
        """
        corners, middle = self._facets.corners.take(facet, axis=1), self.of(facet)
        places = [self._facets.vertices_m.take(corner, axis=1) - self._view.r_camera_body_m[:, None]
                  for corner in corners]
        at = np.stack([self._towards(-place / np.sqrt(dot(place, place)), facet) for place in places])
        depth = np.stack([dot(self._view.camera_from_body[2], place) for place in places])
        x, y = (xy_px[axis].take(corners) for axis in range(2))
        (dx1, dx2), (dy1, dy2), (d1, d2) = ((each[1] - each[0], each[2] - each[0]) for each in (x, y, at))
        twice_px2 = dx1 * dy2 - dx2 * dy1
        is_wide = np.abs(twice_px2) > 2.0 * _LEAST_PX2
        per_area = np.where(is_wide, 1.0 / np.where(is_wide, twice_px2, 1.0), 0.0)
        across, down = (d1 * dy2 - d2 * dy1) * per_area, (d2 * dx1 - d1 * dx2) * per_area
        # The far half of a facet is the smaller one in the image: its centroid is nearer to the far corners there. The
        # mean over a triangle of what varies as a square has three quarters of the centroid.
        bend = middle - (at * depth).sum(axis=0) / depth.sum(axis=0)
        mean = np.where(is_wide, at.mean(axis=0) + 0.75 * bend, middle)
        value = mean + across * (origin_px[0] - x.mean(axis=0)) + down * (origin_px[1] - y.mean(axis=0))
        return value, across, down, _REST * np.abs(bend)

    def cos_incidence(self, facet: np.ndarray) -> np.ndarray:
        """Cosines (N,) of the Sun's incidence on facets (N,) that face camera and Sun."""
        return self._cos_incidence.take(facet)

    def _towards(self, to_camera: np.ndarray, facet: np.ndarray) -> np.ndarray:
        """Radiance (N,) of facets (N,) in directions (3, N)."""
        facets, view = self._facets, self._view
        brdf = facets.surface.brdf(view.sun_direction_body, to_camera.T, facets.shading_normal.take(facet, axis=1).T,
                                   facets.albedo_scale.take(facet), facets.number.take(facet))
        return brdf * self._cos_incidence.take(facet) / view.sun_distance_au**2

    def _compute(self, facet: np.ndarray) -> None:
        """Evaluate the BRDF at the centroids of facets (N,)."""
        facets, view = self._facets, self._view

        def work(part: slice) -> None:
            some = facet[part]
            to_camera = facet_loops.to_camera(facets.vertices_m, facets.corners, some, view.r_camera_body_m)
            self._radiance[some] = self._towards(to_camera, some)
            self._cos_off_axis[some] = -dot(view.camera_from_body[2], to_camera)

        threads.run_in_parts(work, len(facet), FACETS_AT_ONCE)
        self._is_known[facet] = True
