"""Geometry of a field before a camera, as the shaders want it: worked out in float64, rounded once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ..view.view import BodyView
from .fields import Field, SphericalField

# Radius of a field without an end: its square is still a float32.
_ENDLESS_M = 1e18
# The origin is ahead when its depth is that share of its range: else pixels about its projection mean little.
_AHEAD = 0.05


def shader_values(field: Field, camera: PinholeCamera, view: BodyView, views: Mapping[str, BodyView],
                  field_from_body: np.ndarray, corner_px: tuple[int, int]) -> dict[str, Any]:
    """Members of `gl.coma_pass.coma_block` but those of resolution, shadow and least distances.

    Parameters
    ----------
    field : Field
    camera : PinholeCamera
    view : BodyView
        View of the body whose origin the field is about.
    views : mapping of str to BodyView
        All, in the scene's order.
    field_from_body : (3, 3) float64
    corner_px : (int, int) [px]
        First pixel of the tile.
    """
    focus = -view.camera_from_body @ view.r_camera_body_m
    depth = float(focus[2])
    ahead = is_ahead(focus)
    slope = focus[:2] / depth if ahead else np.zeros(2)
    principal = np.array(camera.principal_point_px) - corner_px
    field_from_camera = np.eye(4)
    field_from_camera[:3, :3] = field_from_body @ view.camera_from_body.T
    others = np.zeros((len(views), 4))
    for index, other in enumerate(views.values()):
        origin = -other.camera_from_body @ other.r_camera_body_m
        others[index, :3] = field_from_camera[:3, :3] @ (origin - focus)
    if isinstance(field, SphericalField):
        radius = min(field.radius_m, _ENDLESS_M)
        bounds = {"low_m": (-radius,) * 3, "high_m": (radius,) * 3, "inner_m": field.inner_m,
                  "shells_per_octave": field.shells_per_octave}
    else:
        bounds = {"low_m": field.low_m, "high_m": field.high_m, "inner_m": 0.0, "shells_per_octave": 0.0}
    return {**bounds, "field_from_camera": field_from_camera, "focus_px": principal + slope * camera.focal_length_px,
            "focus_slope": slope, "principal_point_px": principal, "r_focus_camera": focus, "focus_depth_m": depth,
            "focal_length_px": camera.focal_length_px, "is_ahead": int(ahead),
            "r_body_m": others}


def is_ahead(r_focus_camera_m: np.ndarray) -> bool:
    """Whether a point (3,) [m] is so far ahead of the camera that its pixel means something."""
    return bool(r_focus_camera_m[2] > _AHEAD * np.linalg.norm(r_focus_camera_m))


def passing_m(camera: PinholeCamera, view: BodyView, pixel: np.ndarray) -> np.ndarray:
    """Distances (...) float64 [m] at which the rays of places (..., 2) [px] pass a body's origin."""
    focus = -view.camera_from_body @ view.r_camera_body_m
    return np.linalg.norm(np.cross(camera.directions(pixel), focus), axis=-1)


def phase_rad(camera: PinholeCamera, view: BodyView, pixel: np.ndarray) -> np.ndarray:
    """Phase angles (...) [rad] at places (..., 2) [px]: of dust along a ray it is the same everywhere."""
    to_camera = -camera.directions(pixel)
    sun = view.camera_from_body @ view.sun_direction_body
    return 2.0 * np.arctan2(np.linalg.norm(sun - to_camera, axis=-1), np.linalg.norm(sun + to_camera, axis=-1))


def solid_angle_sr(camera: PinholeCamera, pixel: np.ndarray) -> np.ndarray:
    """Solid angles (...) [sr] of pixels at places (..., 2) [px]: cos^3 of the angle off the boresight over f^2."""
    return camera.directions(pixel)[..., 2] ** 3 / camera.focal_length_px**2
