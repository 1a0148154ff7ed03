"""Finer shapes of parts of a body, set into its shape: one mesh without a crack, as closed as it was."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from glrender_camera.validate import unit_quaternion, vector
from scipy.spatial import cKDTree

from ...base.errors import ConfigError, ShapeError, error_path
from ...base.rotations import dcm
from ...brdf import Law
from .bisection import bisected
from .edges import Edges, connected
from .facet_geometry import area_vectors, joined, longest_sides, renumbered
from .files import MAX_FACETS
from .materials import FileMaterial
from .planar import area, areas, between, located
from .shape import Seam, Shape, checked

_log = logging.getLogger(__name__)
# Width of a seam over the longest side of its rim and over the RMS gap [1]: a slope of 1 in 4, 14 degrees, throws no
# shadow until the Sun is lower.
_OF_SIDE, _OF_GAP = 2.0, 4.0
# Distance from the rim over the width [1] within which no vertex is kept: facets whose sides are no longer than the
# width, met by a rim whose sides are half as long at most, have a vertex within sqrt(1/3) + 1/4 of the rim's.
_CLEAR = 0.85
# Gap over the region's extent [1] that is refused, and that is doubted: grounds of one place differ by less.
_MOST_GAP, _DOUBTED_GAP = 0.5, 0.05
# Share of the body's area [1] that a region has at most: it is laid on along one direction.
_MOST_AREA = 0.5
OF_WHOLE_BODY = "give a map of the whole body as its albedo_texture, with albedo_projection"
"""Words of the way to an albedo on a body with regions."""
# Relative difference of a seam's area to what it should have [1]: rounding.
_AREA_RTOL = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """A finer shape of a part of a body.

    Parameters
    ----------
    shape : Shape
        An open surface in one piece, as a landing site or a mosaic of maplets.
    brdf : Law, optional
        Its own law; the body's by default.
    r_region_body_m : (3,) float [m], optional
        The place of its origin on the body; zero by default, and of ground of a map the map's.
    q_body_from_region : (4,) float [1], optional
        From its axes to the body's; identity by default, and of ground of a map the map's.
    """

    shape: Shape
    brdf: Law | None = None
    r_region_body_m: Sequence[float] | np.ndarray | None = None
    q_body_from_region: Sequence[float] | np.ndarray | None = None

    def __post_init__(self):
        if not isinstance(self.shape, Shape):
            raise ConfigError("shape", "must be a glrender.Shape", self.shape)
        if getattr(self.shape, "albedo_map", None) is not None:
            raise ConfigError("terrain.orthophoto", "goes with ground that is no region",
                              hint=f"leave it out, or {OF_WHOLE_BODY}")
        if not isinstance(self.brdf, Law | None):
            raise ConfigError("brdf", "must be a law of glrender.brdf", self.brdf)
        r_m, q = self.r_region_body_m, self.q_body_from_region
        if r_m is None:
            r_m = getattr(self.shape, "r_site_planet_m", np.zeros(3))
        if q is None:
            q = getattr(self.shape, "q_site_from_planet", np.array([1.0, 0.0, 0.0, 0.0])) * [1.0, -1.0, -1.0, -1.0]
        object.__setattr__(self, "r_region_body_m", vector("r_region_body_m", r_m))
        object.__setattr__(self, "q_body_from_region", unit_quaternion("q_body_from_region", q))

    @property
    def vertices_m(self) -> np.ndarray:
        """(V, 3) float64 [m], body-fixed."""
        return self.shape.vertices_m @ dcm(np.asarray(self.q_body_from_region)).T + np.asarray(self.r_region_body_m)

    def on(self, shape: Shape) -> np.ndarray:
        """Vertices (V, 3) float64 [m] in a body's axes: of ground around a site of a map, by the places of both."""
        own_m, origin_m = (getattr(each, "r_site_planet_m", None) for each in (self.shape, shape))
        if own_m is None or origin_m is None or not np.array_equal(np.asarray(self.r_region_body_m), own_m):
            return self.vertices_m
        return (self.vertices_m - origin_m) @ dcm(getattr(shape, "q_site_from_planet")).T  # noqa: B009


