"""What is found of a body at nodes of a grid of Sun and camera about it, and kept for all frames near them.

Always from the node, whether kept or not: the same request gives the same bytes, whatever came before.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from .frames import dcm, look_at
from .surface import Surface
from .view import BodyView, phase_angle, snapped

# Bytes that are kept, of each engine and kind: at one node some 40 to 60 MB of 3 million facets that cover 500 px. And
# how many at most, as nothing may be found.
_MOST_BYTES, _MOST = 1 << 28, 64


class KeptAtNodes:
    """The last ones that were asked for, as far as there is room; of each it is told how large it is, `n_bytes`."""

    def __init__(self):
        self._kept: OrderedDict[tuple[Any, ...], Any] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def n_bytes(self) -> int:
        """Of all that is kept."""
        return sum(each.n_bytes for each in self._kept.values())

    def forget(self) -> None:
        """Find all anew; no image changes."""
        self._kept.clear()

    def at(self, node: BodyView, of: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        """What was made at a node `of` something, or is made now."""
        key = (*of, *node.sun_direction_body.tolist(), *node.r_camera_body_m.tolist())
        if key not in self._kept:
            self._kept[key] = make()
            while len(self._kept) > 1 and (len(self._kept) > _MOST or self.n_bytes > _MOST_BYTES):
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


def at_node(view: BodyView, radius_m: float, directions: int, ranges: int) -> BodyView:
    """The view from the nearest nodes of Sun and camera: so many directions in 1 rad, and ranges in a factor e.

    Straight at the body, whichever way the camera looks.
    """
    to_sun = snapped(view.sun_direction_body, directions)
    range_m = radius_m * math.exp(round(math.log(view.range_m / radius_m) * ranges) / ranges)
    to_camera = snapped(view.r_camera_body_m / view.range_m, directions)
    place_m = range_m * to_camera
    return replace(view, sun_direction_body=to_sun, r_camera_body_m=place_m, range_m=range_m,
                   phase_rad=phase_angle(to_sun, to_camera), camera_from_body=dcm(look_at(place_m, np.zeros(3))))


def camera_at_node(focal_length_px: float) -> PinholeCamera:
    """Which looks straight at the body: what is found does not depend on where in an image others have it."""
    return PinholeCamera(name="node", width_px=1, height_px=1, focal_length_px=focal_length_px,
                         principal_point_px=(0.0, 0.0))


def phase_gain(surface: Surface, view: BodyView, node: BodyView) -> float:
    """How much brighter a surface is at the phase angle of a view than at a node's."""
    return _symmetric_brdf(surface, view.phase_rad) / _symmetric_brdf(surface, node.phase_rad)


def _symmetric_brdf(surface: Surface, phase_rad: float) -> float:
    """BRDF [1/sr] where incidence and emission are half of the phase angle."""
    half = 0.5 * phase_rad
    to_sun, to_camera = (np.array([sign * math.sin(half), 0.0, math.cos(half)]) for sign in (1.0, -1.0))
    return float(surface.brdf(to_sun, to_camera[None], np.array([[0.0, 0.0, 1.0]]), np.ones(1))[0])
