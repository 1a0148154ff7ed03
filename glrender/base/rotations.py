"""Every rotation and projection convention of glrender, in one place.

* `q_b_from_a` is [w, x, y, z] and takes components in frame a to components in frame b.
* `camera`: +Z boresight, +X right, +Y down; `pixel`: (0, 0) is the centre of the top-left pixel.
* GL's eye frame looks along -Z with +Y up. The image is drawn with its top row in window
  row 0, so that a readback needs no flip; counter-clockwise facets then wind clockwise.

Rotations of states are scipy's, scalar first. pyrr serves here alone, and for projection
matrices alone, in float64; it writes them for row vectors, hence the transposes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pyrr import matrix44
from scipy.spatial.transform import Rotation

from .errors import ConfigError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

GOLDEN_ANGLE_RAD = np.pi * (3.0 - np.sqrt(5.0))

EYE_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
"""The one function that turns camera axes into GL's."""


def dcm(q_b_from_a: np.ndarray) -> np.ndarray:
    """Direction-cosine matrix `b_from_a`, (3, 3) float64, of a unit quaternion (4,) [w, x, y, z].

    (cos 45, 0, 0, sin 45) takes x to y. Of some (N, 4) all (N, 3, 3) at once, which takes as long as one.
    """
    return Rotation.from_quat(q_b_from_a, scalar_first=True).as_matrix()


def quaternion(b_from_a: np.ndarray) -> np.ndarray:
    """(4,) float64 unit quaternion [w, x, y, z], w >= 0, of a direction-cosine matrix."""
    return Rotation.from_matrix(b_from_a).as_quat(canonical=True, scalar_first=True)


def look_at(r_from_m: ArrayLike, r_to_m: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Attitude of a camera that looks from one point to another, image up along `up`.

    Parameters
    ----------
    r_from_m, r_to_m : (3,) float [m]
        In one frame f.
    up : (3,) float
        Direction in f whose projection points up in the image (towards -Y of `camera`).

    Returns
    -------
    (4,) float64
        `q_camera_from_f`, [w, x, y, z].

    Raises
    ------
    ConfigError
        Where the two points are one.
    """
    boresight = np.asarray(r_to_m, float) - np.asarray(r_from_m, float)
    distance_m = np.linalg.norm(boresight)
    if not distance_m > 0.0:
        raise ConfigError("r_to_m", "must be another point than r_from_m", r_to_m, "there is no direction to look in")
    boresight = boresight / distance_m
    right = np.cross(boresight, np.asarray(up, float))
    if np.linalg.norm(right) < 1e-9:
        right = np.cross(boresight, np.eye(3)[np.argmin(np.abs(boresight))])
    right = right / np.linalg.norm(right)
    return quaternion(np.stack([right, np.cross(boresight, right), boresight]))


def clip_from_camera(focal_length_px: float, principal_point_px: tuple[float, float],
                     bounds_px: tuple[float, float, float, float], near: float, far: float) -> np.ndarray:
    """Off-axis projection of a window of the image.

    Parameters
    ----------
    focal_length_px : float [px]
    principal_point_px : (2,) float [px]
    bounds_px : (4,) float [px]
        x0, y0, x1, y1 of the window's edges; pixel k reaches from k - 1/2 to k + 1/2.
    near, far : float [length], 0 < near < far
        Along the boresight.

    Returns
    -------
    (4, 4) float64
        Column-vector convention; the image's top row lands in window row 0.
    """
    x0, y0, x1, y1 = bounds_px
    cx, cy = principal_point_px
    scale = near / focal_length_px
    left, right = (x0 - cx) * scale, (x1 - cx) * scale
    top, bottom = -(y0 - cy) * scale, -(y1 - cy) * scale
    # `bottom` and `top` change places: this is the flip that puts row 0 on top.
    projection = matrix44.create_perspective_projection_from_bounds(
        left, right, top, bottom, near, far, dtype=np.float64).T
    return projection @ _homogeneous(EYE_FROM_CAMERA)


def depth_slice(index: int, count: int) -> np.ndarray:
    """(4, 4) that moves clip depths into slice `index` of `count`; slice 0 is the farthest."""
    matrix = np.eye(4)
    matrix[2, 2] = 1.0 / count
    matrix[2, 3] = 1.0 - (2 * index + 1) / count
    return matrix


def clip_from_sun(half_width: float, half_height: float, near: float, far: float) -> np.ndarray:
    """(4, 4) float64 orthographic projection of frame `sun` (+Z towards the Sun).

    `near` and `far` are depths below the plane z = 0 [length], near < far.
    """
    return matrix44.create_orthogonal_projection(
        -half_width, half_width, -half_height, half_height, near, far, dtype=np.float64).T


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles (...) [rad] between unit vectors (..., 3): exact also where they are small, or nearly pi."""
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def evenly_spread(index: int | np.ndarray, count: int) -> np.ndarray:
    """One direction (3,), or some (N, 3), of `count` that are evenly spread: a Fibonacci sphere."""
    z = 1.0 - (2.0 * index + 1.0) / count
    return np.stack([np.sqrt(1.0 - z * z) * np.cos(GOLDEN_ANGLE_RAD * index),
                     np.sqrt(1.0 - z * z) * np.sin(GOLDEN_ANGLE_RAD * index), z], axis=-1)


def sun_from_body(sun_direction_body: np.ndarray) -> np.ndarray:
    """(3, 3) float64 rotation into frame `sun`: +Z towards the Sun, X and Y any."""
    z = np.asarray(sun_direction_body, float)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def transform(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(4, 4) float64 matrix of `rotation @ v + translation`."""
    matrix = _homogeneous(rotation)
    matrix[:3, 3] = translation
    return matrix


def _homogeneous(rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix
