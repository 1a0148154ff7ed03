"""Groups of bodies that are drawn together: regions of the image that they touch, ranges of depth that they share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from glrender_camera import PinholeCamera

from .view import BodyView


@dataclass(frozen=True, eq=False)
class Group:
    """Bodies that are drawn together, and their place in the image: `Group.of` makes it."""

    views: tuple[BodyView, ...]
    roi: tuple[int, int, int, int]
    """Pixels that they may touch [px]: x0, y0, x1, y1, one past the last."""
    outline: tuple[float, float, float, float] | None
    """Box [px] around their outlines; None where one reaches beside the camera."""

    @classmethod
    def of(cls, views: Sequence[BodyView], camera: PinholeCamera) -> Group:
        """At least one body, and its place in a camera's image."""
        boxes = [view.bounds_px for view in views]
        if any(box is None for box in boxes):
            return cls(tuple(views), (0, 0, camera.width_px, camera.height_px), None)
        x0, y0, x1, y1 = outline = _around([box.tolist() for box in boxes])
        # Pixel k covers k - 1/2 to k + 1/2.
        roi = (_within(x0, 0, camera.width_px), _within(y0, 0, camera.height_px),
               _within(x1, 1, camera.width_px), _within(y1, 1, camera.height_px))
        return cls(tuple(views), roi, outline)

    @property
    def names(self) -> tuple[str, ...]:
        """The bodies' names."""
        return tuple(view.name for view in self.views)

    @cached_property
    def size_px(self) -> float:
        """Larger side of the outlines' box [px]; infinite where there is none."""
        if self.outline is None:
            return math.inf
        x0, y0, x1, y1 = self.outline
        return max(x1 - x0, y1 - y0)

    @cached_property
    def side_px(self) -> float:
        """Root of the area [px] of the part of the outlines' box that is in the image."""
        (x0, y0, x1, y1), (left, top, right, bottom) = self.roi, self.outline or self.roi
        return math.sqrt(max(min(right - left, x1 - x0) * min(bottom - top, y1 - y0), 1e-6))

    @cached_property
    def phase_rad(self) -> float:
        """Largest phase angle [rad]."""
        return max(view.phase_rad for view in self.views)


def region(views: Sequence[BodyView], camera: PinholeCamera) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 [px] of the pixels that visible bodies may touch, one past the last; all zero without any."""
    visible = [view for view in views if view.is_visible]
    return Group.of(visible, camera).roi if visible else (0, 0, 0, 0)


def _within(edge_px: float, beyond: int, frame_px: int) -> int:
    """The pixel that an edge is in, or the one beyond, within the frame; an edge may be infinitely far off."""
    return min(max(math.floor(min(max(edge_px, -1.0), frame_px) + 0.5) + beyond, 0), frame_px)


def touching(views: Sequence[BodyView], camera: PinholeCamera) -> list[Group]:
    """Visible bodies in groups whose regions share no pixel."""
    groups: list[Group] = []
    for view in views:
        if not view.is_visible:
            continue
        group = Group.of([view], camera)
        while touches := [other for other in groups if _overlap(group.roi, other.roi)]:
            names = {name for each in (group, *touches) for name in each.names}
            group = Group.of([view for view in views if view.name in names], camera)
            groups = [other for other in groups if other not in touches]
        groups.append(group)
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
