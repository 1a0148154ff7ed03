"""How high a shape stands around points of it, facets' middles or vertices: which are lit and seen, by tables.

Horizon maps, of Max (1988), Horizon mapping: shadows for bump-mapped surfaces. Between two of their azimuths something
may be missed: where one point more or less matters little, as of facets far smaller than pixels.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from glrender_camera import threads

from .cache import cached_bytes
from .rays import RayMesh

# Points that a thread looks at in a turn.
_PART = 1 << 12


@dataclass(frozen=True, kw_only=True, eq=False)
class PointHorizons:
    """Points of a shape's surface with their horizons.

    Attributes
    ----------
    points : (N, 6) float32
        Normals and places [m].
    heights : (N, 16) uint8
        Of the horizon over the plane across the normal, in azimuths around: 255 times the sine; `UNKNOWN` in all of
        them under what stands above something free, as an overhang, and of points without a normal.
    """

    points: np.ndarray
    heights: np.ndarray

    @classmethod
    def of(cls, r_m: np.ndarray, normal: np.ndarray, solid: RayMesh) -> PointHorizons:
        """Of a shape's points; made once by some hundred rays a point, and kept on disk.

        Parameters
        ----------
        r_m : (3, N) float64 [m]
        normal : (3, N) float64
            Unit vectors; of 0 where there is none: nothing is told of those.
        solid : RayMesh
            Of the same shape.
        """
        from .horizon_loops import N_AZIMUTHS, UNKNOWN

        points = np.concatenate([normal, r_m]).T.astype(np.float32, order="C")
        # In the order in which they are: that of a shape's own file is another one.
        heights = cached_bytes(f"points-{hashlib.sha256(points.data).hexdigest()[:32]}",
                               (normal.shape[1], N_AZIMUTHS), lambda: _heights(r_m, normal, solid))
        heights[(normal == 0.0).all(axis=0)] = UNKNOWN
        return cls(points=points, heights=heights)

    @property
    def unknown(self) -> float:
        """Share of the points of which nothing is told."""
        from .horizon_loops import UNKNOWN

        return float(np.mean(self.heights[:, 0] == UNKNOWN))

    def shade(self, to_sun: np.ndarray, r_camera_m: np.ndarray, brdf: np.ndarray, first_root: float,
              root_step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Radiance (F,) of facets whose middles the points are, in the BRDF's unit: 0 of what is dark or not seen.

        Parameters
        ----------
        to_sun : (3,) float64
            Unit vector.
        r_camera_m : (3,) float64 [m]
        brdf, first_root, root_step
            As `BrdfTables.of` has them.

        Returns
        -------
        radiance : (F,) float64
        asked : (N,) int
            Facets that are shaded as if lit, of which rays have to tell.
        is_asked : (2, N) bool
            Whether of their being seen, and of their being lit.
        """
        from .horizon_loops import shade_middles

        n_facets = len(self.points)
        found, asked, is_asked = np.empty(n_facets), np.empty(n_facets, np.intp), np.empty((2, n_facets), bool)

        def look(part: slice) -> np.ndarray:
            n = shade_middles(self.points, self.heights, part.start, part.stop, to_sun, r_camera_m,
                              brdf, first_root, 1.0 / root_step, found, asked, is_asked)
            return np.arange(part.start, part.start + n)

        places = np.concatenate(threads.run_in_parts(look, n_facets, _PART))
        return found, asked[places], is_asked[:, places]

    def look(self, some: np.ndarray, to_sun: np.ndarray, r_camera_m: np.ndarray, near: float | None = None
             ) -> np.ndarray:
        """Whether camera and Sun see some of the points (M,): (2, M) int8; -1 where rays must tell.

        Parameters
        ----------
        some : (M,) int
        to_sun, r_camera_m
            As of `shade`.
        near : float, optional
            How near the horizon rays must tell, of 255 parts of a sine; as in `shade` otherwise.
        """
        from .horizon_loops import NEAR, look_at_points

        near = NEAR if near is None else near
        found = np.empty((2, len(some)), np.int8)
        threads.run_in_parts(lambda part: look_at_points(self.points, self.heights, some, part.start, part.stop,
                                                         to_sun, r_camera_m, near, found), len(some), _PART)
        return found


def _heights(r_m: np.ndarray, normal: np.ndarray, solid: RayMesh) -> np.ndarray:
    from .horizon_loops import N_AZIMUTHS, axes_across

    found = np.empty((normal.shape[1], N_AZIMUTHS), np.uint8)
    # On a square around, as the loops count azimuths.
    place = np.arange(N_AZIMUTHS) * (4.0 / N_AZIMUTHS)
    azimuths = np.stack([np.abs(place - 2.0) - 1.0, np.where(place > 3.0, place - 4.0, 1.0 - np.abs(place - 1.0))])
    azimuths /= np.linalg.norm(azimuths, axis=0)

    def look(part: slice) -> None:
        solid.heights(r_m[:, part], normal[:, part], axes_across(normal[:, part]), azimuths, found[part])

    threads.run_in_parts(look, normal.shape[1], _PART)
    return found
