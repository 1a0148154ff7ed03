"""Labels of a frame: poses in the camera's frame, boxes, centres, and keypoints that are seen or hidden."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ..base.constants import AU_M
from ..base.errors import ConfigError
from ..base.rotations import quaternion
from ..scene.scene import Scene
from ..view.state import State
from ..view.view import view_bodies

PRODUCTS = ("range", "body_id")
"""Products that labels are made of."""
# A keypoint is seen where the surface is as far as it is, within the width of some pixels there.
_SEEN_WITHIN_PX = 3.0

Keypoints = Mapping[str, Mapping[str, tuple[float, float, float]]]
"""Names and places [m] in the frame of the body, by the body's name."""


def frame_labels(scene: Scene, state: State, camera: PinholeCamera, image: np.ndarray,
                 products: Mapping[str, np.ndarray], keypoints: Keypoints | None = None) -> dict[str, Any]:
    """Labels of one frame, as plain data.

    Parameters
    ----------
    scene : Scene
    state : State
    camera : PinholeCamera
    image : (height, width) array
        Irradiance or digital numbers.
    products : mapping
        With those of `PRODUCTS`.
    keypoints : mapping, optional

    Returns
    -------
    dict
        `sun_direction_camera`, and `bodies` by name: `r_camera_m`, `q_camera_from_body`, `range_m`, `phase_deg`,
        `origin_px` (of the body's frame; None behind the camera), `n_px` (pixels whose centre sees it), `box_px`
        (x0, y0, x1, y1, one past the last; None if it is not seen), `centre_of_figure_px`, `centre_of_brightness_px`
        (weighted by `image` above its median beside all bodies), `keypoints`: place, and whether it is in view
        and seen. Pixels are as of docs/conventions.md: (0, 0) is the centre of the top-left one.

    Raises
    ------
    ConfigError
        Keypoints of a body that the scene does not have.
    """
    for name in keypoints or {}:
        if name not in state.bodies:
            raise ConfigError(f"keypoints.{name}", "is no body of the scene", hint=f"bodies: {', '.join(state.bodies)}")
    beside = image[products["body_id"] < 0]
    light = image.astype(np.float64) - (np.median(beside) if beside.size else 0.0)
    bodies = {}
    views = view_bodies(state, camera, {body.name: body.hull for body in scene.bodies})
    for number, view in enumerate(views):
        r = -view.camera_from_body @ (view.r_camera_body_m + view.centre_m)
        bodies[view.name] = {
            "r_camera_m": r.tolist(), "q_camera_from_body": quaternion(view.camera_from_body).tolist(),
            "range_m": float(np.linalg.norm(r)), "phase_deg": float(np.degrees(view.phase_rad)),
            "origin_px": camera.project(r).tolist() if r[2] > 0.0 else None,
            **_silhouette(products["body_id"] == number, light),
            "keypoints": {
                name: _keypoint(camera, r + view.camera_from_body @ np.asarray(place, float), products["range"])
                for name, place in (keypoints or {}).get(view.name, {}).items()}}
    to_sun = views[0].sun_direction_body * views[0].sun_distance_au * AU_M - views[0].r_camera_body_m
    sun = views[0].camera_from_body @ (to_sun / np.linalg.norm(to_sun))
    return {"sun_direction_camera": sun.tolist(), "bodies": bodies}


def _silhouette(mask: np.ndarray, light: np.ndarray) -> dict[str, Any]:
    """Box and centres [px] of the pixels that see a body."""
    y, x = np.nonzero(mask)
    if not x.size:
        return {"n_px": 0, "box_px": None, "centre_of_figure_px": None, "centre_of_brightness_px": None}
    weight = np.maximum(light[y, x], 0.0)
    total = weight.sum()
    return {"n_px": int(x.size), "box_px": [int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1],
            "centre_of_figure_px": [float(x.mean()), float(y.mean())],
            "centre_of_brightness_px": [float(weight @ x / total), float(weight @ y / total)] if total > 0.0 else None}


def _keypoint(camera: PinholeCamera, r_camera_m: np.ndarray, range_m: np.ndarray) -> dict[str, Any]:
    if not r_camera_m[2] > 0.0:
        return {"px": None, "is_in_view": False, "is_seen": False}
    place = camera.project(r_camera_m)
    column, row = (int(np.rint(coordinate)) for coordinate in np.clip(place, -1e6, 1e6))
    if not (0 <= column < camera.width_px and 0 <= row < camera.height_px):
        return {"px": place.tolist(), "is_in_view": False, "is_seen": False}
    distance = float(np.linalg.norm(r_camera_m))
    within = _SEEN_WITHIN_PX * distance / camera.focal_length_px
    near = range_m[max(0, row - 1):row + 2, max(0, column - 1):column + 2]
    return {"px": place.tolist(), "is_in_view": True, "is_seen": bool((np.abs(near - distance) < within).any())}
