"""Surfaces of triangles: their files, the closest points on them, and the pixels that they cover."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import trimesh
from glrender_navigation.checks import array, refuse
from numba import njit
from scipy.spatial import cKDTree

# Vertices of a mesh about which the closest facet is looked for.
_N_NEAREST = 8
# Facets with a longer side, in median sides, have points of their own in the tree.
_LONG = 3.0
# Distances within this share of the larger are one, of facets that share a side or a corner.
_TIE = 1e-9
_compiled = njit(cache=True, nogil=True, error_model="numpy")
_inlined = njit(inline="always", error_model="numpy")


@_inlined
def _triple(row):
    return row[0], row[1], row[2]


@_inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_inlined
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@_inlined
def _plus(a, factor, b):
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


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
    def from_file(cls, path: str | Path, metres_per_unit: float = 1.0) -> Mesh:
        """The surface of an OBJ, PLY, STL, OFF or GLB file.

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
        return cls(vertices_m=np.asarray(found.vertices) * metres_per_unit, facets=found.faces)

    def to_file(self, path: str | Path, **more: Any) -> None:
        """Write the surface in metres, by the ending of the path: .ply, .obj, .stl, .off or .glb."""
        trimesh.Trimesh(self.vertices_m, self.facets, process=False, **more).export(str(path))

    @property
    def corners_m(self) -> np.ndarray:
        """(F, 3, 3) float64 [m], vertices of the facets."""
        return self.vertices_m[self.facets]

    @property
    def facet_normals(self) -> np.ndarray:
        """(F, 3) float64, outward, of length 1; 0 of a facet without area."""
        a, b, c = np.moveaxis(self.corners_m, 1, 0)
        across = np.cross(b - a, c - a)
        return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)

    def sample(self, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Points (count, 3) [m], even over the area, and the numbers (count,) of their facets."""
        rng = np.random.default_rng(seed)
        a, b, c = np.moveaxis(self.corners_m, 1, 0)
        area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
        facet = np.searchsorted(area, (np.arange(count) + rng.random(count)) / count * area[-1], side="right")
        facet = np.minimum(facet, len(area) - 1)
        u, v = rng.random((2, count, 1))
        u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
        return a[facet] + u * (b - a)[facet] + v * (c - a)[facet], facet


class Closest:
    """The closest points of a mesh: facets about the nearest vertices, exactly."""

    def __init__(self, mesh: Mesh):
        self.mesh, self.normals = mesh, mesh.facet_normals
        facets, corners = mesh.facets, mesh.corners_m
        side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        long = np.flatnonzero(side > _LONG * np.median(side))
        own, number = np.empty((0, 3)), np.empty(0, int)
        if long.size:
            finest = max(_LONG * float(np.median(side)), float(side.max()) / 64.0)
            dense, pieces, parent = trimesh.remesh.subdivide_to_size(mesh.vertices_m, facets[long], finest,
                                                                     max_iter=20, return_index=True)
            own, number = dense[pieces].mean(axis=1), long[parent]
        places = np.concatenate([facets.ravel(), len(mesh.vertices_m) + np.arange(len(own))])
        order = np.argsort(places, kind="stable")
        self._around = np.concatenate([np.repeat(np.arange(len(facets)), 3), number])[order]
        n_places = len(mesh.vertices_m) + len(own)
        self._start = np.searchsorted(places[order], np.arange(n_places + 1))
        # A vertex of no facet is no part of the surface.
        self._used = np.flatnonzero(np.diff(self._start))
        self._tree = cKDTree(np.concatenate([mesh.vertices_m, own])[self._used])

    def __call__(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signed distances (N,) [m] of points (N, 3), positive outside; closest points (N, 3) [m]; their facets (N,).

        Source: Ericson (2004), Real-Time Collision Detection, 5.1.5.
        """
        points_m = np.ascontiguousarray(points_m, float)
        _, near = self._tree.query(points_m, k=min(_N_NEAREST, len(self._used)), workers=-1)
        near = self._used[near.reshape(len(points_m), -1)]
        return _closest(points_m, near, self._start, self._around, self.mesh.corners_m, self.normals)


@_compiled
def _closest(points, near, start, around, corners, normals):
    distance, place = np.empty(len(points)), np.empty((len(points), 3))
    facet = np.empty(len(points), np.int64)
    for i in range(len(points)):
        p, best, most, found = _triple(points[i]), np.inf, 0.0, (0.0, 0.0, 0.0)
        for j in near[i]:
            for f in around[start[j]:start[j + 1]]:
                q = _on_triangle(p, _triple(corners[f, 0]), _triple(corners[f, 1]), _triple(corners[f, 2]))
                away = _minus(p, q)
                d = np.sqrt(_dot(away, away))
                # Of facets that share the closest point, the one that faces the point most has its side right.
                height = _dot(away, _triple(normals[f]))
                if d < best * (1.0 - _TIE) or (d <= best * (1.0 + _TIE) and abs(height) > abs(most)):
                    best, most, facet[i], found = min(d, best), height, f, q
        distance[i] = -best if most < 0.0 else best
        place[i, 0], place[i, 1], place[i, 2] = found
    return distance, place, facet


@_compiled
def _on_triangle(p, a, b, c):
    ab, ac, ap, bp, cp = _minus(b, a), _minus(c, a), _minus(p, a), _minus(p, b), _minus(p, c)
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return a
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return b
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return c
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _plus(a, d1 / (d1 - d3), ab)
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return _plus(a, d2 / (d2 - d6), ac)
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        return _plus(b, (d4 - d3) / ((d4 - d3) + (d5 - d6)), _minus(c, b))
    return _plus(_plus(a, vb / (va + vb + vc), ab), vc / (va + vb + vc), ac)


def covered(at_px: np.ndarray, nearness: np.ndarray, facets: np.ndarray, width_px: int,
            height_px: int) -> tuple[np.ndarray, np.ndarray]:
    """The nearest facet at the centre of each pixel.

    Parameters
    ----------
    at_px : (V, 2) float [px]
        Vertices in the image.
    nearness : (V,) float
        Larger is nearer, and linear over a facet in the image: 1/z of a camera, height of a view from afar; facets
        with a vertex that is not above 0 are left out.
    facets : (F, 3) int
    width_px, height_px : int

    Returns
    -------
    nearness : (height, width) float64, 0 where there is no facet.
    facet : (height, width) int64, -1 there.
    """
    return _covered(np.ascontiguousarray(at_px, float), np.ascontiguousarray(nearness, float), facets, width_px,
                    height_px)


@_compiled
def _covered(at, nearness, facets, width, height):
    nearest, number = np.zeros((height, width)), np.full((height, width), -1, np.int64)
    for f in range(len(facets)):
        i, j, k = facets[f]
        if min(nearness[i], nearness[j], nearness[k]) <= 0.0:
            continue
        ax, ay, bx, by, cx, cy = at[i, 0], at[i, 1], at[j, 0], at[j, 1], at[k, 0], at[k, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        for y in range(max(0, int(np.ceil(min(ay, by, cy)))), min(height - 1, int(np.floor(max(ay, by, cy)))) + 1):
            for x in range(max(0, int(np.ceil(min(ax, bx, cx)))), min(width - 1, int(np.floor(max(ax, bx, cx)))) + 1):
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    near = u * nearness[i] + v * nearness[j] + (1.0 - u - v) * nearness[k]
                    if near > nearest[y, x]:
                        nearest[y, x], number[y, x] = near, f
    return nearest, number
