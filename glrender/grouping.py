"""Which bodies are drawn together: regions of the image that they touch, ranges of depth that they share."""

from __future__ import annotations

import numpy as np
from glrender_camera import PinholeCamera

from .view import BodyView


def region(views: list[BodyView], camera: PinholeCamera) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 [px] of the pixels that visible bodies may touch."""
    frame = np.array([camera.width_px, camera.height_px])
    if any(view.bounds_px is None for view in views):
        return (0, 0, camera.width_px, camera.height_px)
    bounds = np.array([view.bounds_px for view in views])
    # Pixel k covers k - 1/2 to k + 1/2.
    low = np.clip(np.floor(bounds[:, :2].min(axis=0) + 0.5), 0, frame)
    high = np.clip(np.floor(bounds[:, 2:].max(axis=0) + 0.5) + 1, 0, frame)
    return tuple(int(x) for x in (*low, *high))


def outline(views: list[BodyView]) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 [px] around the outlines of bodies that are all before the camera."""
    bounds = np.array([view.bounds_px for view in views])
    return tuple(float(x) for x in (*bounds[:, :2].min(axis=0), *bounds[:, 2:].max(axis=0)))


def outline_px(views: list[BodyView]) -> float:
    """Larger side [px] of the box around the outlines of bodies; infinite where one has none."""
    if any(view.bounds_px is None for view in views):
        return float("inf")
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
    if not regions:
        return (0, 0, 0, 0)
    boxes = np.array(regions)
    return tuple(int(x) for x in (*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)))


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
