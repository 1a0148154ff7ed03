"""Labels of bodies of a few pixels and less: the centre of their light, and the box of pixels where it is seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..view.view import BodyView

SMALL_PX = 3.0
"""Size [px] below which a body's pixels are those that have its light: their centres see the body by chance."""
# The light of a pixel that a body's edge crosses is in it or in the next.
_BESIDE_PX = 1.0
# In a frame the optics spread it farther.
_SPREAD_PX = 4.0
# Light is seen where it is that much above the noise of the dark sky, in sigma; a digital number's rounding is noise.
_SEEN_SIGMA, _LEAST_DN = 5.0, 0.5
_SIGMA_OF_MEDIAN = 1.4826


def small_boxes(views: Sequence[BodyView]) -> dict[int, np.ndarray]:
    """Boxes (2, 2) [px] (x0, y0; x1, y1) of the bodies that are small and may be in the image, by their numbers."""
    return {number: view.bounds_px.reshape(2, 2) for number, view in enumerate(views)
            if view.is_visible and view.bounds_px is not None and view.size_px < SMALL_PX}


def point_label(number: int, boxes: dict[int, np.ndarray], body_id: np.ndarray, image: np.ndarray,
                irradiance_W_m2: np.ndarray) -> dict[str, Any]:
    """The label of a small body.

    Parameters
    ----------
    number : int
        The body's, in the scene.
    boxes : dict
        Of `small_boxes`.
    body_id : (height, width) int
    image : (height, width) array
        Digital numbers or irradiance.
    irradiance_W_m2 : (height, width) float32
        Irradiance of the bodies, without noise and before the optics.

    Returns
    -------
    dict
        `centre_of_brightness_px`, weighted by the irradiance and inside the body's outline, None of a body without
        light; `light_box_px`: x0, y0, x1, y1, one past the last, of the pixels whose light in the image is above the
        noise, None where there is none. A body behind others has neither.
    """
    x, y = _own(number, boxes, body_id, _BESIDE_PX)
    light = irradiance_W_m2[y, x].astype(np.float64)
    if not light.sum() > 0.0:
        return {"centre_of_brightness_px": None, "light_box_px": None}
    # A pixel has no place inside; the outline bounds it.
    centre = np.clip(np.array([light @ x, light @ y]) / light.sum(), *boxes[number]).tolist()
    x, y = _own(number, boxes, body_id, _SPREAD_PX)
    is_seen = image[y, x] > _least_seen(image, body_id)
    if not is_seen.any():
        return {"centre_of_brightness_px": centre, "light_box_px": None}
    x, y = x[is_seen], y[is_seen]
    return {"centre_of_brightness_px": centre,
            "light_box_px": [int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1]}


def _own(number: int, boxes: dict[int, np.ndarray], body_id: np.ndarray, beside_px: float
         ) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of the pixels about a small body that see no other, and are not nearer another small one."""
    height, width = body_id.shape
    low = np.maximum(np.ceil(boxes[number][0] - beside_px), 0).astype(int)
    high = np.minimum(np.floor(boxes[number][1] + beside_px), (width - 1, height - 1)).astype(int)
    y, x = (axis.ravel() for axis in np.mgrid[low[1]:high[1] + 1, low[0]:high[0] + 1])
    distances = {other: np.hypot(x - box[:, 0].mean(), y - box[:, 1].mean()) for other, box in boxes.items()}
    nearest = np.min(list(distances.values()), axis=0)
    seen = body_id[y, x]
    is_own = ((seen < 0) | (seen == number)) & (distances[number] <= nearest)
    return x[is_own], y[is_own]


def _least_seen(image: np.ndarray, body_id: np.ndarray) -> float:
    """The level above which a pixel has light: the sky's and its noise, or none of irradiance."""
    beside = image[body_id < 0]
    if image.dtype.kind not in "iu" or not beside.size:
        return 0.0
    middle = float(np.median(beside))
    sigma = _SIGMA_OF_MEDIAN * float(np.median(np.abs(beside - middle)))
    return middle + _SEEN_SIGMA * max(sigma, _LEAST_DN)
