"""A large shape as some thousand points of its surface, each of which stands for as much of it as any other.

A body that covers few pixels has thousands of facets in each: which of a part of them camera and Sun see tells its
brightness as well, in a time that does not depend on how many there are.
"""

from __future__ import annotations

import hashlib

import numpy as np
from glrender_camera import PinholeCamera

from .cache import cached_bytes
from .facet_tables import FacetTables, point_counts
from .horizon_loops import light_points
from .kept_middles import BrdfTables
from .lit_triangles import in_two_images
from .middle_horizons import heights_around
from .view import BodyView

# Azimuths of their horizons: between 16, what stands far off hides too little, of many neighbours alike.
_AZIMUTHS = 64


class SurfacePoints:
    """Middles of facets along a curve through the surface, even by area; fewer are the first of more.

    Parameters
    ----------
    facets : FacetTables
        Of a shape of which there are points.
    """

    def __init__(self, facets: FacetTables):
        self._surface, self._radius_m, self._tables = facets.surface, facets.solid.radius_m, BrdfTables()
        rng, shape, counts = np.random.default_rng(0), facets.surface.body.shape, point_counts(facets.n_facets)
        up_to_m2, n_points = np.cumsum(shape.facet_areas_m2.take(facets.number)), counts[-1]
        self._area_m2 = up_to_m2[-1]
        chosen = np.searchsorted(up_to_m2, (np.arange(n_points) + rng.random(n_points)) * self._area_m2 / n_points)
        middle_m, normal = facets.corner_m(chosen).mean(axis=0), facets.normal.take(chosen, axis=1)
        points = np.concatenate([normal, middle_m]).T.astype(np.float32, order="C")
        # Facets of which no point is stand around as well.
        digest = hashlib.sha256(f"{shape.content_hash} ".encode() + points.tobytes())
        # About right is enough, even where azimuths do not tell what stands around, as under an overhang.
        heights = cached_bytes(f"points1-{digest.hexdigest()[:32]}", (n_points, _AZIMUTHS),
                               lambda: heights_around(middle_m, normal, facets.solid, _AZIMUTHS, 0))
        first, rest = np.arange(n_points), []
        for _ in counts[1:]:
            # Either of two neighbours.
            pairs, one = first.reshape(-1, 2), rng.integers(0, 2, len(first) // 2)
            first, other = (pairs[np.arange(len(pairs)), which] for which in (one, 1 - one))
            rest.insert(0, other)
        order = np.concatenate([first, *rest])
        self._points, self._heights = points[order], heights[order]

    def image(self, n_points: int, view: BodyView, camera: PinholeCamera, brightness: float, origin_px: np.ndarray,
              per_px: np.ndarray, grid: tuple[int, int]) -> np.ndarray:
        """Means (rows, columns) float64 over cells of radiance times a pixel's solid angle.

        Parameters
        ----------
        n_points : int
            One of `point_counts`.
        view : BodyView
            Of the body, which is alone: all of it is before the camera.
        camera : PinholeCamera
        brightness : float
            What the BRDF is times.
        origin_px : (2,) float64 [px]
            Of the cells.
        per_px : (2,) float64 [1/px]
        grid : (int, int)
            Columns and rows.
        """
        image, (brdf, first, step) = np.zeros(grid[::-1]), self._tables.of(
            self._surface, view, self._radius_m, brightness * self._area_m2 / n_points * per_px.prod())
        in_two_images(image, n_points, lambda part, *turn: light_points(
            self._points[:n_points], self._heights[:n_points], *turn, view.sun_direction_body, view.r_camera_body_m,
            brdf, first, 1.0 / step, view.camera_from_body, camera.focal_length_px, np.array(camera.principal_point_px),
            origin_px, per_px, part))
        return image
