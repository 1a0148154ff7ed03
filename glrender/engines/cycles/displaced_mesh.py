"""A body's surface detail as a mesh: facets in view are split until a pixel resolves no more, and their corners moved.

For backends that trace shapes. What the camera does not see stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from glrender_camera import PinholeCamera

from ...scene.body import Body
from ...scene.shape.shape import Shape
from ...view.view import BodyView

MAX_FACETS = 1 << 22
"""Most facets that a shape is split into: beyond this, edges may be longer."""
# Longest edge of a split facet [px]; width of the margin around the frame that is split, over the frame's [1].
_EDGE_PX, _MARGIN = 1.0, 0.05
# Facets that turn away by more than this cosine are not split.
_TURNED_AWAY = -0.1


def displaced(body: Body, view: BodyView, camera: PinholeCamera) -> Body:
    """The body with its detail as geometry, as a camera resolves it: the body itself where it resolves none.

    Corners move along the normals interpolated between the shape's vertices, so that nothing tears.
    """
    relief = body.relief
    if relief is None or not view.is_visible or not relief.active(view.depth_m[0] / camera.focal_length_px):
        return body
    sides = _inward_normals(camera, _MARGIN * max(camera.width_px, camera.height_px))

    def footprint_m(r: np.ndarray, reach_m: np.ndarray | float = 0.0) -> np.ndarray:
        """Footprint of a pixel [m], the least within a reach; infinite where the camera sees nothing there."""
        r = (r - view.r_camera_body_m) @ view.camera_from_body.T
        is_in = ((r @ sides.T).min(axis=1) > -reach_m)
        return np.where(is_in, np.maximum(np.linalg.norm(r, axis=1) - reach_m, 0.0) / camera.focal_length_px, np.inf)

    shape = body.drawn_shape
    middle = shape.vertices_m[shape.facets].mean(axis=1)
    towards = view.r_camera_body_m - middle
    cosine = np.einsum("ij,ij->i", shape.facet_normals, towards) / np.linalg.norm(towards, axis=1)
    edge_px = _EDGE_PX
    while True:
        made = split(shape, lambda *edge, edge_px=edge_px: edge_px * footprint_m(*edge), cosine > _TURNED_AWAY)
        if made is not None:
            break
        edge_px *= 1.25
    vertices, normals, facets, source = made
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    footprint = np.minimum(footprint_m(vertices), relief.facet_m)
    height = np.concatenate([relief(vertices[k:k + 65536], footprint[k:k + 65536])[0]
                             for k in range(0, len(vertices), 65536)])
    uv = None if shape.uv is None else _uv(shape, vertices, facets, source)
    ground = Shape(vertices_m=vertices + height[:, None] * normals, facets=facets, uv=uv, report=shape.report)
    return replace(body, shape=ground, detail=None)


def split(shape: Shape, limit_m: Callable[[np.ndarray, np.ndarray], np.ndarray], is_split: np.ndarray
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Split edges in the middle until none is longer than the limit there; edges are split for both of their facets.

    Parameters
    ----------
    shape : Shape
    limit_m : callable
        Middles (N, 3) [m] and half lengths (N,) [m] of edges to the lengths (N,) [m] that they may have.
    is_split : (F,) bool
        Facets whose edges may be split.

    Returns
    -------
    (V, 3) float64 vertices [m], (V, 3) float64 vertex normals of the shape, interpolated and not normalised,
    (G, 3) int32 facets and (G,) int, the facet of the shape that each is part of; or None beyond MAX_FACETS.
    """
    points = np.concatenate([shape.vertices_m, shape.vertex_normals], axis=1)
    facets, source = shape.facets.astype(np.int64), np.arange(len(shape.facets))
    while True:
        start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
        key = np.minimum(start, end) * len(points) + np.maximum(start, end)
        key, inverse = np.unique(key, return_inverse=True)
        low, high = key // len(points), key % len(points)
        middle = 0.5 * (points[low] + points[high])
        may = np.zeros(len(key), bool)
        may[inverse.reshape(-1, 3)[is_split[source]].ravel()] = True
        half_m = 0.5 * np.linalg.norm(points[high[may], :3] - points[low[may], :3], axis=1)
        may[may] = 2.0 * half_m > limit_m(middle[may, :3], half_m)
        if not may.any():
            return points[:, :3], points[:, 3:], facets.astype(np.int32), source
        number = np.where(may, len(points) + np.cumsum(may) - 1, -1)[inverse].reshape(-1, 3)
        points = np.concatenate([points, middle[may]])
        facets, source = _split_facets(facets, source, number)
        if len(facets) > MAX_FACETS:
            return None


def _split_facets(facets: np.ndarray, source: np.ndarray, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets (F, 3) parted at the middles (F, 3) of their edges, of which the k-th follows corner k; -1 for none."""
    count = (middles >= 0).sum(axis=1)
    made, origin = [facets[count == 0]], [source[count == 0]]
    for n in (1, 2, 3):
        here = np.flatnonzero(count == n)
        # The one edge that is split comes first, or the one that is not comes last.
        first = [None, np.argmax(middles[here] >= 0, axis=1), (np.argmin(middles[here] >= 0, axis=1) + 1) % 3,
                 np.zeros(len(here), int)][n]
        turn = (first[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(facets[here], turn, axis=1).T
        p, q, r = np.take_along_axis(middles[here], turn, axis=1).T
        parts = {1: [(a, p, c), (p, b, c)], 2: [(p, b, q), (a, p, q), (a, q, c)],
                 3: [(a, p, r), (p, b, q), (r, q, c), (p, q, r)]}[n]
        made += [np.stack(part, axis=1) for part in parts]
        origin += [source[here]] * len(parts)
    return np.concatenate(made), np.concatenate(origin)


def _inward_normals(camera: PinholeCamera, margin_px: float) -> np.ndarray:
    """Inward normals (4, 3), in the camera's axes, of the planes through it and the frame's sides, moved outwards."""
    x0, y0, x1, y1 = camera.bounds_px
    f, (cx, cy) = camera.focal_length_px, camera.principal_point_px
    normals = np.array([[f, 0.0, cx - x0 + margin_px], [-f, 0.0, x1 - cx + margin_px],
                        [0.0, f, cy - y0 + margin_px], [0.0, -f, y1 - cy + margin_px]])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _uv(shape: Shape, vertices: np.ndarray, facets: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Texture coordinates (G, 3, 2) of parts of facets."""
    corner = shape.vertices_m[shape.facets[source]]
    u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    uu, uv, vv = (np.einsum("ij,ij->i", *pair)[:, None] for pair in ((u, u), (u, v), (v, v)))
    w = vertices[facets] - corner[:, :1]
    wu, wv = np.einsum("ijk,ik->ij", w, u), np.einsum("ijk,ik->ij", w, v)
    second, third = (vv * wu - uv * wv) / (uu * vv - uv**2), (uu * wv - uv * wu) / (uu * vv - uv**2)
    weights = np.stack([1.0 - second - third, second, third], axis=2)
    return np.einsum("ijk,ikl->ijl", weights, shape.uv[source].astype(np.float64)).astype(np.float32)
