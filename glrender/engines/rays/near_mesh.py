"""Rays close to a large shape: facets near the camera have a scene of their own about it, where float32 is finest."""

from __future__ import annotations

import numpy as np

from .embree import EmbreeMesh
from .exact_loops import ALL_SIDES
from .exact_rays import ExactMesh
from .mesh import ANY_REACH, MOST_UNSURE, Hits, RayMesh, dot, ray_loops

# Reaches up to which rays meet the scene of the near facets, and facets are in it: what starts within the reach is then
# well off the ground before it goes on among the others, and surfaces that both scenes hold leave no gap.
_LEAVES, _HELD = 1.25, 1.5
# Memory of a facet's corners and their numbers in Embree [byte].
_CORNER_BYTES = 3 * 12 + 12
# Most that float32 may put a corner off [px]: of longer facets, and of those nearer, corners stay float64.
_MOST_OFF_PX = 0.003
# What is left there of all that rays start off facets: of 2^-29, by which float64 is finer, 2^7 is for what rounding
# adds up.
_FINE = 2.0**-22


class NearMesh(RayMesh):
    """A shape whose facets near a camera rays meet in coordinates about it, and the others in the shape's own.

    Parameters
    ----------
    shape : RayMesh
    place_m : (3,) float64 [m]
        The camera.
    reach_m : float [m]
        Within it pixels are too fine for float32 coordinates about the shape's middle.
    focal_length_px : float [px]

    Attributes
    ----------
    reach_m : float [m]
    """

    def __init__(self, shape: RayMesh, place_m: np.ndarray, reach_m: float, focal_length_px: float):
        self.facets, self.radius_m, self.normals = shape.facets, shape.radius_m, shape.normals
        self.offset_m, self.vertices_m, self.has_backs = shape.offset_m, shape.vertices_m, shape.has_backs
        self._shape, self._place_m, self.reach_m = shape, place_m, reach_m
        self._number, near_m = shape.facet_blocks.within(place_m, _HELD * reach_m)
        corners_m = shape.vertices_m[shape.facets[self._number]] - place_m
        self._far_m = np.sqrt(np.einsum("fcx,fcx->fc", corners_m, corners_m)).max(axis=1, initial=0.0)
        self._near_radius_m = float(self._far_m.max(initial=0.0))
        corner = np.arange(3 * len(self._number)).reshape(-1, 3)
        off_px = 0.5 * np.finfo(np.float32).eps * self._far_m * focal_length_px / np.maximum(near_m, 1e-300)
        self._scene = self._exact = None
        if (off_px > _MOST_OFF_PX).any():
            self._exact = ExactMesh(corners_m.reshape(-1, 3), corner)
        elif len(corner):
            self._scene = EmbreeMesh(corners_m.reshape(-1, 3) / self._near_radius_m, corner, self.has_backs)
        # Planes about the camera.
        self._near_normals = np.ascontiguousarray(shape.normals[self._number].T)
        self._near_offset_m = dot(self._near_normals, corners_m[:, 0].T)

    def is_at(self, place_m: np.ndarray) -> bool:
        """Whether it is of a camera at a place (3,) [m]."""
        return bool((place_m == self._place_m).all())

    @property
    def memory_bytes(self) -> int:
        """Memory [byte] of what a frame's camera adds to the shape: near facets, and boxes; without Embree's tree."""
        arrays = [self._number, self._far_m, self._near_normals, self._near_offset_m]
        return (sum(array.nbytes for array in arrays) + _CORNER_BYTES * len(self._number)
                + self._shape.facet_blocks.memory_bytes)

    def lift_m(self, r_body_m: np.ndarray, facet: np.ndarray, least: float) -> np.ndarray:
        found, from_place = self._shape.lift_m(r_body_m, facet, least), r_body_m - self._place_m[:, None]
        near = np.flatnonzero(dot(from_place, from_place) < self.reach_m**2)
        if len(near):
            number = facet.take(near)
            # Points that rounding has put within the reach may be of a facet beyond.
            index = np.minimum(np.searchsorted(self._number, number), len(self._number) - 1)
            far_m = np.where(self._number.take(index) == number, self._far_m.take(index), self.radius_m)
            fine = _FINE if self._exact is not None else 1.0
            found[near] = fine * (least * far_m + np.minimum(self._shape.unsure_m.take(number), MOST_UNSURE * far_m))
        return found

    def first(self, origin_m: np.ndarray, ray: np.ndarray, sides: int = ALL_SIDES) -> Hits:
        start_m = origin_m.reshape(3, -1)
        from_place_m = start_m - self._place_m[:, None]
        enters_m, leaves_m = self._within(from_place_m, ray)
        facet, distance_m = np.full(ray.shape[1], -1), np.full(ray.shape[1], np.inf)

        def meet(some: np.ndarray, number: np.ndarray, found_m: np.ndarray) -> None:
            nearer = found_m < distance_m.take(some)
            facet[some[nearer]], distance_m[some[nearer]] = number[nearer], found_m[nearer]

        outside = np.flatnonzero(enters_m > 0.0)
        if len(outside):
            hits = self._shape.first(_some(start_m, outside), ray.take(outside, axis=1), sides)
            before = np.flatnonzero(hits.distance_m <= enters_m.take(outside).take(hits.place))
            meet(outside.take(hits.place.take(before)), hits.facet.take(before), hits.distance_m.take(before))
        inside = np.flatnonzero(np.isfinite(enters_m) & (facet < 0))
        place, number, found_m = self._first_near(_some(from_place_m, inside), ray.take(inside, axis=1), sides)
        meet(inside.take(place), number, found_m)
        beyond = inside[distance_m.take(inside) > leaves_m.take(inside)]
        if len(beyond):
            along_m, towards = leaves_m.take(beyond), ray.take(beyond, axis=1)
            hits = self._shape.first(_some(start_m, beyond) + along_m * towards, towards, sides)
            meet(beyond.take(hits.place), hits.facet, hits.distance_m + along_m.take(hits.place))
        place = np.flatnonzero(facet >= 0)
        number = facet.take(place)
        # To take some of the transpose NumPy would copy all.
        normal = np.ascontiguousarray(self.normals.take(number, axis=0).T)
        return Hits(place=place, facet=number, distance_m=distance_m.take(place), ray=ray.take(place, axis=1),
                    normal=normal)

    def blocks(self, start_m: np.ndarray, direction: np.ndarray, reach_m: np.ndarray = ANY_REACH,
               sides: int = ALL_SIDES) -> np.ndarray:
        from_place_m, ray = start_m.T - self._place_m[:, None], np.transpose(direction).reshape(3, -1)
        enters_m, leaves_m = self._within(from_place_m, ray)
        reaches = len(reach_m) > 1
        # In turn: among the far facets up to the near ones, among these, and from there on.
        is_blocked = np.zeros(len(start_m), bool)
        rest = np.flatnonzero(enters_m > 0.0)
        if len(rest):
            most_m = np.minimum(reach_m.take(rest) if reaches else reach_m, enters_m.take(rest))
            is_blocked[rest] = self._shape.blocks(start_m.take(rest, axis=0), _some(ray, rest).T, most_m, sides)
        rest = np.flatnonzero(np.isfinite(enters_m) & ~is_blocked)
        if len(rest):
            is_blocked[rest] = self._are_blocked_near(from_place_m.take(rest, axis=1), _some(ray, rest),
                                                      reach_m.take(rest) if reaches else reach_m, sides)
        rest = np.flatnonzero(np.isfinite(enters_m) & ~is_blocked & (leaves_m < reach_m))
        if len(rest):
            along_m, towards = leaves_m.take(rest), _some(ray, rest)
            is_blocked[rest] = self._shape.blocks(start_m.take(rest, axis=0) + (along_m * towards).T, towards.T,
                                                  reach_m.take(rest) - along_m if reaches else reach_m, sides)
        return is_blocked

    def _within(self, from_place_m: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) [m] along rays at which they enter the sphere of the near facets and leave it.

        Both are infinite where a ray does not meet it; the first is 0 within it.
        """
        along_m = dot(from_place_m, ray)
        beyond_m2 = dot(from_place_m, from_place_m) - (_LEAVES * self.reach_m) ** 2
        square = along_m * along_m - beyond_m2
        root = np.sqrt(np.maximum(square, 0.0))
        leaves_m = root - along_m
        is_met = (square > 0.0) & (leaves_m > 0.0)
        return np.where(is_met, np.maximum(-along_m - root, 0.0), np.inf), np.where(is_met, leaves_m, np.inf)

    def _first_near(self, start_m: np.ndarray, ray: np.ndarray, sides: int
                    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays (K,), facets (K,) and distances (K,) [m] of first hits among the near facets, from about the camera."""
        if self._exact is not None:
            place, index, distance_m = self._exact.first(start_m, ray, self.has_backs * sides)
        elif self._scene is not None:
            place, index, distance_m, *_ = ray_loops.find_first(
                self._scene.scene, start_m, ray, self._near_radius_m, self._near_normals, self._near_offset_m,
                ray_loops.FILTERS[self.has_backs * sides])
        else:
            return np.zeros(0, int), np.zeros(0, int), np.zeros(0)
        return place, self._number.take(index), distance_m

    def _are_blocked_near(self, start_m: np.ndarray, ray: np.ndarray, reach_m: np.ndarray, sides: int) -> np.ndarray:
        if self._exact is not None:
            return self._exact.are_blocked(start_m, ray, reach_m, self.has_backs * sides)
        is_blocked = np.zeros(start_m.shape[1], bool)
        if self._scene is not None:
            ray_loops.find_blocked(self._scene.scene, start_m, ray, reach_m, self._near_radius_m,
                                   ray_loops.FILTERS[self.has_backs * sides], is_blocked)
        return is_blocked


def _some(columns: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The one of columns (3, 1), or the chosen of (3, N)."""
    return columns if columns.shape[1] == 1 else columns.take(chosen, axis=1)
