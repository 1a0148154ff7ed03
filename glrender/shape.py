"""A body's shape: a closed triangle mesh, checked and repaired, with a report of what was found."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from glrender_camera.validate import integer, within
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from .errors import ShapeError, error_path
from .shape_files import MAX_FACETS, read_shape_file

_METRES_PER_UNIT = {"m": 1.0, "km": 1000.0}
# Vertices closer than this share of the extent are one: a text file's last digit.
_WELD_RTOL = 1e-9
# Facets whose edges tell how rough a shape is.
_CREASE_FACETS = 100_000
# A body thinner than this share of its extent has no sides that float32 coordinates could tell apart.
_FLAT_RTOL = 1e-6
MIN_EXTENT_M, MAX_COORDINATE_M = 1e-3, 1e10
"""What a body may span: a grain of sand, whose facets' areas float32 still holds, to seven Suns."""
# Small bodies span metres to a few thousand kilometres.
_LIKELY_EXTENT_M = (1.0, 6e6)


def metres_per_unit(length_unit: str | float) -> float:
    """Metres in a file's unit of length: "m", "km", or a number, 1e-9..1e9."""
    if not isinstance(length_unit, str):
        return within("length_unit", length_unit, 1e-9, 1e9)
    if length_unit not in _METRES_PER_UNIT:
        raise ShapeError("length_unit", "must be 'm', 'km' or metres per unit", length_unit)
    return _METRES_PER_UNIT[length_unit]


