"""Groups of bodies that are drawn together: regions of the image that they touch, ranges of depth that they share."""

from __future__ import annotations

import math
from collections.abc import Sequence

from glrender_camera import PinholeCamera

from .view import BodyView


def region(views: list[BodyView], camera: PinholeCamera) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 [px] of the pixels that visible bodies may touch."""
    if any(view.bounds_px is None for view in views):
        return (0, 0, camera.width_px, camera.height_px)
    x0, y0, x1, y1 = outline(views)
    # Pixel k covers k - 1/2 to k + 1/2.
    return (_within(x0, 0, camera.width_px), _within(y0, 0, camera.height_px),
            _within(x1, 1, camera.width_px), _within(y1, 1, camera.height_px))


def _within(edge_px: float, beyond: int, frame_px: int) -> int:
    """The pixel that an edge is in, or the one beyond, within the frame; an edge may be infinitely far off."""
    return min(max(math.floor(min(max(edge_px, -1.0), frame_px) + 0.5) + beyond, 0), frame_px)


def outline(views: list[BodyView]) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 [px] around the outlines of bodies that are all before the camera."""
    return _around([view.bounds_px.tolist() for view in views])


def outline_px(views: list[BodyView]) -> float:
    """Larger side [px] of the box around the outlines of bodies; infinite where one has none."""
    if any(view.bounds_px is None for view in views):
        return math.inf
    x0, y0, x1, y1 = outline(views)
    return max(x1 - x0, y1 - y0)


def touching(views: list[BodyView], camera: PinholeCamera) -> list[list[BodyView]]:
    """Visible bodies in groups whose regions share no pixel."""
    groups: list[list[BodyView]] = []
    for view in views:
        if not view.is_visible:
            continue
        group = [view]
        while True:
            touches = [other for other in groups if _overlap(region(group, camera), region(other, camera))]
            if not touches:
                break
            group = sum(touches, group)
            groups = [other for other in groups if other not in touches]
        groups.append(sorted(group, key=views.index))
    return groups


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def union(regions: list[tuple[int, int, int, int]]) -> tuple[int, int, int, int]:
    """The box around regions; all zero around none."""
    return tuple(map(int, _around(regions))) if regions else (0, 0, 0, 0)


def _around(boxes: Sequence[Sequence[float]]) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = zip(*boxes, strict=True)
    return min(x0), min(y0), max(x1), max(y1)


def depth_groups(views: list[BodyView]) -> list[tuple[float, float, list[BodyView]]]:
    """Bodies that share a depth range, farthest first: (near, far, bodies) [m].

    A fitted range keeps a 24-bit depth buffer exact to 1e9 radii; bodies whose ranges do not
    overlap are drawn one behind the other.
    """
    groups: list[tuple[float, float, list[BodyView]]] = []
    for view in sorted((v for v in views if v.is_visible), key=lambda v: v.depth_m[1], reverse=True):
        near, far = view.depth_m
        if groups and far >= groups[-1][0]:
            last_near, last_far, members = groups[-1]
            groups[-1] = (min(near, last_near), last_far, [*members, view])
        else:
            groups.append((near, far, [view]))
    return groups
