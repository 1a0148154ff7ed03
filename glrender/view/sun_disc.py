"""The Sun's disc as a few points, each with hard edges of shadows: their mean has penumbras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..base.rotations import GOLDEN_ANGLE_RAD, sun_from_body
from .view import BodyView


def on_disc(n_points: int) -> np.ndarray:
    """Points (K, 2) of a disc of radius 1: Vogel's spiral (1979), about its own middle."""
    k = np.arange(n_points)
    turn = k * GOLDEN_ANGLE_RAD
    points = np.sqrt((k + 0.5) / n_points) * np.array([np.cos(turn), np.sin(turn)])
    return (points - points.mean(axis=1, keepdims=True)).T


def lit_from(views: list[BodyView], point: np.ndarray) -> list[BodyView]:
    """Views that are lit from a point (2,) of the Sun's disc of radius 1."""
    across = sun_from_body(views[0].camera_from_body @ views[0].sun_direction_body)[:2].T @ point
    lit = []
    for view in views:
        towards = view.sun_direction_body + view.camera_from_body.T @ across * view.sun_radius_rad
        lit.append(replace(view, sun_direction_body=towards / np.linalg.norm(towards)))
    return lit