def with_regions(shape: Shape, regions: Sequence[Region], law: Law | None = None) -> Shape:
    """A shape with regions set into it, later ones over earlier ones.

    What of the shape lies beneath a region is left out. Around its rim facets are bisected until they are as small as
    the seam is wide, and the strip between them and the rim is closed by facets between vertices that both have.

    Parameters
    ----------
    shape : Shape
    regions : sequence of Region
    law : Law, optional
        The body's, where a region has another: the shape has materials then.

    Raises
    ------
    ShapeError
        A region is not on the body, turned inside out, of several pieces, or larger than half of the body.
    """
    if not isinstance(regions, Sequence) or isinstance(regions, str):
        raise ConfigError("regions", "must be a list of Region", regions)
    if shape.other_side is not None:
        raise ShapeError("sides", "must be front of a body with regions: its shape has facets with two sides")
    mesh = _Mesh(shape.vertices_m, shape.facets.astype(np.int64), np.zeros(len(shape.facets), int))
    found, warnings = [], list(shape.report.warnings)
    for index, region in enumerate(regions):
        with error_path(f"regions[{index}]"):
            if not isinstance(region, Region):
                raise ConfigError("", "must be a Region", region)
            if region.shape.other_side is not None:
                raise ShapeError("sides", "must be front of a region: its shape has facets with two sides")
            mesh, seam = _Seat(mesh, region.on(shape), region.shape.facets.astype(np.int64)).filled(index + 1)
        found.append(seam)
        if seam.gap_max_m > _DOUBTED_GAP * seam.extent_m:
            warnings.append(f"the rim of regions[{index}], {seam.extent_m:.4g} m across, is up to {seam.gap_max_m:.4g} "
                            "m off the shape around: are its length unit and pose right?")
        elif seam.offset_rms_m > np.hypot(seam.relief_m, _DOUBTED_GAP * seam.side_m):
            warnings.append(f"the body's vertices beneath regions[{index}] are {seam.offset_rms_m:.3g} m RMS off it, "
                            f"more than its own relief, {seam.relief_m:.3g} m RMS: are its length unit and pose right?")
        if seam.n_holes:
            warnings.append(f"{seam.n_holes} holes in regions[{index}] closed by flat facets")
    for text in warnings[len(shape.report.warnings):]:
        _log.warning("%s", text)
    material, materials = None, shape.materials
    if any(each.brdf is not None for each in regions):
        laws = [law, *(each.brdf or law for each in regions)]
        materials = tuple(FileMaterial(name=f"regions[{number - 1}]" if number else "body", law=each)
                          for number, each in enumerate(laws))
        material = mesh.owner
    made = checked(mesh.vertices_m, mesh.facets, None, False, shape.inside, material)
    report = replace(made.report, warnings=tuple(warnings), seams=tuple(found))
    return replace(made, report=report, materials=materials)


@dataclass(frozen=True)
class _Mesh:
    """Vertices (V, 3) [m], facets (F, 3) and whose they are (F,): 0 of the body, then the regions'."""

    vertices_m: np.ndarray
    facets: np.ndarray
    owner: np.ndarray


