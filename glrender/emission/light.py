"""From columns to irradiance: phase function and solid angle over the image, and 1/rho over a pixel."""

from __future__ import annotations

import cv2
import numpy as np
from glrender_camera import PinholeCamera

from ..view import BodyView
from .dust import Dust
from .geometry import phase_rad, solid_angle_sr

# Angle between nodes of the map, bilinear between them: the narrowest lobe, 0.1 rad, is then right to 1e-3.
_NODE_RAD = 0.008
_MOST_PX = 64


def light_per_column(camera: PinholeCamera, view: BodyView, dust: Dust,
                     box: tuple[int, int, int, int], solar_irradiance_W_m2: float) -> np.ndarray:
    """Irradiance of a column of 1: (rows, columns) float32 [W/m2] of a box x0, y0, x1, y1 of the image.

    Of the dust along a ray the phase angle is the same: it lies between the ray and the Sun.
    """
    x0, y0, x1, y1 = box
    step = int(min(max(_NODE_RAD * camera.focal_length_px, 1.0), _MOST_PX))
    across, down = -(-(x1 - x0) // step) + 2, -(-(y1 - y0) // step) + 2
    # cv2 takes nodes for the middles of cells of `step` pixels; one cell more on each side.
    x, y = (first + step * (np.arange(count) - 0.5) - 0.5 for first, count in ((x0, across), (y0, down)))
    pixel = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
    light = dust.radiance_per_column(phase_rad(camera, view, pixel)) * solid_angle_sr(camera, pixel)
    light *= solar_irradiance_W_m2
    fine = cv2.resize(light.astype(np.float32), (across * step, down * step), interpolation=cv2.INTER_LINEAR)
    return fine[step:step + y1 - y0, step:step + x1 - x0]


def point_correction(column: np.ndarray, camera: PinholeCamera, view: BodyView, least_m: float,
                     box: tuple[int, int, int, int], reach_px: int) -> None:
    """Around a nucleus of few pixels, give each pixel the mean of 1/rho over it, in place.

    A pixel's middle sees 1/rho, which its area does not: 4 % too little one pixel away, without bound at 0.
    Columns are of what a grid sums up over 1/a; the grid's sum is smooth and stays.
    """
    focus = -view.camera_from_body @ view.r_camera_body_m
    if not focus[2] > 0.0:
        return
    place = focus[:2] / focus[2] * camera.focal_length_px + np.array(camera.principal_point_px)
    px_m = focus[2] / camera.focal_length_px
    left, top = (max(int(np.floor(place[k])) - reach_px, box[k]) for k in range(2))
    right, bottom = (min(int(np.floor(place[k])) + reach_px + 2, box[k + 2]) for k in range(2))
    if left >= right or top >= bottom:
        return
    x, y = np.arange(left, right) - place[0], (np.arange(top, bottom) - place[1])[:, None]
    least_px = least_m / px_m
    middle = np.maximum(np.hypot(x, y), least_px)
    # Within the body nothing is seen, and a pixel that holds all of it has a mean whatever is in the middle.
    ratio = np.maximum(mean_inverse_distance(x, y) * middle, 0.0) if least_px < 0.5 else np.ones_like(middle)
    part = column[top - box[1]:bottom - box[1], left - box[0]:right - box[0]]
    part *= ratio.astype(np.float32)


def mean_inverse_distance(x_px: np.ndarray, y_px: np.ndarray) -> np.ndarray:
    """Mean of 1/rho over a pixel whose middle is at (x, y) from the origin [1/px].

    Source: the double integral of 1/sqrt(x^2 + y^2) is x asinh(y/|x|) + y asinh(x/|y|); 3.5255 at the origin.
    """
    def corner(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        x, y = np.broadcast_arrays(x, y)
        safe_x, safe_y = (np.maximum(np.abs(t), 1e-300) for t in (x, y))
        return x * np.arcsinh(y / safe_x) + y * np.arcsinh(x / safe_y)

    return (corner(x_px + 0.5, y_px + 0.5) - corner(x_px - 0.5, y_px + 0.5) - corner(x_px + 0.5, y_px - 0.5)
            + corner(x_px - 0.5, y_px - 0.5))
