"""Points of a body's outline in the image, to a thousandth of a pixel: between a ray that meets it and one off it."""

from __future__ import annotations

from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ..engines.rays.laser_ranges import laser_ranges
from ..scene.scene import Scene
from ..view.state import State
from ..view.view import view_bodies

# Halvings of the pixel in which the outline is.
_HALVINGS = 10
_DIGITS = 4


def limb_points(scene: Scene, state: State, camera: PinholeCamera, body_id: np.ndarray, number: int,
                count: int) -> dict[str, Any]:
    """Points of the outline of a body, each between the centres of two pixels.

    The outline is that of the facets: of a smooth body they are off by the sagitta of its facets besides.

    Parameters
    ----------
    scene : Scene
    state : State
    camera : PinholeCamera
        Of the scene.
    body_id : (height, width) int
        As of `Image`.
    number : int
        The body's, in the scene.
    count : int, 1..1000
        Points, evenly along the outline; fewer where it crosses fewer pixels.

    Returns
    -------
    dict
        `px` (N, 2), within 0.001 px, in order of the angle about the body's middle; `faces_sun` (N,): whether the facet
        there faces the Sun: where it does the limb is lit, but for cast shadows. An edge behind a nearer body is none.
    """
    inside, outside = _crossings(body_id == number)
    if len(inside) > count:
        chosen = np.linspace(0, len(inside), count, endpoint=False).astype(int)
        inside, outside = inside[chosen], outside[chosen]
    if not len(inside):
        return {"px": [], "faces_sun": []}
    ends = lambda places: laser_ranges(scene, state, camera.directions(places), camera.name)  # noqa: E731
    # A lens moves the outline of `body_id` by half a pixel, to whole ones: there it is outside these two centres.
    step = outside - inside
    inside = inside - step * (ends(inside).body_id != number)[:, None]
    outside = outside + step * (ends(outside).body_id == number)[:, None]
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        is_met = ends(middle).body_id == number
        inside, outside = np.where(is_met[:, None], middle, inside), np.where(is_met[:, None], outside, middle)
    last, beyond = ends(inside), ends(outside)
    is_limb = ~(beyond.range_m < last.range_m) & (last.body_id == number) & (beyond.body_id != number)
    body = scene.bodies[number]
    sun = view_bodies(state, camera, {each.name: each.hull for each in scene.bodies})[number].sun_direction_body
    faces = body.drawn_shape.facet_normals[last.facet_id] @ sun > 0.0
    return {"px": np.round(0.5 * (inside + outside)[is_limb], _DIGITS).tolist(), "faces_sun": faces[is_limb].tolist()}


def _crossings(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres (N, 2) [px] of pixels of a mask and of their neighbours outside, by their angle about the middle."""
    y, x = np.nonzero(mask)
    if not x.size:
        return np.empty((0, 2)), np.empty((0, 2))
    x0, y0 = x.min(), y.min()
    # With a border that is inside: where the image ends is no limb.
    part = np.pad(mask[y0:y.max() + 1, x0:x.max() + 1], 1)
    height, width = mask.shape
    part[0] |= y0 == 0
    part[-1] |= y0 + part.shape[0] - 2 == height
    part[:, 0] |= x0 == 0
    part[:, -1] |= x0 + part.shape[1] - 2 == width
    inside, outside = [], []
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        rows, columns = np.nonzero(part[1:-1, 1:-1] & ~np.roll(part, (-step[0], -step[1]), (0, 1))[1:-1, 1:-1])
        here = np.stack([columns + x0, rows + y0], axis=1).astype(float)
        inside.append(here)
        outside.append(here + (step[1], step[0]))
    inside, outside = np.concatenate(inside), np.concatenate(outside)
    offset = 0.5 * (inside + outside) - (x.mean(), y.mean())
    order = np.lexsort((outside[:, 1], outside[:, 0], np.arctan2(offset[:, 1], offset[:, 0])))
    return inside[order], outside[order]
