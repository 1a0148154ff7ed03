"""Levels of detail: a shape with fewer facets that keeps the slopes of the full one.

A decimated rough body is one to three per cent too bright, because the slopes that it lost sent
light elsewhere. So each facet of a level carries the normals of the full shape: a grid of texels
over the facet, each with the normal (and the albedo) of the full facet that is nearest. What a
level still loses is the parallax and the cast shadows of relief smaller than its facets.
"""

from __future__ import annotations

import hashlib
import logging
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from .cache import cached_arrays, tell_of_wait
from .shape import Shape

_log = logging.getLogger(__name__)

# Facets of one level over those of the next finer one.
_RATIO = 4
# What making them takes a facet, about.
_FACET_S = 8e-6
# A full shape or a level with fewer facets than this is fast enough: a draw call costs as much.
_FEWEST_FULL, _FEWEST_FACETS = 24_000, 1500
# The finest level: more facets than this are no faster than the full shape to speak of.
_MOST_FACETS = 800_000
# Texels of a level: four for each facet of the full shape tell where one ends, up to a memory of 64 MB.
_TEXELS_PER_FACET = 4
_MOST_TEXELS = 8_000_000
_MOST_TEXELS_PER_SIDE = 16
_ARRAYS = ("vertices_m", "facets", "source_facet", "deviation_m", "beyond_m")


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """One level of detail.

    Attributes
    ----------
    vertices_m : (V, 3) float64 [m]
    facets : (F, 3) int32
        Counter-clockwise from outside.
    texels_per_side : int
        n: each facet has n * n texels.
    source_facet : (F, n * n) int32
        The full shape's facet whose normal a texel carries; `texel_barycentric` has their places.
    deviation_m : float [m]
        RMS distance of the full shape's facets from the level's surface.
    beyond_m : float [m]
        How far the level may reach beyond the full shape's convex hull: the farthest of its vertices from the nearest
        of the full shape's.
    """

    vertices_m: np.ndarray
    facets: np.ndarray
    texels_per_side: int
    source_facet: np.ndarray
    deviation_m: float
    beyond_m: float = 0.0


def texel_barycentric(texels_per_side: int) -> np.ndarray:
    """Weights (n * n, 3) of a facet's corners at the centres of its texels, in the shader's order.

    A side of n parts cuts a triangle into n * n like ones. Texel ``k = i (2 n - i) + 2 j + upper``
    lies in row i (by the second corner's weight), place j (by the third's).
    """
    n = texels_per_side
    rows = []
    for i in range(n):
        for j in range(n - i):
            rows.append((i + 1.0 / 3.0, j + 1.0 / 3.0))
            if j < n - i - 1:
                rows.append((i + 2.0 / 3.0, j + 2.0 / 3.0))
    second, third = np.array(rows).T / n
    return np.stack([1.0 - second - third, second, third], axis=1)


def levels_of_detail(shape: Shape, cache: Path | None = None) -> tuple[Level, ...]:
    """The levels of a shape, finest first; none for a small one.

    Parameters
    ----------
    shape : Shape
    cache : Path, optional
        Folder that keeps them from run to run, by the shape's content; `cache_folder()` by default.
        A folder that cannot be written costs the time to make them again, and no more.

    Notes
    -----
    Quadric decimation (Garland and Heckbert 1997) by `fast_simplification`; about 10 us a facet.
    """
    if shape.report.n_facets < _FEWEST_FULL:
        return ()
    targets = [shape.report.n_facets // _RATIO]
    while targets[-1] > _MOST_FACETS:
        targets[-1] //= _RATIO
    while targets[-1] // _RATIO >= _FEWEST_FACETS:
        targets.append(targets[-1] // _RATIO)
    names = [f"{name}_{index}" for index in range(len(targets)) for name in _ARRAYS]
    arrays = cached_arrays(f"lod3-{_key(shape, targets)}", names, lambda: _made(shape, targets), cache)
    levels = []
    for index in range(len(targets)):
        vertices, facets, source, deviation, beyond = (arrays[f"{name}_{index}"] for name in _ARRAYS)
        levels.append(Level(vertices_m=vertices, facets=facets, source_facet=source, deviation_m=float(deviation),
                            beyond_m=float(beyond), texels_per_side=math.isqrt(source.shape[1])))
    return tuple(levels)


def _made(shape: Shape, targets: list[int]) -> dict[str, np.ndarray]:
    from fast_simplification import simplify

    tell_of_wait(_log, "making levels of detail", shape.report.n_facets, _FACET_S)
    centre = shape.vertices_m[shape.facets].mean(axis=1)
    tree, corners = cKDTree(centre), cKDTree(shape.vertices_m)
    # In units of the body, about its middle: the library has thresholds of its own.
    middle = shape.vertices_m.mean(axis=0)
    scale = np.abs(shape.vertices_m - middle).max()
    points, facets = (shape.vertices_m - middle) / scale, shape.facets.copy()
    arrays, began = {}, time.perf_counter()
    for index, target in enumerate(targets):
        points, facets = simplify(points, facets, target_count=target)
        facets = np.asarray(facets, np.int32)
        vertices = np.asarray(points, np.float64) * scale + middle
        kept = np.linalg.norm(_crosses(vertices, facets), axis=1) > 1e-12 * scale**2
        beyond_m = corners.query(vertices, workers=-1)[0].max()
        made = (*_with_texels(shape, centre, tree, vertices, facets[kept]), beyond_m)
        arrays |= {f"{name}_{index}": array for name, array in zip(_ARRAYS, made, strict=True)}
    _log.info("levels of detail of %d facets made in %.1f s", shape.report.n_facets, time.perf_counter() - began)
    return arrays


def _with_texels(shape: Shape, centre: np.ndarray, tree: cKDTree, vertices: np.ndarray,
                 facets: np.ndarray) -> tuple[np.ndarray, ...]:
    side = 1
    wanted = min(_TEXELS_PER_FACET * shape.report.n_facets, _MOST_TEXELS)
    while side < _MOST_TEXELS_PER_SIDE and len(facets) * (2 * side)**2 <= wanted:
        side *= 2
    place = np.einsum("tc,fcx->ftx", texel_barycentric(side), vertices[facets])
    _, nearest = tree.query(place.reshape(-1, 3), workers=-1)
    source = nearest.reshape(len(facets), -1).astype(np.int32)
    normal = _crosses(vertices, facets)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("ftx,fx->ft", centre[source] - place, normal)
    return vertices, facets, source, np.sqrt(np.mean(height**2))


def _crosses(vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[facets[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _key(shape: Shape, targets: list[int]) -> str:
    parameters = f"{targets} {_TEXELS_PER_FACET} {_MOST_TEXELS} {_MOST_TEXELS_PER_SIDE}".encode()
    return hashlib.sha256(shape.content_hash.encode() + parameters).hexdigest()[:32]
