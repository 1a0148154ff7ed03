"""What the shadows of other bodies leave of a body's light. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from . import frames
from .hull import Hull
from .view import BodyView

# Ways that an outline is told by, the Sun's plane to (2,), and places across a body's.
_WAYS = np.array([np.cos(np.arange(32) * np.pi / 16), np.sin(np.arange(32) * np.pi / 16)])
_ACROSS = (np.arange(25) + 0.5) / 12.5 - 1.0


def light_left(receiver: BodyView, hull: Hull, casters: Sequence[tuple[Hull, np.ndarray]],
               sun_radius_rad: float) -> float:
    """Share of a body's light, as the camera sees it, that the shadows of other bodies leave.

    All are as wide as their convex hulls, so that it is rather too little; the receiver is as bright as a sphere by
    Lambert's law whose outline is stretched to its own. Where the umbra does not reach it is half too little.

    Parameters
    ----------
    receiver : BodyView
    hull : Hull
        Its own.
    casters : sequence of (Hull, (4, 4) array)
        Of each, and receiver_from_caster [m].
    sun_radius_rad : float [rad]
        Angular radius of the Sun; 0 for one without a disc.
    """
    sun = receiver.sun_direction_body
    plane = frames.sun_from_body(sun)[:2]
    outline_m = plane @ hull.points_m
    centre_m = 0.5 * (outline_m.min(axis=1) + outline_m.max(axis=1))
    extent_m = (_WAYS.T @ (outline_m - centre_m[:, None])).max(axis=1)
    places_m = np.stack([axis.ravel() for axis in np.meshgrid(_ACROSS, _ACROSS)]) * extent_m.max()
    radius = (_WAYS.T @ places_m / extent_m[:, None]).max(axis=0)
    places_m, radius = places_m[:, radius < 1.0], radius[radius < 1.0]
    to_camera = receiver.r_camera_body_m / receiver.range_m
    aside = places_m / np.maximum(np.linalg.norm(places_m, axis=0), 1e-300)
    bright = radius * (plane @ to_camera @ aside) + np.sqrt(1.0 - radius**2) * float(sun @ to_camera)
    # Of a crescent between the places the disc tells.
    bright = np.maximum(bright, 0.0) + 1e-6
    sunlit = np.ones_like(radius)
    for caster, receiver_from_caster in casters:
        gap_m = float(receiver_from_caster[:3, 3] @ sun)
        if gap_m <= 0.0:
            continue
        rotation, offset_m = receiver_from_caster[:3, :3], receiver_from_caster[:3, 3]
        edge_m = (_WAYS.T @ (plane @ (rotation @ caster.points_m + offset_m[:, None]) - centre_m[:, None])).max(axis=1)
        outside_m = (_WAYS.T @ places_m - edge_m[:, None]).max(axis=0)
        half_m = max(sun_radius_rad * gap_m, 1e-9 * hull.radius_m)
        sunlit = np.minimum(sunlit, np.clip(0.5 + 0.5 * outside_m / half_m, 0.0, 1.0))
    return float((bright * sunlit).sum() / bright.sum())
