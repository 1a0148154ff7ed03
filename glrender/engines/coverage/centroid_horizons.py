"""Horizon maps at the centroids of a shape's facets: which centroids Sun and camera see, without a ray.

Source: Max (1988), Horizon mapping: shadows for bump-mapped surfaces.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from glrender_camera import threads

from ...base.disk_cache import cached_bytes
from ..rays.mesh import RayMesh
from .horizon_loops import N_AZIMUTHS, UNKNOWN, axes_across, shade_centroids
from .sub_triangles import FACETS_AT_ONCE

MOST_HORIZONS = 150_000
"""Facets up to which horizons are made: 30 us a facet, once; larger shapes cast a ray from every centroid."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CentroidHorizons:
    """Facets with the horizons of their centroids.

    Attributes
    ----------
    facets : (F, 6) float32
        Normals and centroids [m].
    heights : (F, 16) uint8
        Of the horizon, in azimuths around: 255 times the sine; `UNKNOWN` in all azimuths where these are not enough to
        describe the surroundings, as under an overhang.
    has_backs : bool
        As `RayMesh` has it.
    """

    facets: np.ndarray
    heights: np.ndarray
    has_backs: bool = False

    @classmethod
    def of(cls, middle_m: np.ndarray, normal: np.ndarray, solid: RayMesh, is_kept: bool = True) -> CentroidHorizons:
        """Horizons of a shape: made once by some hundred rays a facet, and kept on disk; all unknown of a large one.

        Parameters
        ----------
        middle_m : (3, F) float64 [m]
        normal : (3, F) float64
        solid : RayMesh
            Of the same shape.
        is_kept : bool
            False for a shape that is one of many: all unknown, rays are cast from its centroids.
        """
        facets = np.concatenate([normal, middle_m]).T.astype(np.float32, order="C")
        n_facets = len(facets)
        if n_facets > MOST_HORIZONS or not is_kept:
            return cls(facets=facets, heights=np.full((n_facets, N_AZIMUTHS), UNKNOWN, np.uint8))
        # In the order in which they are: that of a shape's own file is another one.
        heights = cached_bytes(f"middles6-{hashlib.sha256(facets.data).hexdigest()[:32]}", (n_facets, N_AZIMUTHS),
                               lambda: heights_around(middle_m, normal, solid, N_AZIMUTHS, UNKNOWN))
        return cls(facets=facets, heights=heights, has_backs=solid.has_backs)

    def shade(self, to_sun: np.ndarray, r_camera_m: np.ndarray, table: tuple[np.ndarray, float, float], one_in: int = 1
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Radiance (F,) of the facets, in the BRDF's unit: 0 of those that are dark or not seen, NaN if left out.

        Parameters
        ----------
        to_sun : (3,) float64
            Unit vector.
        r_camera_m : (3,) float64 [m]
        table : tuple
            Of the BRDF, as `BrdfTables.of` has it.
        one_in : int
            One facet in so many is shaded, as many in a row; the others are left out.

        Returns
        -------
        radiance : (F,) float64
        asked : (N,) int
            Facets that are shaded as if lit, to be decided by rays.
        is_asked : (2, N) bool
            Whether of their being seen, and of their being lit.
        """
        n_facets, (brdf, first_root, root_step) = len(self.facets), table
        found, asked, is_asked = np.full(n_facets, np.nan), np.empty(n_facets, np.intp), np.empty((2, n_facets), bool)

        def look(part: slice) -> np.ndarray:
            n = shade_centroids(self.facets, self.heights, part.start, part.stop, one_in, to_sun, r_camera_m,
                                brdf, first_root, 1.0 / root_step, self.has_backs, found, asked, is_asked)
            return np.arange(part.start, part.start + n)

        places = np.concatenate(threads.run_in_parts(look, n_facets, FACETS_AT_ONCE))
        return found, asked[places], is_asked[:, places]


def heights_around(points_m: np.ndarray, normal: np.ndarray, solid: RayMesh, n_azimuths: int, unknown: int
                   ) -> np.ndarray:
    """Horizons of a shape around points of its surface, in azimuths of even steps on a square: (N, A) uint8.

    Parameters
    ----------
    points_m, normal : (3, N) float64 [m], [1]
    solid : RayMesh
    n_azimuths : int
    unknown : int
        Value where azimuths do not describe the surroundings; 0 for not testing that.
    """
    found = np.empty((normal.shape[1], n_azimuths), np.uint8)
    # As the loops count azimuths.
    place = np.arange(n_azimuths) * (4.0 / n_azimuths)
    azimuths = np.stack([np.abs(place - 2.0) - 1.0, np.where(place > 3.0, place - 4.0, 1.0 - np.abs(place - 1.0))])
    azimuths /= np.linalg.norm(azimuths, axis=0)

    def look(part: slice) -> None:
        solid.heights(points_m[:, part], normal[:, part], axes_across(normal[:, part]), azimuths, unknown,
                      found[part])

    threads.run_in_parts(look, normal.shape[1], FACETS_AT_ONCE)
    return found
