"""A body's shape: a closed triangle mesh, checked and repaired, with a report of what was found."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from glrender_camera.validate import integer, one_of, within

from ...base.errors import ShapeError, error_path
from ...base.rotations import angle_between
from .edges import Edges
from .facet_geometry import FacetSizes, area_vectors, longest_sides, renumbered
from .files import MAX_FACETS, own_unit, read_shape_file
from .materials import FileMaterial
from .shells import WELD_RTOL, are_all_different, closed_volumes, in_pairs, of_one_diagonal, seams, turned, wound

_log = logging.getLogger(__name__)

SIDES = ("file", "front", "both")
"""Sides of open shells that are seen and lit."""
_METRES_PER_UNIT = {"m": 1.0, "km": 1000.0}
# Facets whose edges are enough to measure a shape's roughness.
_CREASE_FACETS = 100_000
MIN_EXTENT_M, MAX_COORDINATE_M = 1e-3, 1e10
"""Bounds of extent and coordinates: a grain of sand, whose facets have areas that float32 holds, and seven Suns."""
# Small bodies span metres to a few thousand kilometres.
_LIKELY_EXTENT_M = (1.0, 6e6)
# Likely extents of bodies in files [m]; those visited have 170 m (Dimorphos) to 279 km (Psyche). Kilometres read as
# metres make them smaller than the first, metres read as kilometres larger than the second.
_LIKELY_NATURAL_M = (30.0, 1.5e5)
# Such a shape's facets at least, and of these the planes that differ at least, to so many digits of their normals: a
# box of quadrilaterals has half at most.
_NATURAL_FACETS, _NATURAL_PLANES, _NORMAL_DIGITS = 100, 0.8, 5


def metres_per_unit(length_unit: str | float) -> float:
    """Metres in a file's unit of length: "m", "km", or a number, 1e-9..1e9."""
    if not isinstance(length_unit, str):
        return within("length_unit", length_unit, 1e-9, 1e9)
    if length_unit not in _METRES_PER_UNIT:
        raise ShapeError("length_unit", "must be 'm', 'km' or metres per unit", length_unit)
    return _METRES_PER_UNIT[length_unit]


def file_scale(path: Path, length_unit: str | float | None) -> float:
    """Metres per unit of a file, by the unit that is given or that of its format.

    Raises
    ------
    ShapeError
        None is given and the format has none, or another one.
    """
    own = own_unit(path)
    unit = own if length_unit is None else length_unit
    if unit is None:
        raise ShapeError("length_unit", "missing", hint='shape files carry no unit: "m" or "km"')
    scale = metres_per_unit(unit)
    if own is not None and scale != metres_per_unit(own):
        raise ShapeError("length_unit", f"must be {own!r}, the unit of this format by its definition", length_unit,
                         "leave it out")
    return scale


@dataclass(frozen=True, kw_only=True)
class Seam:
    """The seam around a region that is set into a shape.

    Attributes
    ----------
    gap_max_m, gap_rms_m : float [m]
        Height of the region's rim over the shape, along the region's mean normal.
    offset_rms_m, relief_m, side_m : float [m]
        Height of the region over the shape's vertices beneath it, RMS; the relief there of the region and half of the
        shape's, in squares, about quadratic surfaces; the distance of those vertices. NaN with fewer than 12 of them,
        or where the shape has less than half of the region's relief.
    width_m, extent_m : float [m]
        Of the strip of facets that closes the gap, about; and the diagonal of the region's box.
    n_facets, n_strip, n_left_out, n_holes : int
        Facets of the region and of the strip, those beneath that are left out or cut, and holes that were closed.
    """

    gap_max_m: float
    gap_rms_m: float
    offset_rms_m: float
    relief_m: float
    side_m: float
    width_m: float
    extent_m: float
    n_facets: int
    n_strip: int
    n_left_out: int
    n_holes: int


