"""Surfaces of triangles: their files, the closest points on them, and what rays meet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import trimesh
from glrender_navigation.checks import array, refuse
from scipy.spatial import cKDTree

# Nearest pieces of a mesh whose facets may have the closest point, at first and at the most, and points at once.
_N_NEAREST, _MOST_NEAREST, _AT_ONCE = 16, 64, 50_000
# Facets with a longer side, in median sides, are several pieces: about so many, or one a facet.
_LONG, _MOST_PIECES = 3.0, 200_000
# Distances within this share of each other are one, of facets that share a side or a corner.
_TIE = 1e-9


class HasFacets(Protocol):
    """A `Mesh`, a `glrender.Shape`, or another surface of triangles."""

    @property
    def vertices_m(self) -> np.ndarray: ...

    @property
    def facets(self) -> np.ndarray: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A surface of triangles, open or closed.

    Parameters
    ----------
    vertices_m : (V, 3) float [m]
        In `body`.
    facets : (F, 3) int
        Vertex numbers from 0, counter-clockwise from outside.

    Raises
    ------
    ValueError
        A vertex that is no number, no facet at all, or a facet of vertices that are not there.
    """

    vertices_m: np.ndarray
    facets: np.ndarray

    def __post_init__(self):
        object.__setattr__(self, "vertices_m", array("vertices_m", self.vertices_m, (None, 3), "give metres"))
        facets = array("facets", self.facets, (None, 3), "give three vertex numbers from 0 for each facet").astype(int)
        if (bad := (facets < 0) | (facets >= len(self.vertices_m))).any():
            raise refuse("facets", f"must be integers from 0 to {len(self.vertices_m) - 1}", facets[bad][0].item(),
                         "files count some vertices from 1: subtract it")
        object.__setattr__(self, "facets", facets)

    @classmethod
    def of(cls, surface: HasFacets) -> Mesh:
        """The same surface of another class."""
        return surface if isinstance(surface, Mesh) else cls(vertices_m=surface.vertices_m, facets=surface.facets)

    @classmethod
    def from_file(cls, path: str | Path) -> Mesh:
        """The surface of an OBJ, PLY, STL, OFF or GLB file in metres.

        Raises
        ------
        ValueError
            A file that holds no triangles, or cannot be read as a surface.
        OSError
        """
        try:
            found: Any = trimesh.load(str(path), process=False, force="mesh")
        except OSError:
            raise
        except Exception as error:  # its readers raise as many kinds as there are formats
            raise refuse(str(path), "must be a surface", str(error), "OBJ, PLY, STL, OFF or GLB") from None
        if not len(getattr(found, "faces", ())):
            raise refuse(str(path), "must hold triangles", type(found).__name__, "a cloud of points has no surface")
        return cls(vertices_m=found.vertices, facets=found.faces)

    def to_file(self, path: str | Path, brightness: np.ndarray | None = None) -> None:
        """Write the surface in metres, by the ending of the path: .ply, .obj, .stl, .off or .glb.

        Vertices are grey by a brightness (V,) of mean 1, whose double is white; those of nan are black.
        """
        colours = None if brightness is None else np.repeat(grey(brightness)[:, None], 3, axis=1)
        trimesh.Trimesh(self.vertices_m, self.facets, process=False, vertex_colors=colours).export(str(path))

    @cached_property
    def _trimesh(self) -> trimesh.Trimesh:
        return trimesh.Trimesh(self.vertices_m, self.facets, process=False)

    @cached_property
    def used_vertices_m(self) -> np.ndarray:
        """(U, 3) float64 [m], vertices that facets have; others are no part of the surface."""
        return self.vertices_m[np.unique(self.facets)]

    @cached_property
    def corners_m(self) -> np.ndarray:
        """(F, 3, 3) float64 [m], vertices of the facets."""
        return self.vertices_m[self.facets]

    @cached_property
    def facet_normals(self) -> np.ndarray:
        """(F, 3) float64, outward, of length 1; 0 of a facet without area."""
        return np.array(self._trimesh.face_normals)

    @cached_property
    def vertex_normals(self) -> np.ndarray:
        """(V, 3) float64, outward, of length 1, of the facets around weighted by their angles."""
        return np.array(self._trimesh.vertex_normals)

    @cached_property
    def rays(self) -> Any:
        """Embree's queries, of trimesh.

        Raises
        ------
        ValueError
            Without embreex.
        """
        if not trimesh.ray.has_embree:
            raise refuse("rays", "need embreex", None, "pip install embreex, on a machine that it has a wheel for")
        return self._trimesh.ray

    def seen_from(self, r_m: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Facets (N,) that rays from a place (3,) [m] along unit vectors (N, 3) meet first, -1 for none."""
        # Rays start near the body: Embree has float32.
        away_m = max(0.0, float(np.linalg.norm(r_m)) - float(np.linalg.norm(self.used_vertices_m, axis=1).max()))
        return self.rays.intersects_first(r_m + away_m * directions, directions)

    def sample(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Points (count, 3) [m], even over the area, and the numbers (count,) of their facets; always the same."""
        points_m, facet = trimesh.sample.sample_surface(self._trimesh, count, seed=0)
        return np.asarray(points_m), facet


def grey(brightness: np.ndarray) -> np.ndarray:
    """Grey levels (...) uint8 of a brightness whose double is white; nan is black."""
    return np.nan_to_num(127.5 * brightness).clip(0.0, 255.0).astype(np.uint8)


class Closest:
    """The closest points of a mesh: exact distances to the facets of the pieces that are nearest."""

    def __init__(self, mesh: Mesh):
        self.mesh, corners_m = mesh, mesh.corners_m
        side_m = np.linalg.norm(corners_m - np.roll(corners_m, 1, axis=1), axis=2).max(axis=1)
        finest_m = max(_LONG * float(np.median(side_m)), float(side_m.max()) / 64.0)
        while np.square(side_m[side_m > finest_m] / finest_m).sum() > max(_MOST_PIECES, len(corners_m)):
            finest_m *= 2.0
        is_long = side_m > finest_m
        self._facet, corners_m = np.flatnonzero(~is_long), corners_m[~is_long]
        if is_long.any():
            dense_m, pieces, parent = trimesh.remesh.subdivide_to_size(mesh.vertices_m, mesh.facets[is_long], finest_m,
                                                                       max_iter=20, return_index=True)
            self._facet = np.concatenate([self._facet, np.flatnonzero(is_long)[parent]])
            corners_m = np.concatenate([corners_m, dense_m[pieces]])
        middle_m = corners_m.mean(axis=1)
        self._radius_m = np.linalg.norm(corners_m - middle_m[:, None], axis=2).max(axis=1)
        self._tree = cKDTree(middle_m)

    def __call__(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signed distances (N,) [m] of points (N, 3), positive outside, closest points (N, 3) and their facets (N,)."""
        points_m = np.asarray(points_m, float)
        parts = [self._some(points_m[k:k + _AT_ONCE]) for k in range(0, len(points_m), _AT_ONCE)]
        distance_m, place_m, facet = (np.concatenate(each) for each in zip(*parts, strict=True))
        return distance_m, place_m, facet

    def _some(self, points_m: np.ndarray, n_near: int = _N_NEAREST) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        n_near = min(n_near, self._tree.n)
        middle_m, piece = self._tree.query(points_m, k=list(range(1, n_near + 1)), workers=-1)
        # Pieces that lie wholly beyond the nearest middle are out.
        owner, column = np.nonzero(middle_m - self._radius_m[piece] <= middle_m[:, :1] * (1.0 + _TIE))
        facet = self._facet[piece[owner, column]]
        place_m = trimesh.triangles.closest_point(self.mesh.corners_m[facet], points_m[owner])
        gap_m = points_m[owner] - place_m
        length_m = np.linalg.norm(gap_m, axis=1)
        height_m = (gap_m * self.mesh.facet_normals[facet]).sum(axis=1)
        least_m = np.minimum.reduceat(length_m, np.searchsorted(owner, np.arange(len(points_m))))
        # Several facets may share the closest point: the one that faces the point most has its side right.
        tied = np.flatnonzero(length_m <= least_m[owner] * (1.0 + _TIE))
        tied = tied[np.lexsort((-np.abs(height_m[tied]), owner[tied]))]
        first = tied[np.searchsorted(owner[tied], np.arange(len(points_m)))]
        found = np.where(height_m[first] < 0.0, -least_m, least_m), place_m[first], facet[first]
        unsure = np.flatnonzero(middle_m[:, -1] - self._radius_m.max() < least_m)
        if unsure.size and n_near < min(_MOST_NEAREST, self._tree.n):
            for each, own in zip(found, self._some(points_m[unsure], 4 * n_near), strict=True):
                each[unsure] = own
        return found
