"""Radiance of a body's facets in one frame."""

from __future__ import annotations

import numpy as np
from glrender_camera import PinholeCamera, threads

from ...view.view import BodyView
from ..rays.mesh import dot
from . import facet_loops
from .facet_tables import FacetTables
from .sub_triangles import FACETS_AT_ONCE, normalised


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
        self._cos_incidence[facing] = cos_incidence
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

    def cos_incidence(self, facet: np.ndarray) -> np.ndarray:
        """Cosines (N,) of the Sun's incidence on facets (N,) that face camera and Sun."""
        return self._cos_incidence.take(facet)

    def _compute(self, facet: np.ndarray) -> None:
        """Evaluate the BRDF at the centroids of facets (N,)."""
        facets, surface, view = self._facets, self._facets.surface, self._view

        def work(part: slice) -> None:
            some = facet[part]
            to_camera = facet_loops.to_camera(facets.vertices_m, facets.corners, some, view.r_camera_body_m)
            brdf = surface.brdf(view.sun_direction_body, to_camera.T, facets.normal.take(some, axis=1).T,
                                surface.albedo_scale(facets.number.take(some)))
            self._radiance[some] = brdf * self._cos_incidence.take(some) / view.sun_distance_au**2
            self._cos_off_axis[some] = -dot(view.camera_from_body[2], to_camera)

        threads.run_in_parts(work, len(facet), FACETS_AT_ONCE)
        self._is_known[facet] = True
