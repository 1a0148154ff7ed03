"""Chunks of a mesh: neighbouring facets that are left out together where they cannot show.

A chunk is left out when it lies beside the window, or when all of its facets face away (Shirman and
Abi-Ezzi 1993, the cone of normals). What is left out would have drawn nothing.
"""

from __future__ import annotations

import numpy as np

# A draw call costs as much as some hundred facets, and so does the test of a chunk in NumPy.
_FEWEST_FACETS, _MOST_CHUNKS = 128, 2048


class Chunks:
    """Chunks of a mesh's facets.

    Parameters
    ----------
    vertices_m : (V, 3) float64 [m]
    facets : (F, 3) int
        Counter-clockwise from outside.

    Attributes
    ----------
    order : (F,) int64
        Facets in the order in which chunks count them: neighbours in space are neighbours in it.
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray):
        size = max(_FEWEST_FACETS, -(-len(facets) // _MOST_CHUNKS))
        corners = [vertices_m[facets[:, k]] for k in range(3)]
        parts = _split((corners[0] + corners[1] + corners[2]) / 3.0, size)
        self.order = np.concatenate(parts)
        corners = [corner[self.order] for corner in corners]
        self._count = np.array([len(part) for part in parts])
        self._first = np.cumsum(self._count) - self._count
        low = np.minimum.reduceat(np.minimum.reduce(corners), self._first)
        high = np.maximum.reduceat(np.maximum.reduce(corners), self._first)
        self._centre_m = 0.5 * (low + high)
        self._radius_m = 0.5 * np.linalg.norm(high - low, axis=1)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        axis = np.add.reduceat(normal, self._first)
        self._axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
        cos_cone = np.minimum.reduceat(np.einsum("fx,fx->f", normal, np.repeat(self._axis, self._count, axis=0)),
                                       self._first)
        # Of a cone wider than a half-space no direction sees backs alone. A little more, for round-off.
        self._sin_cone = np.where(cos_cone > 0.0, np.sqrt(np.maximum(1.0 - cos_cone**2, 0.0)) + 1e-6, np.inf)

    def __len__(self) -> int:
        return len(self._first)

    def in_window(self, clip_from_body: np.ndarray) -> np.ndarray:
        """Chunks (C,) bool that may be between a window's sides and before its far plane.

        Parameters
        ----------
        clip_from_body : (4, 4) float64
            Perspective or orthographic.
        """
        inside = np.ones(len(self), bool)
        for row, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, -1.0)):
            plane = clip_from_body[3] + sign * clip_from_body[row]
            inside &= self._centre_m @ plane[:3] + plane[3] >= -self._radius_m * np.linalg.norm(plane[:3])
        return inside

    def boxes_px(self, camera_from_body: np.ndarray, r_camera_body_m: np.ndarray, focal_length_px: float,
                 principal_point_px: tuple[float, float]) -> np.ndarray:
        """Boxes (C, 4) [px], x0, y0, x1, y1, that hold each chunk's sphere in the image; infinite beside the camera.

        Parameters
        ----------
        camera_from_body : (3, 3) float64
        r_camera_body_m : (3,) float64 [m]
        focal_length_px : float [px]
        principal_point_px : (float, float) [px]
        """
        x, y, z = camera_from_body @ (self._centre_m - r_camera_body_m).T
        # (x + dx) / (z + dz) is within r (z + |x|) / (z (z - r)) of x / z.
        with np.errstate(divide="ignore", invalid="ignore"):
            half = focal_length_px * self._radius_m / (z - self._radius_m)
            place = [c / z * focal_length_px + p for c, p in zip((x, y), principal_point_px, strict=True)]
            reach = [half * (1.0 + np.abs(c) / z) for c in (x, y)]
        low, high = ([p + sign * r for p, r in zip(place, reach, strict=True)] for sign in (-1.0, 1.0))
        boxes = np.stack([*low, *high], axis=1)
        boxes[z <= self._radius_m] = (-np.inf, -np.inf, np.inf, np.inf)
        return boxes

    def facing_point(self, point_m: np.ndarray) -> np.ndarray:
        """Chunks (C,) bool of which a point (3,) [m], body-fixed, may see a front."""
        away = self._centre_m - point_m
        return np.einsum("cx,cx->c", away, self._axis) < self._sin_cone * np.linalg.norm(away, axis=1) + self._radius_m

    def facing_direction(self, direction: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Chunks (C,) bool of which a far-off point in a direction (3,), or within `margin` [rad], may see a front."""
        return -self._axis @ direction < self._sin_cone + margin

    def n_facets(self, chosen: np.ndarray) -> int:
        """Facets of chunks (C,) bool."""
        return int(self._count[chosen].sum())

    def bounds_m(self, chosen: np.ndarray, frame_from_body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest coordinates (3,) [m] of chosen chunks' spheres in a rotated frame (3, 3)."""
        centre, radius = self._centre_m[chosen] @ frame_from_body.T, self._radius_m[chosen, None]
        return (centre - radius).min(axis=0), (centre + radius).max(axis=0)

    def runs(self, chosen: np.ndarray) -> list[tuple[int, int]]:
        """First facet and count of each run of chosen chunks, in the order of `order`."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]])))
        first, last = edges[::2], edges[1::2] - 1
        end = self._first + self._count
        return [(int(self._first[a]), int(end[b] - self._first[a])) for a, b in zip(first, last, strict=True)]


def _split(points: np.ndarray, most: int) -> list[np.ndarray]:
    """Numbers of points (N, 3) in parts of at most so many: halved across the longest side, again and again."""
    along = np.ascontiguousarray(points.T)
    parts, whole = [], [np.arange(len(points))]
    while whole:
        part = whole.pop()
        if len(part) <= most:
            parts.append(np.sort(part))
            continue
        # A row at a time: along an axis, NumPy takes five times as long.
        inside = [row.take(part) for row in along]
        longest = max(inside, key=np.ptp)
        middle = len(part) // 2
        halves = np.argpartition(longest, middle)
        whole += [part[halves[middle:]], part[halves[:middle]]]
    return parts
