"""From columns to irradiance: phase function and solid angle over the image, and 1/rho over a pixel."""

from __future__ import annotations

import cv2
import numpy as np
from glrender_camera import PinholeCamera

from ..view.view import BodyView
from .dust import Dust
from .geometry import phase_rad, solid_angle_sr

# Angle between nodes of the map, bilinear between them: the narrowest lobe, 0.1 rad, is then right to 1e-3.
_NODE_RAD = 0.008
_MOST_PX = 64
# Pixels around a nucleus whose mean of 1/rho is not that of their middle: 3e-4 apart at the last.
_POINT_REACH_PX = 11
# Radius below which a nucleus is a point in its coma.
_POINT_PX = 0.5


def is_point(radius_m: float, view: BodyView, camera: PinholeCamera) -> bool:
    """Whether a nucleus covers little of the pixel whose middle may see it: the light's sum is then put right."""
    return radius_m < _POINT_PX * view.range_m / camera.focal_length_px


def add_light(irradiance: np.ndarray, column: np.ndarray, hidden: np.ndarray, camera: PinholeCamera, view: BodyView,
              dust: Dust, box: tuple[int, int, int, int], solar_irradiance_W_m2: float) -> None:
    """Add a coma's light to an image, in place, and dim surfaces behind it.

    Parameters
    ----------
    irradiance : (rows, columns) float32 [W/m2]
        Irradiance of a box x0, y0, x1, y1 [px] of the image.
    column, hidden : (rows, columns) float32 [1]
        Columns of sunlit dust, and of all dust.
    camera, view, dust, box
    solar_irradiance_W_m2 : float [W/m2]
        At the body.
    """
    if dust.extinction_efficiency > 0.0:
        irradiance *= dust.transmission(hidden)
        # Dust that hides itself shines by its sunlit share.
        column = column * (dust.thin(hidden) / np.maximum(hidden, np.float32(1e-30)))
    light = light_per_column(camera, view, dust, box, solar_irradiance_W_m2)
    cv2.accumulateProduct(column, light, irradiance)


def light_per_column(camera: PinholeCamera, view: BodyView, dust: Dust,
                     box: tuple[int, int, int, int], solar_irradiance_W_m2: float) -> np.ndarray:
    """Irradiance of a column of 1: (rows, columns) float32 [W/m2] of a box x0, y0, x1, y1 of the image.

    All dust along a ray has the same phase angle, that between the ray and the Sun.
    """
    x0, y0, x1, y1 = box
    step = int(min(max(_NODE_RAD * camera.focal_length_px, 1.0), _MOST_PX))
    pixel = cell_middles((x1 - x0, y1 - y0), step) + (x0, y0)
    light = dust.radiance_per_column(phase_rad(camera, view, pixel)) * solid_angle_sr(camera, pixel)
    return spread(light * solar_irradiance_W_m2, (x1 - x0, y1 - y0), step)


def cell_middles(size: tuple[int, int], step: int) -> np.ndarray:
    """Places (down, across, 2) [px] of the middles of cells of `step` pixels, one more cell on each side."""
    x, y = (step * (np.arange(-(-side // step) + 2) - 0.5) - 0.5 for side in size)
    return np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)


def spread(values: np.ndarray, size: tuple[int, int], step: int) -> np.ndarray:
    """Values (down, across) at `cell_middles` to pixels (height, width) float32, bilinear between them."""
    down, across = values.shape
    fine = cv2.resize(values.astype(np.float32), (across * step, down * step), interpolation=cv2.INTER_LINEAR)
    return fine[step:step + size[1], step:step + size[0]]


def point_correction(column: np.ndarray, camera: PinholeCamera, view: BodyView, least_m: float, radius_m: float,
                     box: tuple[int, int, int, int]) -> None:
    """Around a nucleus below a pixel, give each pixel the mean of 1/rho over it, in place.

    A pixel's middle sees 1/rho, which its area does not: 4 % too little one pixel away, without bound at 0. The
    nucleus itself hides the coma behind it, and holds none: of pi K / rho, within its radius R only
    K asin(rho / R) / rho is seen, 2 pi K R (pi / 2 + 1) less in sum.
    """
    focus = -view.camera_from_body @ view.r_camera_body_m
    if not focus[2] > 0.0:
        return
    place = focus[:2] / focus[2] * camera.focal_length_px + np.array(camera.principal_point_px)
    px_m = focus[2] / camera.focal_length_px
    left, top = (max(int(np.floor(place[k])) - _POINT_REACH_PX, box[k]) for k in range(2))
    right, bottom = (min(int(np.floor(place[k])) + _POINT_REACH_PX + 2, box[k + 2]) for k in range(2))
    if left >= right or top >= bottom:
        return
    x, y = np.arange(left, right) - place[0], (np.arange(top, bottom) - place[1])[:, None]
    part = column[top - box[1]:bottom - box[1], left - box[0]:right - box[0]]
    # The grid's sum over theta, pi K, is the column times a.
    sums = part * np.maximum(np.hypot(x, y), least_m / px_m)
    made = sums * mean_inverse_distance(x, y)
    hidden = (np.abs(x) <= 0.5) & (np.abs(y) <= 0.5)
    made -= hidden * sums * (2.0 + np.pi) * radius_m / px_m
    part[:] = np.maximum(made, 0.0)


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
