"""Triangles in a plane: which of some lie at points, and those between an outline and a hole in it."""

from __future__ import annotations

import mapbox_earcut
import numpy as np

from .edges import Edges
from .facet_geometry import counted

# Share of a triangle [1] by which a point may lie outside and counts as in it.
_ON = 1e-9
# Cells along a side in which triangles are looked up, at most.
_MOST_CELLS = 512
# Rounds of flips at most, and the sine of opposite angles' sum that counts as none.
_ROUNDS, _FLIP_RTOL = 2000, 1e-9
# Share of the extent by which points are moved before earcut looks at them: it leaves out corners in a line.
_MOVED = 1e-9


def located(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which triangles lie at which points, by their numbers (N,), (N,), and the points' weights (N, 3) in them.

    Parameters
    ----------
    points : (P, 2) float64
    corners : (T, 3, 2) float64
        Counter-clockwise.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    least, most = corners.min(axis=1), corners.max(axis=1)
    some = np.flatnonzero(((most >= low) & (least <= high)).all(axis=1))
    count = int(np.clip(np.sqrt(len(some)), 1, _MOST_CELLS))
    step = np.maximum(high - low, np.finfo(float).tiny) / count
    cell = lambda place: np.clip((place - low) / step, 0, count - 1).astype(int)  # noqa: E731
    begin, size = cell(least[some]), cell(most[some]) - cell(least[some]) + 1
    number = np.repeat(np.arange(len(some)), size.prod(axis=1))
    place = counted(size.prod(axis=1))
    key = (begin[number, 0] + place // size[number, 1]) * count + begin[number, 1] + place % size[number, 1]
    order = np.argsort(key, kind="stable")
    key, number = key[order], some[number[order]]
    own = cell(points) @ [count, 1]
    begins = np.searchsorted(key, own)
    counts = np.searchsorted(key, own, side="right") - begins
    point = np.repeat(np.arange(len(points)), counts)
    triangle = number[np.repeat(begins, counts) + counted(counts)]
    a, b, c = np.moveaxis(corners[triangle], 1, 0)
    p = points[point]
    weights = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # triangles without an area hold no point
        weights /= _cross(b - a, c - a)[:, None]
    inside = (weights >= -_ON).all(axis=1)
    return point[inside], triangle[inside], weights[inside]


def between(points: np.ndarray, outline: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """Triangles (T, 3) by the points' numbers, counter-clockwise: Delaunay's between an outline and a hole in it.

    Parameters
    ----------
    points : (P, 2) float64
    outline, hole : (N,), (M,) int
        Counter-clockwise; no hole where M is 0.
    """
    corners, extent = np.concatenate([outline, hole]), float(np.ptp(points[outline], axis=0).max())
    moved = points[corners] + _MOVED * extent * np.random.default_rng(0).uniform(-1.0, 1.0, (len(corners), 2))
    ends = [len(outline), len(corners)] if len(hole) else [len(outline)]
    made = mapbox_earcut.triangulate_float64(moved, np.array(ends, np.uint32)).astype(int).reshape(-1, 3)
    a, b, c = np.moveaxis(moved[made], 1, 0)
    made = np.where((_cross(b - a, c - a) < 0.0)[:, None], made[:, [0, 2, 1]], made)
    return corners[_flipped(moved, made)]


def area(outline: np.ndarray) -> float:
    """The area that an outline (N, 2) encloses, above 0 where it is counter-clockwise."""
    side = outline - outline[0]
    return 0.5 * float(_cross(side, np.roll(side, -1, axis=0)).sum())


def areas(corners: np.ndarray) -> np.ndarray:
    """Areas (T,) of triangles (T, 3, 2)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * np.abs(_cross(b - a, c - a))


def _flipped(points: np.ndarray, made: np.ndarray) -> np.ndarray:
    """Delaunay's triangles within the outline of others (T, 3), by flips of their inner edges.

    Source: Lawson (1977).
    """
    for _ in range(_ROUNDS):
        edges = Edges(made)
        a, b = edges.pairs()
        p, q = edges.start[a], edges.end[a]
        r, s = (made.ravel()[side - side % 3 + (side + 2) % 3] for side in (a, b))
        rp, rq, sp, sq = points[p] - points[r], points[q] - points[r], points[p] - points[s], points[q] - points[s]
        excess = _cross(rp, rq) * (sp * sq).sum(axis=1) + _cross(sq, sp) * (rp * rq).sum(axis=1)
        scale = np.sqrt(np.prod([(each**2).sum(axis=1) for each in (rp, rq, sp, sq)], axis=0))
        chosen = np.flatnonzero(excess < -_FLIP_RTOL * scale)
        if not len(chosen):
            break
        # One flip a triangle.
        one, two = a[chosen] // 3, b[chosen] // 3
        first = np.full(len(made), len(chosen))
        for owner in (one, two):
            np.minimum.at(first, owner, np.arange(len(chosen)))
        free = np.flatnonzero((first[one] == np.arange(len(chosen))) & (first[two] == np.arange(len(chosen))))
        p, q, r, s = (each[chosen[free]] for each in (p, q, r, s))
        made[one[free]], made[two[free]] = np.stack([p, s, r], axis=1), np.stack([s, q, r], axis=1)
    return made


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
