"""Polygons cut into triangles, concave ones too, so that every corner is kept: no open edge arises next to a neighbour.
"""

from __future__ import annotations

import mapbox_earcut
import numpy as np

# Area of a fan's triangle over its polygon's [1], below which it has none or lies outside.
_AREA_RTOL = 1e-12
# Corners from which a fan is tried before earcut cuts it, and polygons looked at together.
_FANS, _TOGETHER = 8, 500_000
MAX_CORNERS = 10_000
"""Most corners of a polygon: earcut may take the square of their number where an outline crosses itself."""


def triangulated(vertices: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Triangles (T, 3) int, as places among the corners, in the polygons' order and winding.

    A fan where one leaves nothing out, else by earcut; the same from whichever corner a polygon begins, and for its
    other side. A polygon whose outline crosses itself is cut as well as it goes. Holes are joined to the outline by an
    edge that is passed twice.

    Parameters
    ----------
    vertices : (V, 3) float64
    corners : (N,) int
        Vertices of all polygons, one polygon after the other; those of an index outside the vertices make fans.
    sizes : (P,) int
        Corners of each polygon, at least 3.

    Raises
    ------
    ValueError
        A polygon has more than `MAX_CORNERS` corners.
    """
    if len(sizes) and sizes.max() > MAX_CORNERS:
        raise ValueError(f"a polygon of {sizes.max()} corners, where {MAX_CORNERS} are allowed: triangulate it first")
    begins = np.cumsum(sizes) - sizes
    known = (corners >= 0) & (corners < len(vertices))
    points = np.where(known[:, None], vertices[np.where(known, corners, 0)], np.nan)
    triangles, owners = [], []
    for size in np.unique(sizes):
        alike = np.flatnonzero(sizes == size)
        for first in range(0, len(alike), _TOGETHER):
            some = alike[first:first + _TOGETHER]
            cut, of = _cut(points, begins[some], int(size))
            triangles.append(cut)
            owners.append(some[of])
    owner = np.concatenate(owners)
    return np.concatenate(triangles)[np.argsort(owner, kind="stable")]


def _cut(points: np.ndarray, begins: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (T, 3) of polygons of one size (P,), and the number of each triangle's polygon."""
    everyone = np.arange(len(begins))
    if size == 3:
        return begins[:, None] + np.arange(3), everyone
    fan = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], axis=1)
    ring, is_reversed = _rings(points[begins[:, None] + np.arange(size)])
    ring += begins[:, None]
    start, left = np.zeros(len(begins), int), everyone
    for turn in range(min(size, _FANS)):
        corner = points[np.roll(ring[left], -turn, axis=1)]
        side = corner[:, 1:] - corner[:, :1]
        area = np.cross(side[:, :-1], side[:, 1:])
        normal = area.sum(axis=1)
        # Vertices that are not finite are refused by the shape, by their number.
        is_fan = ~(np.einsum("pki,pi->pk", area, normal)
                   <= _AREA_RTOL * np.einsum("pi,pi->p", normal, normal)[:, None]).any(axis=1)
        start[left[is_fan]] = turn
        left = left[~is_fan]
        if not len(left):
            break
    fans = np.setdiff1d(everyone, left)
    place = (fan.ravel() + start[fans, None]) % size
    triangles = [np.take_along_axis(ring[fans], place, axis=1)]
    owners = [np.repeat(fans, size - 2)]
    for polygon in left:
        corner = ring[polygon][_earcut(points[ring[polygon]])]
        triangles.append(corner)
        owners.append(np.full(len(corner) // 3, polygon))
    triangle, owner = np.concatenate([some.reshape(-1, 3) for some in triangles]), np.concatenate(owners)
    return np.where(is_reversed[owner, None], triangle[:, ::-1], triangle), owner


def _rings(corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The order (P, K) in which polygons' corners (P, K, 3) are taken, and whether it is reversed (P,).

    From the first corner by its coordinates towards its first neighbour: both sides of a panel have the same triangles.
    """
    is_first = np.ones(corner.shape[:2], bool)
    for axis in range(3):
        value = np.where(is_first, corner[..., axis], np.inf)
        is_first &= value == value.min(axis=1, keepdims=True)
    start, size = np.argmax(is_first, axis=1), corner.shape[1]
    every = np.arange(len(corner))
    difference = corner[every, start - 1] - corner[every, (start + 1) % size]
    axis = np.argmax(difference != 0.0, axis=1)
    is_reversed = difference[every, axis] < 0.0
    return (start[:, None] + np.where(is_reversed, -1, 1)[:, None] * np.arange(size)) % size, is_reversed


def _earcut(points: np.ndarray) -> np.ndarray:
    """Corners (3 T,) of triangles of a polygon (K, 3), in its winding."""
    return mapbox_earcut.triangulate_float64(_flattened(points), np.array([len(points)], np.uint32)).astype(int)


def _flattened(points: np.ndarray) -> np.ndarray:
    """Points (K, 2) across the polygon's mean normal; equal ones stay equal."""
    side = points - points[0]
    normal = np.cross(side, np.roll(side, -1, axis=0)).sum(axis=0)
    length = np.linalg.norm(normal)
    normal = normal / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    return np.stack([side[:, 0] * w[0] + side[:, 1] * w[1] + side[:, 2] * w[2] for w in (u, v)], axis=1)
