"""Labels of a frame: poses in the camera's frame, boxes, centres, limbs, and keypoints that are seen or hidden."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ..base.constants import AU_M
from ..base.errors import ConfigError
from ..base.rotations import quaternion
from ..engines.rays.laser_ranges import laser_ranges
from ..scene.scene import Scene
from ..view.state import State
from ..view.view import view_bodies
from .far_bodies import point_label, small_boxes
from .limb import limb_points

PRODUCTS = ("body_id",)
"""Products that labels are made of."""
# A keypoint is seen where the ray to it meets nothing farther before it than this share of the body's radius. On a
# sphere that separates points 0.1 degrees beyond the horizon from those before it.
_SEEN_WITHIN = 2e-3

Keypoints = Mapping[str, Mapping[str, Sequence[float] | np.ndarray]]
"""Names and places [m] in the frame of the body, by the body's name."""


def frame_labels(scene: Scene, state: State, camera: PinholeCamera, image: np.ndarray,
                 products: Mapping[str, np.ndarray], keypoints: Keypoints | None = None,
                 n_limb_points: int = 0, irradiance_W_m2: np.ndarray | None = None) -> dict[str, Any]:
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
    n_limb_points : int, 0..1000
        Points of each body's outline, as of `limb_points`.
    irradiance_W_m2 : (height, width) float32, optional
        Of the bodies, where the image has digital numbers: for the centres of bodies below 3 px. The image by default.

    Returns
    -------
    dict
        `sun_direction_camera`, and `bodies` by name: `r_camera_m`, `q_camera_from_body`, `range_m`, `phase_deg`,
        `origin_px` (of the body's frame; None behind the camera), `n_px` (pixels whose centre sees it), `box_px`
        (x0, y0, x1, y1, one past the last; None if it is not seen), `centre_of_figure_px`, `centre_of_brightness_px`
        (weighted by `image` above its median on the sky; of a body below 3 px by the irradiance in the pixels
        that it touches), `light_box_px` (of a body below 3 px: the pixels with its light, as of `point_label`; else
        None), `keypoints`: place, and whether it is in view and seen, by a ray; `limb` where its points are asked
        for. Pixels are as of docs/conventions.md: (0, 0) is the centre of the top-left one.

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
    small = small_boxes(views)
    for number, (body, view) in enumerate(zip(scene.bodies, views, strict=True)):
        r = -view.camera_from_body @ (view.r_camera_body_m + view.centre_m)
        places = (keypoints or {}).get(view.name, {})
        bodies[view.name] = {
            "r_camera_m": r.tolist(), "q_camera_from_body": quaternion(view.camera_from_body).tolist(),
            "range_m": float(np.linalg.norm(r)), "phase_deg": float(np.degrees(view.phase_rad)),
            "origin_px": camera.project(r).tolist() if r[2] > 0.0 else None,
            **_silhouette(products["body_id"] == number, light), "light_box_px": None,
            **(point_label(number, small, products["body_id"], image,
                           image if irradiance_W_m2 is None else irradiance_W_m2) if number in small else {}),
            "keypoints": _keypoints(scene, state, camera, places, r + np.array(
                list(places.values()), float).reshape(-1, 3) @ view.camera_from_body.T,
                _SEEN_WITHIN * body.hull.radius_m)}
        if n_limb_points:
            bodies[view.name]["limb"] = limb_points(scene, state, camera, products["body_id"], number, n_limb_points)
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


def _keypoints(scene: Scene, state: State, camera: PinholeCamera, names: Iterable[str], r_camera_m: np.ndarray,
               within_m: float) -> dict[str, Any]:
    """Labels of points (K, 3) [m] in `camera`, by their names."""
    found: dict[str, Any] = {}
    if not len(r_camera_m):
        return found
    place = camera.project(r_camera_m)
    distance = np.linalg.norm(r_camera_m, axis=1)
    sides = np.array([camera.width_px, camera.height_px])
    is_in: np.ndarray = np.all((place > -0.5) & (place < sides - 0.5), axis=1)
    is_free = is_in.copy()
    if is_in.any():
        met = laser_ranges(scene, state, r_camera_m[is_in] / distance[is_in, None], camera.name).range_m
        is_free[is_in] = ~(met < distance[is_in] - within_m)
    for k, name in enumerate(names):
        found[name] = {"px": place[k].tolist() if np.isfinite(place[k]).all() else None,
                       "is_in_view": bool(is_in[k]), "is_seen": bool(is_free[k])}
    return found