@dataclass(frozen=True, kw_only=True)
class ShapeReport:
    """Report of the faults found in a shape, and of the repairs."""

    n_vertices: int
    n_facets: int
    n_shells: int
    n_two_sided: int
    n_welded: int
    n_seam: int
    seam_tolerance_m: float
    seam_gap_m: float
    n_unused: int
    n_degenerate: int
    n_duplicate: int
    n_flipped: int
    n_open_edges: int
    n_non_manifold_edges: int
    volume_m3: float
    extent_m: tuple[float, float, float]
    warnings: tuple[str, ...]
    seams: tuple[Seam, ...] = ()

    @property
    def is_watertight(self) -> bool:
        """Whether every edge has exactly two facets."""
        return not self.n_open_edges and not self.n_non_manifold_edges

    @property
    def has_odd_extent(self) -> bool:
        """Whether no body of whatever kind is likely to be as small or as large."""
        return not _LIKELY_EXTENT_M[0] <= max(self.extent_m) <= _LIKELY_EXTENT_M[1]


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
    solid : (F,) bool, optional
        Facets of shells that have an inside: closed, or closed but for holes. By default all.
    other_side : (F,) int, optional
        The facet that is the other side of each, in the same place, or -1. By default none has one.
    inside : bool
        Whether closed shells are as the file has them, of which some face inward: a camera may be within.
    material : (F,) int, optional
        Number of each facet's material.
    materials : tuple of FileMaterial
        Of the file: none by default.
    centre_of_whole_m : (3,) float64 [m], optional
        Of a part: `centre_m` of the shape whose part it is.
    is_moved : bool
        Whether `with_vertices` made it: one of many, of which renderers prepare nothing that takes longer than frames.
    """

    vertices_m: np.ndarray
    facets: np.ndarray
    uv: np.ndarray | None
    report: ShapeReport
    solid: np.ndarray | None = None
    other_side: np.ndarray | None = None
    inside: bool = False
    material: np.ndarray | None = None
    materials: tuple[FileMaterial, ...] = ()
    centre_of_whole_m: np.ndarray | None = None
    is_moved: bool = False

    def __repr__(self) -> str:
        size = " x ".join(f"{extent:.4g}" for extent in sorted(self.report.extent_m, reverse=True))
        return f"<Shape of {len(self.facets)} facets, {size} m>"

    @classmethod
    def from_file(cls, path: str | Path, *, length_unit: str | float | None = None, max_facets: int = MAX_FACETS,
                  sides: str = "file", surface: int | None = None, inside: bool = False) -> Shape:
        """Read, check and repair a shape file.

        Parameters
        ----------
        path : path
            OBJ, PLY, STL, PDS plate model (.tab, .plt), ICQ, binary glTF, OFF or SPICE DSK: docs/shapes.md.
        length_unit : "m", "km" or float
            Length unit of the file; metres per unit when a number, 1e-9..1e9. A DSK has its own.
        max_facets : int
        sides : {"file", "front", "both"}
            Which sides of open shells are there, as panels: those that the file gives (a binary glTF's `doubleSided`),
            the facets as they are, or both of each. Closed shells are seen from outside.
        surface : int, optional
            SPICE's number of the surface, of a DSK with several.
        inside : bool
            Closed shells stay as the file has them: a room faces inward, a pillar in it outward.

        Raises
        ------
        ShapeError
            With the file's name, the rule and the value.
        """
        path = Path(path)
        one_of("sides", sides, SIDES)
        with error_path(path.name):
            scale = file_scale(path, length_unit)
            mesh = read_shape_file(path, integer("max_facets", max_facets, 1, 2**31 - 1),
                                   None if surface is None else integer("surface", surface, -2**31, 2**31 - 1))
            # A number as long as 1e308 becomes infinite here and is refused as such.
            with np.errstate(over="ignore"):
                vertices_m = mesh.vertices * scale
            is_double = mesh.is_double_sided if sides == "file" else sides == "both"
            shape = checked(vertices_m, mesh.facets, mesh.uv, is_double, inside, mesh.material)
        messages = (*mesh.warnings, *_unit_doubt(shape), *shape.report.warnings)
        for text in messages:
            _log.warning("%s: %s", path.name, text)
        return replace(shape, report=replace(shape.report, warnings=messages), materials=mesh.materials)

    @classmethod
    def from_arrays(cls, vertices_m: np.ndarray, facets: np.ndarray, *, uv: np.ndarray | None = None,
                    sides: str = "file", inside: bool = False) -> Shape:
        """Check and repair a mesh: weld, drop what has no area, turn outward.

        Parameters
        ----------
        vertices_m : (V, 3) float [m]
            Within 1e10 m of the origin, and at least 1e-3 m in extent.
        facets : (F, 3) int
            From 0.
        uv : (F, 3, 2) float, optional
        sides : {"file", "front", "both"}
            As of `from_file`: "file" takes the facets as they are.
        inside : bool
            As of `from_file`.

        Raises
        ------
        ShapeError
        """
        return checked(vertices_m, facets, uv, one_of("sides", sides, SIDES) == "both", inside)

    def of_one_material(self) -> Shape:
        """The shape without its file's materials; the report says that one law replaces them."""
        known = [each.name for each in self.materials if each.law is not None]
        made = replace(self, material=None, materials=()) if self.materials else self
        return made.with_warnings([f"brdf replaces the file's materials: {', '.join(known)}; leave it out to have them"]
                                  if known else [])

    def with_warnings(self, texts: Sequence[str]) -> Shape:
        """The shape with more warnings in its report, each once."""
        new = [text for text in dict.fromkeys(texts) if text not in self.report.warnings]
        for text in new:
            _log.warning("%s", text)
        return replace(self, report=replace(self.report, warnings=(*self.report.warnings, *new))) if new else self

    def part(self, chosen: np.ndarray) -> Shape:
        """Some of its facets (F,) bool, drawn about the same place."""
        number = np.flatnonzero(chosen)
        used, facets = renumbered(self.facets[number], len(self.vertices_m))
        facets, other_side = facets.astype(np.int32), None
        if self.other_side is not None:
            place = np.full(len(chosen) + 1, -1)
            place[number] = np.arange(len(number))
            other_side = place[self.other_side[number]]
        edges = Edges(facets)
        report = replace(self.report, n_vertices=len(used), n_facets=len(number), warnings=(), n_open_edges=int(
            (edges.size == 1).sum()), n_non_manifold_edges=int((edges.size > 2).sum()))
        # The whole has the inside.
        return Shape(vertices_m=self.vertices_m[used], facets=facets, uv=None if self.uv is None else self.uv[number],
                     report=report, solid=np.zeros(len(number), bool), other_side=other_side,
                     inside=self.inside, centre_of_whole_m=self.centre_m)

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
        if self.centre_of_whole_m is not None:
            return self.centre_of_whole_m
        low_m, high_m = self.vertices_m.min(axis=0), self.vertices_m.max(axis=0)
        middle_m = 0.5 * (low_m + high_m)
        is_far = np.linalg.norm(middle_m) > 0.5 * np.linalg.norm(high_m - low_m)
        return middle_m if is_far else np.zeros(3)

    @cached_property
    def sizes(self) -> FacetSizes:
        """Sizes of its facets."""
        return FacetSizes(self.vertices_m, self.facets)

    @cached_property
    def facet_areas_m2(self) -> np.ndarray:
        """(F,) float64 [m2]."""
        return 0.5 * self.sizes.twice_areas

    @cached_property
    def longest_side_m(self) -> float:
        """Longest side [m] of any facet."""
        return float(self.sizes.longest_sides.max())

    @property
    def facet_normals(self) -> np.ndarray:
        """(F, 3) float64 outward unit normals."""
        return self.sizes.normals

    @cached_property
    def crease_rad(self) -> float:
        """RMS angle [rad] between facets that share an edge; of a large shape, of a part of its edges."""
        start, end = self.facets.ravel(), np.roll(self.facets, -1, axis=1).ravel()
        low = np.minimum(start, end)
        some = np.flatnonzero(low % max(len(self.facets) // _CREASE_FACETS, 1) == 0)
        key = low[some].astype(np.int64) * len(self.vertices_m) + np.maximum(start[some], end[some])
        order = np.argsort(key, kind="stable")
        pair = np.flatnonzero(np.diff(key[order]) == 0)
        if not len(pair):
            return 0.0
        a, b = (self.facet_normals[some[order[pair + k]] // 3] for k in range(2))
        return float(np.sqrt(np.mean(angle_between(a, b)**2)))

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

    def with_vertices(self, vertices_m: np.ndarray) -> Shape:
        """The same facets between other vertices, in the same order: nothing is welded, turned over or left out.

        Single facets may turn over, as where vertices pass their neighbours, while closed shells keep the sign of their
        volume: they are dark from outside, and whoever moves vertices holds them back.

        Parameters
        ----------
        vertices_m : (V, 3) array [m]

        Raises
        ------
        ShapeError
            Another number of vertices, one that is not finite or too far away, a facet without an area, or closed
            shells turned inside out.
        """
        try:
            if (vertices := np.asarray(vertices_m)).dtype.kind not in "iuf":
                raise TypeError
            vertices = vertices.astype(np.float64)
        except (TypeError, ValueError):
            raise ShapeError("vertices_m", f"must be numbers of shape {self.vertices_m.shape}", vertices_m) from None
        if vertices.shape != self.vertices_m.shape:
            raise ShapeError("vertices_m", f"must have the shape {self.vertices_m.shape} of those before",
                             vertices.shape, "of another number of vertices make a shape by from_arrays")
        _check_places(vertices)
        flat = np.flatnonzero(_are_flat(vertices, self.facets))
        if len(flat):
            raise ShapeError(f"facets[{flat[0]}]", "must have an area", vertices[self.facets[flat[0]]].tolist())
        before, after = closed_volumes(self.facets, self.vertices_m, vertices)
        if len(over := np.flatnonzero(before * after < 0.0)):
            raise ShapeError("vertices_m", "must leave closed shells facing as they do, of the volume's sign",
                             float(after[over[0]]), "do not mirror them, nor push one side through the other")
        volume, extent_m = _volume(vertices, self.facets), np.ptp(vertices, axis=0).tolist()
        vertices.setflags(write=False)
        report = replace(self.report, volume_m3=volume, extent_m=tuple(extent_m))
        return replace(self, vertices_m=vertices, report=report, is_moved=True)

    def to_file(self, path: str | Path) -> None:
        """Write an OBJ in metres, without texture coordinates; digits enough to read the same float64."""
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in self.vertices_m.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (self.facets + 1).tolist()]
        Path(path).write_text("\n".join(lines) + "\n", encoding="ascii")


def checked(vertices_m: object, facets: object, uv: object, is_double: np.ndarray | bool | None, inside: bool,
             material: np.ndarray | None = None) -> Shape:
    """The shape of arrays that `from_arrays` takes; facets (F,) of open shells that are double get their other side.

    And materials (F,), if they have some.
    """
    if not isinstance(inside, bool):
        raise ShapeError("inside", "must be true or false", inside)
    try:
        vertices, facets = np.asarray(vertices_m, np.float64), np.asarray(facets)
        uv = None if uv is None else np.asarray(uv, np.float32)
    except (TypeError, ValueError, OverflowError):
        raise ShapeError("", "needs arrays of numbers") from None
    if vertices.ndim != 2 or vertices.shape[1] != 3 or facets.ndim != 2 or facets.shape[1] != 3 or not len(facets):
        raise ShapeError("", "needs vertices (V, 3) and facets (F, 3)", (vertices.shape, facets.shape))
    _check_places(vertices)
    if facets.dtype.kind not in "iu" and not (facets.dtype.kind == "f" and (facets == np.round(facets)).all()):
        raise ShapeError("facets", "must be integers", facets)
    if facets.min() < 0 or facets.max() >= len(vertices):
        wrong = int(np.flatnonzero(((facets < 0) | (facets >= len(vertices))).any(axis=1))[0])
        raise ShapeError(f"facets[{wrong}]", f"must index vertices 0..{len(vertices) - 1}",
                         facets[wrong].tolist(), "plate models count from 1, trimesh from 0")
    if uv is not None and (uv.shape != (*facets.shape, 2) or not np.isfinite(uv).all()):
        raise ShapeError("uv", f"must be {(*facets.shape, 2)} finite numbers", uv.shape)
    is_double = np.broadcast_to(False if is_double is None else is_double, len(facets))
    return _repaired(vertices, facets.astype(np.int64), uv, is_double, inside, material)


def _check_places(vertices: np.ndarray) -> None:
    """Refuse vertices (V, 3) [m] that are no place."""
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise ShapeError(f"vertices[{bad[0]}]", "must be finite", vertices[bad[0]].tolist())
    far = np.flatnonzero(np.abs(vertices).max(axis=1) > MAX_COORDINATE_M)
    if len(far):
        raise ShapeError(f"vertices[{far[0]}]", f"must be within {MAX_COORDINATE_M:g} m of the origin",
                         vertices[far[0]].tolist(), "is the length unit right?")


def _are_flat(vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Whether facets (F,) have no area: no more than the rounding of their corners, however small they are."""
    extent, area = float(np.ptp(vertices, axis=0).max()), np.linalg.norm(area_vectors(vertices, facets), axis=1)
    return area <= 1e-15 * extent * longest_sides(vertices, facets)


def _repaired(vertices: np.ndarray, facets: np.ndarray, uv: np.ndarray | None, is_double: np.ndarray, inside: bool,
              material: np.ndarray | None) -> Shape:
    used, facets = renumbered(facets, len(vertices))
    n_unused, vertices = len(vertices) - len(used), vertices[used]
    extent = float(np.ptp(vertices, axis=0).max())
    if not extent > 0.0:
        raise ShapeError("", "has no extent: all vertices coincide", vertices[0].tolist())
    if not extent >= MIN_EXTENT_M:
        raise ShapeError("", f"must have an extent of at least {MIN_EXTENT_M:g} m", extent, "is the length unit right?")
    cell = extent * WELD_RTOL
    cells = np.round((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
    first = same = np.arange(len(cells))
    if not are_all_different(cells):
        _, first, same = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        same = same.ravel()
    # Keep the file's order of vertices: it is a good order for the vertex cache.
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    n_welded, vertices, facets = len(vertices) - len(first), vertices[first[order]], rank[same][facets]
    # Which of the given corners each corner was.
    corners = np.arange(facets.size, dtype=np.int32).reshape(-1, 3)
    kept, n_degenerate, n_duplicate = _without_copies(facets)
    facets, corners = facets[kept], corners[kept]
    edges = Edges(facets)
    welded, tolerance_m, gap_m = seams(vertices, edges)
    n_seam = int((welded != np.arange(len(vertices))).sum())
    if n_seam:
        kept, *more = _without_copies(welded[facets])
        facets, corners = welded[facets[kept]], corners[kept]
        n_degenerate, n_duplicate, edges = n_degenerate + more[0], n_duplicate + more[1], Edges(facets)
    if (changed := of_one_diagonal(vertices, facets, edges)) is not None:
        facets, corners = changed[0], corners.ravel()[changed[1]]
        edges = Edges(facets)
    shells = wound(vertices, facets, edges, inside)
    if inside and not shells.has_rooms:
        raise ShapeError("inside", "goes with closed shells of which one faces inward, and there is none", inside,
                         "leave it out where shells are open; turn a room's facets over where they face outward")
    flipped, corners = shells.is_flipped, turned(corners, shells.is_flipped)
    if (doubled := shells.is_open & is_double[corners[:, 0] // 3]).any():
        facets, corners = (np.concatenate([each, each[doubled][:, ::-1]]) for each in (shells.facets, corners))
        flipped = np.pad(flipped, (0, len(facets) - len(flipped)))
        shells = wound(vertices, facets, Edges(facets), inside)
        flipped, corners = flipped | shells.is_flipped, turned(corners, shells.is_flipped)
    facets, solid = shells.facets, shells.is_solid
    # Facets without an area close their neighbours' edges, and are left out only after shells are known.
    kept = ~_are_flat(vertices, facets)
    n_degenerate += int((~kept).sum())
    if not kept.any():
        raise ShapeError("", "has no facet with an area", n_degenerate)
    facets, solid, uv = facets[kept], solid[kept], None if uv is None else uv.reshape(-1, 2)[corners[kept]]
    material = None if material is None else material[corners[kept, 0] // 3]
    volume = _volume(vertices, facets)
    extents, n_flipped = tuple(float(x) for x in np.ptp(vertices, axis=0)), int(flipped[kept].sum())
    leftover, facets = renumbered(facets, len(vertices))
    n_unused, vertices = n_unused + len(vertices) - len(leftover) - n_seam, vertices[leftover]
    other_side = None
    if shells.n_two_sided:
        other_side = _other_sides(facets)
        vertices, facets = _with_own_backs(vertices, facets, other_side)
    facets = facets.astype(np.int32)
    for array in (vertices, facets, uv, solid, other_side, material):
        if array is not None:
            array.setflags(write=False)
    report = ShapeReport(
        n_vertices=len(vertices), n_facets=len(facets), n_shells=shells.n_shells,
        n_two_sided=shells.n_two_sided, n_welded=n_welded + n_seam, n_seam=n_seam, seam_tolerance_m=tolerance_m,
        seam_gap_m=gap_m, n_unused=n_unused, n_degenerate=n_degenerate, n_duplicate=n_duplicate, n_flipped=n_flipped,
        n_open_edges=shells.n_open_edges, n_non_manifold_edges=shells.n_non_manifold_edges, volume_m3=volume,
        extent_m=(extents[0], extents[1], extents[2]), warnings=())
    return Shape(vertices_m=vertices, facets=facets, uv=uv, solid=solid, other_side=other_side, inside=inside,
                 material=material,
                 report=replace(report, warnings=_warnings(report, shells.n_holed_edges)))


def _warnings(report: ShapeReport, n_holed_edges: int) -> tuple[str, ...]:
    """Warnings of a shape, each with a way out."""
    messages, n_open = [], report.n_open_edges - n_holed_edges
    if n_holed_edges:
        messages.append(f"{n_holed_edges} open edges of holes in a surface that is closed else: light and sight pass "
                        "through, and it is not turned outward; close them in the program that made the shape")
    if n_open:
        messages.append(f"{n_open} open edges of a surface that encloses nothing, as terrain: it is seen and lit from "
                        "the front of its facets alone; if it is dark from above, wind them the other way, and take "
                        "sides = \"both\" of panels")
    if report.n_non_manifold_edges:
        messages.append(f"{report.n_non_manifold_edges} edges with more than two facets: surfaces part there, and one "
                        "that is not closed without the others is not turned outward; leave out walls that nobody sees")
    if report.has_odd_extent:
        messages.append(f"extent of {max(report.extent_m):.4g} m: is the length unit right (km or m)?")
    if report.n_shells > 1:
        messages.append(f"{report.n_shells} separate shells")
    if report.n_flipped:
        messages.append(f"{report.n_flipped} facets turned over, so that neighbours agree and closed shells face "
                        "outward")
    if report.n_seam:
        messages.append(f"{report.n_seam} vertices on open edges welded to others within {report.seam_tolerance_m:.3g} "
                        f"m, over gaps of up to {report.seam_gap_m:.3g} m; where gaps are meant, make them wider")
    if report.n_degenerate:
        messages.append(f"{report.n_degenerate} facets without an area left out")
    if report.n_duplicate:
        messages.append(f"{report.n_duplicate} facets left out that are there twice with the same side")
    return tuple(messages)


def _without_copies(facets: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Numbers of facets with three corners, each side of one once, and how many of both kinds are left out."""
    a, b, c = facets.T
    kept = np.flatnonzero((a != b) & (b != c) & (c != a))
    if not len(kept):
        raise ShapeError("", "has no facet with an area", len(facets))
    n_degenerate, once = len(facets) - len(kept), kept
    if not are_all_different(np.sort(facets[kept], axis=1)):
        first = np.argmin(facets[kept], axis=1)
        turned = np.take_along_axis(facets[kept], (first[:, None] + np.arange(3)) % 3, axis=1)
        once = kept[np.sort(np.unique(turned, axis=0, return_index=True)[1])]
    return once, n_degenerate, len(kept) - len(once)


def _other_sides(facets: np.ndarray) -> np.ndarray:
    """Number (F,) of the facet that is the other side of each, or -1."""
    found, (one, two) = np.full(len(facets), -1), in_pairs(np.sort(facets, axis=1))
    found[one], found[two] = two, one
    return found


def _with_own_backs(vertices: np.ndarray, facets: np.ndarray, other_side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets whose other side comes before them with vertices of their own, so that each side has its normals there."""
    is_back = (other_side >= 0) & (other_side < np.arange(len(facets)))
    own, corners = renumbered(facets[is_back], len(vertices))
    facets[is_back] = corners + len(vertices)
    return np.concatenate([vertices, vertices[own]]), facets


def _unit_doubt(shape: Shape) -> tuple[str, ...]:
    """Whether a file's unit of length is right: of what looks like a small body, closed, in one piece and rough."""
    report, extent = shape.report, max(shape.report.extent_m)
    low, high = _LIKELY_NATURAL_M
    if report.has_odd_extent or low <= extent <= high:
        return ()
    if not report.is_watertight or report.n_shells > 1 or report.n_facets < _NATURAL_FACETS:
        return ()
    planes = np.unique(np.round(shape.facet_normals, _NORMAL_DIGITS), axis=0)
    if len(planes) < _NATURAL_PLANES * report.n_facets:
        return ()
    size, unit = ("small", "kilometres") if extent < low else ("large", "metres")
    return (f"extent of {extent:.4g} m: is the length unit right (km or m)? Few bodies of this kind are so {size}; if "
            f"the file is in {unit}, say so",)


def centre_of_volume(vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """The centre of volume (3,) of a closed mesh, in the unit of its vertices (V, 3)."""
    a, b, c = (vertices[facets[:, k]] for k in range(3))
    sixfold = np.einsum("ij,ij->i", a, np.cross(b, c))
    return ((a + b + c) * sixfold[:, None]).sum(axis=0) / (4.0 * sixfold.sum())


def _volume(vertices: np.ndarray, facets: np.ndarray) -> float:
    first = vertices.take(facets[:, 0], axis=0) - vertices.mean(axis=0)
    return float(np.einsum("ij,ij->", first, area_vectors(vertices, facets))) / 6.0
