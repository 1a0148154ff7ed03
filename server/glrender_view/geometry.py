"""Where Sun, bodies and spacecraft stand, for the sketch on the page, and the states of the free camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from glrender import frames
from glrender.base.constants import AU_M

_MIN_RANGE_RADII, _MAX_RANGE_RADII = 1.3, 1e6


def sketch(state: Mapping[str, Any], camera: Mapping[str, Any], bodies: list[Mapping[str, Any]]) -> dict[str, Any]:
    """Places in the plane of the Sun, the camera and the body that the camera sees largest.

    The plane's first axis points from that body towards the Sun, the second towards the camera's side.

    Parameters
    ----------
    state : mapping
        Of the request.
    camera, bodies
        As `hello` describes them.

    Returns
    -------
    dict
        `body`, its name; `radius_m`; `range_m` from its origin to the camera; `sun_distance_au`; `phase_deg`,
        `off_boresight_deg` of the body; `fov_deg`, of the image's width; `camera` and `boresight`, (2,) in the plane;
        `out_of_plane_deg` of the boresight; `r_camera_m` (3,) and `plane` (2, 3), inertial, for a trail; `others`.
    """
    q_spacecraft = state["spacecraft"].get("q_from_inertial", (1.0, 0.0, 0.0, 0.0))
    spacecraft_from_inertial = frames.dcm(np.asarray(q_spacecraft, float) / np.linalg.norm(q_spacecraft))
    r_camera = np.asarray(state["spacecraft"]["r_inertial_m"], float) + spacecraft_from_inertial.T @ np.asarray(
        camera["r_camera_spacecraft_m"], float)
    boresight = spacecraft_from_inertial.T @ frames.dcm(camera["q_camera_from_spacecraft"]).T[:, 2]
    places = {name: np.asarray(pose["r_inertial_m"], float) for name, pose in state["bodies"].items()}
    radii = {body["name"]: body["radius_m"] for body in bodies}
    seen = max(places, key=lambda name: radii.get(name, 0.0) / max(np.linalg.norm(places[name] - r_camera), 1e-3))
    r_body = places[seen]
    to_camera, to_sun = r_camera - r_body, np.asarray(state["r_sun_inertial_m"], float) - r_body
    range_m, sun_m = float(np.linalg.norm(to_camera)), float(np.linalg.norm(to_sun))
    sunward = to_sun / max(sun_m, 1e-3)
    aside = to_camera - (to_camera @ sunward) * sunward
    if np.linalg.norm(aside) < 1e-9 * range_m:
        aside = np.cross(sunward, np.eye(3)[np.argmin(np.abs(sunward))])
    plane = np.stack([sunward, aside / np.linalg.norm(aside)])
    return {
        "body": seen, "radius_m": radii.get(seen, 0.0), "range_m": range_m, "sun_distance_au": sun_m / AU_M,
        "phase_deg": _angle_deg(sunward, to_camera), "off_boresight_deg": _angle_deg(boresight, -to_camera),
        "fov_deg": float(np.degrees(2.0 * np.arctan2(0.5 * camera["width_px"], camera["focal_length_px"]))),
        "camera": (plane @ to_camera).tolist(), "boresight": (plane @ boresight).tolist(),
        "out_of_plane_deg": float(np.degrees(np.arcsin(np.clip(np.cross(*plane) @ boresight, -1.0, 1.0)))),
        "r_camera_m": to_camera.tolist(), "plane": plane.tolist(),
        "others": [{"name": name, "radius_m": radii.get(name, 0.0), "place": (plane @ (place - r_body)).tolist()}
                   for name, place in places.items() if name != seen]}


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def default_state(bodies: list[Mapping[str, Any]]) -> dict[str, Any]:
    """The first body at the origin, 1 au from the Sun, the others in a row next to it: before any client has asked."""
    poses, offset = {}, 0.0
    for body in bodies:
        offset += 1.5 * body["radius_m"] if poses else 0.0
        poses[body["name"]] = {"r_inertial_m": [offset, 0.0, 0.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}
        offset += 1.5 * body["radius_m"]
    return {"t_s": 0.0, "r_sun_inertial_m": [0.87 * AU_M, -0.5 * AU_M, 0.0], "bodies": poses,
            "spacecraft": {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}}


def free_state(state: Mapping[str, Any], camera: Mapping[str, Any], body: Mapping[str, Any], azimuth_deg: float,
               elevation_deg: float, range_m: float) -> dict[str, Any]:
    """The state with the camera moved by hand: it looks at a body's origin, inertial +Z up.

    Parameters
    ----------
    state : mapping
        Sun and bodies stay.
    camera, body
        As `hello` describes them.
    azimuth_deg, elevation_deg : float [deg]
        Of the camera as seen from the body, in inertial axes.
    range_m : float [m]
        From the body's origin; held between 1.3 and a million of its radii.
    """
    azimuth, elevation = np.radians(azimuth_deg), np.radians(np.clip(elevation_deg, -89.9, 89.9))
    radius_m = body["radius_m"]
    away = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    r_body = np.asarray(state["bodies"][body["name"]]["r_inertial_m"], float)
    r_camera = r_body + away * np.clip(range_m, _MIN_RANGE_RADII * radius_m, _MAX_RANGE_RADII * radius_m)
    q_camera = frames.look_at(r_camera, r_body)
    spacecraft_from_inertial = frames.dcm(camera["q_camera_from_spacecraft"]).T @ frames.dcm(q_camera)
    r_spacecraft = r_camera - spacecraft_from_inertial.T @ np.asarray(camera["r_camera_spacecraft_m"], float)
    still = {name: {key: pose[key] for key in ("r_inertial_m", "q_from_inertial") if key in pose}
             for name, pose in state["bodies"].items()}
    return {"t_s": state.get("t_s", 0.0), "r_sun_inertial_m": state["r_sun_inertial_m"], "bodies": still,
            "spacecraft": {"r_inertial_m": r_spacecraft.tolist(),
                           "q_from_inertial": frames.quaternion(spacecraft_from_inertial).tolist()}}