class _Seat:
    """The place of one region on a mesh, seen along the region's mean normal."""

    def __init__(self, mesh: _Mesh, vertices_m: np.ndarray, facets: np.ndarray):
        self.vertices_m, self.facets = vertices_m, facets
        vectors, own = area_vectors(mesh.vertices_m, mesh.facets), area_vectors(self.vertices_m, self.facets)
        share = float(np.linalg.norm(own, axis=1).sum() / np.linalg.norm(vectors, axis=1).sum())
        if share > _MOST_AREA:
            raise ShapeError("", f"must have at most {_MOST_AREA:g} of the body's area", share,
                             "is its length unit right? Of more than that make the body's shape")
        normal = own.sum(axis=0)
        self.normal = normal / np.linalg.norm(normal)
        across = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        across /= np.linalg.norm(across)
        # About the region's middle: on a planet the digits of centimetres stay.
        self.middle_m, self.axes = self.vertices_m.mean(axis=0), np.array([across, np.cross(self.normal, across)])
        self.extent_m = float(np.linalg.norm(np.ptp(self.vertices_m, axis=0)))
        self.rim, self.holes = self._rims()
        self.rim_m, self.mesh = self._flat(self.vertices_m[self.rim]), mesh
        self.gaps_m = self._gaps()
        side_m = float(np.linalg.norm(self.vertices_m[self.rim] - self.vertices_m[np.roll(self.rim, 1)], axis=1).max())
        self.width_m = max(_OF_SIDE * side_m, _OF_GAP * float(np.sqrt(np.mean(self.gaps_m**2))))
        self._tree = cKDTree(self.rim_m)

    def filled(self, number: int) -> tuple[_Mesh, Seam]:
        """The mesh with the region in it, as the owner of that number, and the seam."""
        mesh, limit = self.mesh, MAX_FACETS - len(self.facets)
        vertices, facets, parent = bisected(mesh.vertices_m, mesh.facets, self._is_coarse, limit)
        if len(facets) > limit:
            raise ShapeError("", f"must make at most {MAX_FACETS} facets with the body", len(facets),
                             "set posts at the rim farther apart")
        is_left_out = self._beneath(vertices, facets)
        outline = self._outline(facets, is_left_out)
        kept = facets[~is_left_out]
        all_m, all_facets = joined([(vertices, kept), (self.vertices_m, self.facets)])
        rim, flat = self.rim + len(vertices), self._flat(all_m)
        strip = between(flat, outline, rim)
        asked_m2 = area(flat[outline]) - area(self.rim_m)
        made_m2 = float(areas(flat[strip]).sum())
        if not abs(made_m2 - asked_m2) <= _AREA_RTOL * area(flat[outline]):
            raise ShapeError("", "must have a rim that, seen along its mean normal, does not cross itself",
                             hint="cut it so that its rim is smooth")
        filled = [between(flat, hole[::-1] + len(vertices), hole[:0]) for hole in self.holes]
        owner = np.concatenate([mesh.owner[parent[~is_left_out]], np.full(len(self.facets), number),
                                np.zeros(len(strip), int), np.full(sum(map(len, filled)), number)])
        used, rows = renumbered(np.concatenate([all_facets, strip, *filled]), len(all_m))
        before, after = (np.bincount(np.minimum(Edges(each).size, 3), minlength=4) for each in (facets, rows))
        if (before[[1, 3]] != after[[1, 3]]).any():
            raise ShapeError("", "must leave the body as closed as it is, and its rim cannot be joined",
                             hint="cut it so that its rim is smooth; is its pose right?")
        offset_rms_m, relief_m, side_m = self._offset()
        seam = Seam(gap_max_m=float(np.abs(self.gaps_m).max()), gap_rms_m=float(np.sqrt(np.mean(self.gaps_m**2))),
                    offset_rms_m=offset_rms_m, relief_m=relief_m, side_m=side_m,
                    width_m=self.width_m, extent_m=self.extent_m, n_facets=len(self.facets), n_strip=len(strip),
                    n_left_out=len(np.unique(parent[is_left_out])), n_holes=len(self.holes))
        return _Mesh(all_m[used], rows, owner), seam

    def _flat(self, places_m: np.ndarray) -> np.ndarray:
        """Places (N, 3) [m] in the plane (N, 2) across the mean normal."""
        return (places_m - self.middle_m) @ self.axes.T

    def _rims(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """The region's outer rim (N,), counter-clockwise, and those of its holes."""
        edges = Edges(self.facets)
        sides, _ = edges.sides(edges.size == 1)
        if not len(sides) or (edges.size > 2).any():
            raise ShapeError("shape", "must be an open surface with a rim, of which no edge has more than two facets",
                             hint="cut the part that is finer out of it")
        loops = _loops(edges.start[sides], edges.end[sides])
        if loops is None:
            raise ShapeError("shape", "must have a rim that passes no vertex twice",
                             hint="leave out facets that hang on by a corner")
        sizes = [area(self._flat(self.vertices_m[loop])) for loop in loops]
        outer = [loop for loop, size in zip(loops, sizes, strict=True) if size > 0.0]
        if len(outer) != 1:
            raise ShapeError("shape", "must be in one piece with one outer rim", len(outer),
                             "give each piece as a region")
        return outer[0], [loop for loop, size in zip(loops, sizes, strict=True) if size <= 0.0]

    def _gaps(self) -> np.ndarray:
        """Heights (N,) [m] of the rim's vertices over the mesh, along the mean normal."""
        _, gaps_m = self._hits(self.mesh.vertices_m, self.mesh.facets, 1.0)
        n_off = int((~np.isfinite(gaps_m)).sum())
        if n_off or np.abs(gaps_m).max() > _MOST_GAP * self.extent_m:
            _, turned_m = self._hits(self.mesh.vertices_m, self.mesh.facets, -1.0)
            if np.isfinite(turned_m).all() and np.abs(turned_m).max() <= _MOST_GAP * self.extent_m:
                raise ShapeError("shape", "must face outward as the body does, and it faces inward",
                                 hint="turn its facets over")
            how = ("is its length unit right, and r_region_body_m and q_body_from_region?")
            if n_off:
                raise ShapeError("", f"must lie on the body, and of its rim's {len(gaps_m)} vertices some have none of "
                                 "it beneath", n_off, how)
            raise ShapeError("", f"must be within {_MOST_GAP:g} of its extent, {self.extent_m:.4g} m, of the body's "
                             "surface", float(np.abs(gaps_m).max()), how)
        return gaps_m

    def _hits(self, vertices: np.ndarray, facets: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
        """The facet (N,) that is nearest along the normal to each of the rim's vertices, and the height (N,) over it.

        Of facets that face to one side: 1 along the normal, -1 against it. Heights are infinite where none is.
        """
        facing = np.flatnonzero(side * (area_vectors(vertices, facets) @ self.normal) > 0.0)
        corners = self._flat(vertices)[facets[facing]]
        point, hit, weights = located(self.rim_m * [1.0, side], corners * [1.0, side])
        height = (vertices - self.middle_m) @ self.normal
        up = (self.vertices_m[self.rim] - self.middle_m) @ self.normal
        gap = up[point] - (weights * height[facets[facing[hit]]]).sum(axis=1)
        order = np.lexsort((np.abs(gap), point))
        own, first = np.unique(point[order], return_index=True)
        facet, gaps_m = np.full(len(up), -1), np.full(len(up), np.inf)
        facet[own], gaps_m[own] = facing[hit[order[first]]], gap[order[first]]
        return facet, gaps_m

    def _offset(self) -> tuple[float, float, float]:
        """RMS height [m] of the region over the body's vertices beneath, the relief there, and the vertices' distance.

        A coarse body is right at its vertices: a region in its place differs from them by less than its own relief,
        ground of elsewhere by the relief of both. Relief is about quadratic surfaces; the body's counts half. NaN with
        too few vertices for a fit, or where the body has less than half of the region's relief, as a sphere has.
        """
        mesh, corners = self.mesh, self._flat(self.vertices_m)[self.facets]
        facing = area_vectors(mesh.vertices_m, mesh.facets) @ self.normal > 0.0
        chosen = np.unique(mesh.facets[facing])
        point, hit, weights = located(self._flat(mesh.vertices_m[chosen]), corners)
        rise = ((mesh.vertices_m[chosen[point]] - self.middle_m) @ self.normal,
                (weights * ((self.vertices_m - self.middle_m) @ self.normal)[self.facets[hit]]).sum(axis=1))
        is_near = np.abs(rise[1] - rise[0]) <= _MOST_GAP * self.extent_m
        x, y = self._flat(mesh.vertices_m[chosen[point[is_near]]]).T / self.extent_m
        smooth = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        if len(x) < 2 * smooth.shape[1]:
            return math.nan, math.nan, math.nan
        both = np.stack([each[is_near] for each in rise], axis=1)
        body_m, own_m = np.sqrt(np.mean((both - smooth @ np.linalg.lstsq(smooth, both)[0]) ** 2, axis=0))
        if not body_m > 0.5 * own_m:
            return math.nan, math.nan, math.nan
        return (float(np.sqrt(np.mean(np.diff(both) ** 2))), float(np.hypot(own_m, np.sqrt(0.5) * body_m)),
                float(np.sqrt(area(self.rim_m) / len(x))))

    def _near(self, vertices: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facets (F,) that face as the region does and are at its rim, and the facet (N,) beneath each rim's vertex."""
        flat = self._flat(vertices)
        reach = _CLEAR * self.width_m
        some = np.flatnonzero(((flat >= self.rim_m.min(axis=0) - reach)
                               & (flat <= self.rim_m.max(axis=0) + reach)).all(axis=1))
        is_near = np.zeros(len(flat), bool)
        is_near[some] = np.isfinite(self._tree.query(flat[some], distance_upper_bound=reach)[0])
        beneath, _ = self._hits(vertices, facets, 1.0)
        ring = is_near[facets].any(axis=1) & (area_vectors(vertices, facets) @ self.normal > 0.0)
        ring[beneath[beneath >= 0]] = True
        return ring, beneath

    def _is_coarse(self, vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
        ring, _ = self._near(vertices, facets)
        return ring & (longest_sides(vertices, facets) > self.width_m)

    def _beneath(self, vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
        """Facets (F,) to leave out: those at the rim, and what they cut off from the rest of the body."""
        ring, beneath = self._near(vertices, facets)
        edges, number = Edges(facets), np.arange(len(facets))
        one, two = (side // 3 for side in edges.pairs())

        def piece(chosen: np.ndarray) -> np.ndarray:
            both = chosen[one] & chosen[two]
            return connected(one[both], two[both], len(number))[1]

        mine = piece(ring)
        out = ring & np.isin(mine, mine[beneath])
        size = np.linalg.norm(area_vectors(vertices, facets), axis=1)
        while True:
            rest = piece(~out)
            touching = np.unique(np.concatenate([rest[one[out[two] & ~out[one]]], rest[two[out[one] & ~out[two]]]]))
            if not len(touching):
                raise ShapeError("", "must lie within the body's surface, with ground around it",
                                 hint="leave the body's own shape out, or cut the region smaller")
            largest = np.argmax(np.bincount(rest, size)[touching])
            out |= np.isin(rest, np.delete(touching, largest))
            # Facets that only a corner keeps apart would leave an outline that passes a vertex twice.
            edge = edges.of_sides()
            sides = np.flatnonzero(np.repeat(out, 3) & (np.bincount(edge[np.repeat(out, 3)], minlength=len(edges.size)
                                                                    )[edge] == 1))
            if (edges.size[edge[sides]] == 1).any():
                raise ShapeError("", "must lie within the body's surface, and it reaches an open edge",
                                 hint="cut the region smaller")
            twice = np.bincount(edges.start[sides], minlength=len(vertices)) > 1
            if not (more := twice[facets].any(axis=1) & ~out).any():
                return out
            out |= more

    def _outline(self, facets: np.ndarray, is_left_out: np.ndarray) -> np.ndarray:
        """Vertices (N,) around what is left out, counter-clockwise."""
        edges = Edges(facets[is_left_out])
        sides, _ = edges.sides(edges.size == 1)
        loops = _loops(edges.start[sides], edges.end[sides])
        if loops is None or len(loops) != 1:
            raise ShapeError("", "must lie where the body faces as it does, all around its rim",
                             hint="cut the region smaller, or in several")
        return loops[0]


def _loops(start: np.ndarray, end: np.ndarray) -> list[np.ndarray] | None:
    """Vertices of the loops that sides make, each in their direction; None where a vertex is passed twice."""
    after = dict(zip(start.tolist(), end.tolist(), strict=True))
    if len(after) != len(start) or len(set(after.values())) != len(start):
        return None
    loops = []
    while after:
        first, place = next(iter(after.items()))
        loop = [first]
        del after[first]
        while place != first:
            loop.append(place)
            place = after.pop(place)
        loops.append(np.array(loop))
    return loops