@dataclass(frozen=True, kw_only=True)
class ShapeReport:
    """What was found in a shape, and what was repaired."""

    n_vertices: int
    n_facets: int
    n_shells: int
    n_welded: int
    n_unused: int
    n_degenerate: int
    n_duplicate: int
    n_flipped: int
    n_open_edges: int
    n_non_manifold_edges: int
    volume_m3: float
    extent_m: tuple[float, float, float]
    warnings: tuple[str, ...]

    @property
    def is_watertight(self) -> bool:
        """Whether every edge has exactly two facets."""
        return not self.n_open_edges and not self.n_non_manifold_edges


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """A checked mesh; make one by `from_file` or `from_arrays`.

    Attributes
    ----------
    vertices_m : (V, 3) float64 [m]
        Body-fixed.
    facets : (F, 3) int32
        Counter-clockwise seen from outside.
    uv : (F, 3, 2) float32 or None
        Texture coordinates of the corners, origin at the image's bottom left.
    report : ShapeReport
    """

    vertices_m: np.ndarray
    facets: np.ndarray
    uv: np.ndarray | None
    report: ShapeReport

    @classmethod
    def from_file(cls, path: str | Path, *, length_unit: str | float, max_facets: int = MAX_FACETS) -> Shape:
        """Read, check and repair a shape file.

        Parameters
        ----------
        path : path
            OBJ, PLY, STL, PDS plate model (.tab, .plt) or ICQ (.icq).
        length_unit : "m", "km" or float
            Of the file; metres per unit when a number, 1e-9..1e9.
        max_facets : int

        Raises
        ------
        ShapeError
            With the file's name, the rule and the value.
        """
        path = Path(path)
        scale = metres_per_unit(length_unit)
        with error_path(path.name):
            vertices, facets, uv = read_shape_file(path, integer("max_facets", max_facets, 1, 2**31 - 1))
            # A number as long as 1e308 becomes infinite here and is refused as such.
            with np.errstate(over="ignore"):
                vertices = vertices * scale
            return cls.from_arrays(vertices, facets, uv=uv)

    @classmethod
    def from_arrays(cls, vertices_m: np.ndarray, facets: np.ndarray, *, uv: np.ndarray | None = None) -> Shape:
        """Check and repair a mesh: weld, drop what has no area, turn outward.

        Parameters
        ----------
        vertices_m : (V, 3) float [m]
            Within 1e10 m of the origin, and at least 1e-3 m in extent.
        facets : (F, 3) int
            From 0.
        uv : (F, 3, 2) float, optional

        Raises
        ------
        ShapeError
        """
        try:
            vertices, facets = np.asarray(vertices_m, np.float64), np.asarray(facets)
            uv = None if uv is None else np.asarray(uv, np.float32)
        except (TypeError, ValueError, OverflowError):
            raise ShapeError("", "needs arrays of numbers") from None
        if vertices.ndim != 2 or vertices.shape[1] != 3 or facets.ndim != 2 or facets.shape[1] != 3 or not len(facets):
            raise ShapeError("", "needs vertices (V, 3) and facets (F, 3)", (vertices.shape, facets.shape))
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if len(bad):
            raise ShapeError(f"vertices[{bad[0]}]", "must be finite", vertices[bad[0]].tolist())
        far = np.flatnonzero(np.abs(vertices).max(axis=1) > MAX_COORDINATE_M)
        if len(far):
            raise ShapeError(f"vertices[{far[0]}]", f"must be within {MAX_COORDINATE_M:g} m of the origin",
                             vertices[far[0]].tolist(), "is the length unit right?")
        if facets.dtype.kind not in "iu" and not (facets.dtype.kind == "f" and (facets == np.round(facets)).all()):
            raise ShapeError("facets", "must be integers", facets)
        if facets.min() < 0 or facets.max() >= len(vertices):
            wrong = int(np.flatnonzero(((facets < 0) | (facets >= len(vertices))).any(axis=1))[0])
            raise ShapeError(f"facets[{wrong}]", f"must index vertices 0..{len(vertices) - 1}",
                             facets[wrong].tolist(), "plate models count from 1, trimesh from 0")
        if uv is not None and (uv.shape != (*facets.shape, 2) or not np.isfinite(uv).all()):
            raise ShapeError("uv", f"must be {(*facets.shape, 2)} finite numbers", uv.shape)
        return _repaired(vertices, facets.astype(np.int64), uv)

    @cached_property
    def radius_m(self) -> float:
        """Largest distance of a vertex from the body's origin [m]."""
        return float(np.linalg.norm(self.vertices_m, axis=1).max())

    @cached_property
    def centre_m(self) -> np.ndarray:
        """Origin (3,) float64 [m], body-fixed, of the coordinates in which the shape is drawn.

        It is the body's origin, unless that lies outside the sphere around the shape's box. Float32 coordinates about
        an origin far from the shape (of a terrain patch, its planet's centre) would leave no digits for the shape; the
        middle of the box is the origin then.
        """
        low_m, high_m = self.vertices_m.min(axis=0), self.vertices_m.max(axis=0)
        middle_m = 0.5 * (low_m + high_m)
        is_far = np.linalg.norm(middle_m) > 0.5 * np.linalg.norm(high_m - low_m)
        return middle_m if is_far else np.zeros(3)

    @cached_property
    def content_hash(self) -> str:
        """Hexadecimal SHA-256 of the geometry."""
        digest = hashlib.sha256(self.vertices_m.tobytes() + self.facets.tobytes())
        digest.update(b"" if self.uv is None else self.uv.tobytes())
        return digest.hexdigest()

    @cached_property
    def _area_normals_m2(self) -> np.ndarray:
        corner = self.vertices_m[self.facets]
        return 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])

    @cached_property
    def facet_areas_m2(self) -> np.ndarray:
        """(F,) float64 [m2]."""
        return np.linalg.norm(self._area_normals_m2, axis=1)

    @cached_property
    def facet_normals(self) -> np.ndarray:
        """(F, 3) float64 outward unit normals."""
        return self._area_normals_m2 / self.facet_areas_m2[:, None]

    @cached_property
    def crease_rad(self) -> float:
        """RMS angle [rad] between facets that share an edge; of a large shape, of a part of its edges."""
        start, end = self.facets.ravel().astype(np.int64), np.roll(self.facets, -1, axis=1).ravel().astype(np.int64)
        low, high = np.minimum(start, end), np.maximum(start, end)
        some = np.flatnonzero(low % max(len(self.facets) // _CREASE_FACETS, 1) == 0)
        key = low[some] * len(self.vertices_m) + high[some]
        order = np.argsort(key, kind="stable")
        pair = np.flatnonzero(np.diff(key[order]) == 0)
        if not len(pair):
            return 0.0
        a, b = (self.facet_normals[some[order[pair + k]] // 3] for k in range(2))
        half = np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
        return float(2.0 * np.sqrt(np.mean(half**2)))

    @cached_property
    def vertex_normals(self) -> np.ndarray:
        """(V, 3) float64 unit normals, the mean of the facets around weighted by their angle there."""
        total = np.zeros_like(self.vertices_m)
        for k in range(3):
            here, left, right = (self.vertices_m[self.facets[:, (k + i) % 3]] for i in range(3))
            a, b = left - here, right - here
            angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
            np.add.at(total, self.facets[:, k], angle[:, None] * self.facet_normals)
        return total / np.linalg.norm(total, axis=1, keepdims=True)

    def to_file(self, path: str | Path) -> None:
        """Write an OBJ in metres, without texture coordinates; digits enough to read the same float64."""
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in self.vertices_m.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (self.facets + 1).tolist()]
        Path(path).write_text("\n".join(lines) + "\n", encoding="ascii")


def _repaired(vertices: np.ndarray, facets: np.ndarray, uv: np.ndarray | None) -> Shape:
    used, facets = np.unique(facets, return_inverse=True)
    facets = facets.reshape(-1, 3)
    n_unused, vertices = len(vertices) - len(used), vertices[used]
    extent = float(np.ptp(vertices, axis=0).max())
    if not extent > 0.0:
        raise ShapeError("", "has no extent: all vertices coincide", vertices[0].tolist())
    if not extent >= MIN_EXTENT_M:
        raise ShapeError("", f"must have an extent of at least {MIN_EXTENT_M:g} m", extent, "is the length unit right?")
    cell = extent * _WELD_RTOL
    _, first, same = np.unique(np.round((vertices - vertices.min(axis=0)) / cell).astype(np.int64), axis=0,
                               return_index=True, return_inverse=True)
    same = same.ravel()
    # Keep the file's order of vertices: it is a good order for the vertex cache.
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    n_welded, vertices, facets = len(vertices) - len(first), vertices[first[order]], rank[same][facets]

    corner = vertices[facets]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    # What float64 can tell of a facet's height: that is its corners' rounding, however small it is.
    solid = area > 1e-15 * extent * longest
    n_degenerate = int((~solid).sum())
    facets, uv = facets[solid], None if uv is None else uv[solid]
    if not len(facets):
        raise ShapeError("", "has no facet with an area", n_degenerate)
    thickness = _thickness(vertices)
    if not thickness > _FLAT_RTOL * extent:
        raise ShapeError("", f"must not be flat: thicker than {_FLAT_RTOL:g} of its extent, {extent:.4g} m", thickness)
    _, kept = np.unique(np.sort(facets, axis=1), axis=0, return_index=True)
    kept = np.sort(kept)
    n_duplicate = len(facets) - len(kept)
    facets, uv = facets[kept], None if uv is None else uv[kept]

    facets, flipped, shell, n_open, n_non_manifold = _wound(vertices, facets)
    if uv is not None:
        uv = np.where(flipped[:, None, None], uv[:, [0, 2, 1]], uv)
    volume = _volume(vertices, facets)
    extents = tuple(float(x) for x in np.ptp(vertices, axis=0))
    n_shells = int(shell.max()) + 1
    warnings = []
    if n_open:
        warnings.append(f"{n_open} open edges: light passes through, and the shadow is wrong there")
    if n_non_manifold:
        warnings.append(f"{n_non_manifold} edges with more than two facets")
    if not _LIKELY_EXTENT_M[0] <= extent <= _LIKELY_EXTENT_M[1]:
        warnings.append(f"extent of {extent:.4g} m: is the length unit right (km or m)?")
    if n_shells > 1:
        warnings.append(f"{n_shells} separate shells")
    leftover, facets = np.unique(facets, return_inverse=True)
    n_unused, vertices = n_unused + len(vertices) - len(leftover), vertices[leftover]
    facets = facets.reshape(-1, 3).astype(np.int32)
    for array in (vertices, facets, uv):
        if array is not None:
            array.setflags(write=False)
    report = ShapeReport(
        n_vertices=len(vertices), n_facets=len(facets), n_shells=n_shells, n_welded=n_welded, n_unused=n_unused,
        n_degenerate=n_degenerate, n_duplicate=n_duplicate, n_flipped=int(flipped.sum()), n_open_edges=n_open,
        n_non_manifold_edges=n_non_manifold, volume_m3=volume, extent_m=extents, warnings=tuple(warnings))
    return Shape(vertices_m=vertices, facets=facets, uv=uv, report=report)


def _wound(vertices: np.ndarray,
           facets: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Facets wound one way within each shell and outward, which were flipped, shells, open and odd edges."""
    count = len(facets)
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * np.int64(len(vertices)) + high
    order = np.argsort(key, kind="stable")
    _, begin, size = np.unique(key[order], return_index=True, return_counts=True)
    pairs = begin[size == 2]
    a, b = order[pairs], order[pairs + 1]
    # Two facets that run along an edge the same way are wound against each other.
    against = start[a] == start[b]
    owner_a, owner_b = a // 3, b // 3
    shell = connected_components(coo_array((np.ones(len(a)), (owner_a, owner_b)), shape=(count, count)),
                                 directed=False)[1]
    flipped = np.zeros(count, bool)
    if against.any():
        flipped = _two_coloured(count, owner_a, owner_b, against, shell)
    facets = np.where(flipped[:, None], facets[:, [0, 2, 1]], facets)
    centre = vertices.mean(axis=0)
    corner = vertices[facets] - centre
    volume = np.bincount(shell, np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])))
    inward = volume[shell] < 0.0
    return (np.where(inward[:, None], facets[:, [0, 2, 1]], facets), flipped ^ inward, shell,
            int((size == 1).sum()), int((size > 2).sum()))


def _two_coloured(count: int, owner_a: np.ndarray, owner_b: np.ndarray, against: np.ndarray,
                  shell: np.ndarray) -> np.ndarray:
    """Which facets to flip so that neighbours agree, each shell from its first facet outward."""
    graph = coo_array((np.where(against, 2, 1), (owner_a, owner_b)), shape=(count, count)).tocsr()
    graph = graph.maximum(graph.T).tocsr()
    flipped = np.zeros(count, bool)
    seeds = np.unique(shell, return_index=True)[1]
    for seed in seeds[np.unique(shell[owner_a[against]])]:
        order, parent = breadth_first_order(graph, seed, directed=False)
        rows = order[1:]
        if not len(rows):
            continue
        turns = np.asarray(graph[parent[rows], rows]).ravel() == 2
        for facet, before, turn in zip(rows.tolist(), parent[rows].tolist(), turns.tolist(), strict=True):
            flipped[facet] = flipped[before] ^ turn
    return flipped


def _thickness(vertices: np.ndarray) -> float:
    """Extent [m] across the plane that fits the vertices best."""
    centred = vertices - vertices.mean(axis=0)
    normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    return float(np.ptp(centred @ normal))


def _volume(vertices: np.ndarray, facets: np.ndarray) -> float:
    corner = vertices[facets] - vertices.mean(axis=0)
    return float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))) / 6.0
