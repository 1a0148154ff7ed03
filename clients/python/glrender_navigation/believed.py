"""The believed scene's frame beside the camera's: drawn where the body is believed to be, and roughly aligned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from .body import BelievedBody
from .camera import Camera, Sight, StateLike, moved, sight
from .measurement import NotFound, brightness_center_px, lit_pixels

# Pixels round the body's bounding sphere that are drawn too.
_MARGIN_PX = 8
# Share of the brightest pixels below which a frame is dark for a rough alignment: noise and dim ground do not count.
_ROUGH_LEVEL = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A region of a believed frame.

    Attributes
    ----------
    pixels : (h, w) float32 [W/m2]
        Irradiance, spread by the camera's point spread function.
    products : dict of str to array (h, w, ...)
    corner_px : (2,) int [px]
        Place of its pixel (0, 0) in the whole frame.
    here : Sight
        Where the body was drawn.
    """

    pixels: np.ndarray
    products: dict[str, np.ndarray]
    corner_px: np.ndarray
    here: Sight


def draw(render: Callable[..., Any], state: StateLike, camera: Camera, body: BelievedBody,
         products: Sequence[str] = ()) -> Drawn:
    """The region about a body in the believed frame.

    Raises
    ------
    NotFound
        The believed body is behind the camera or out of the image.
    """
    here = sight(state, camera, body.name)
    depth_m = here.r_body_camera_m[2]
    if not depth_m > body.bounding_radius_m:
        raise NotFound("the believed body is not before the camera")
    reach_px = camera.focal_length_px * body.bounding_radius_m / (depth_m - body.bounding_radius_m) + _MARGIN_PX
    center_px = camera.project(here.r_body_camera_m)
    low = np.maximum(np.floor(center_px - reach_px), 0.0).astype(int)
    high = np.minimum(np.ceil(center_px + reach_px) + 1.0, (camera.width_px, camera.height_px)).astype(int)
    if not (high - low > 2 * _MARGIN_PX).all():
        raise NotFound("the believed body is out of the image")
    reply = render(state, products=list(products), roi=[int(low[0]), int(low[1]), int(high[0]), int(high[1])])
    return Drawn(pixels=blurred(reply.pixels, camera.psf_sigma_px), corner_px=low, here=here,
                 products={name: reply.arrays[name] for name in products})


def blurred(pixels: np.ndarray, sigma_px: float) -> np.ndarray:
    """An image after a Gaussian point spread function, float32."""
    pixels = np.ascontiguousarray(pixels, np.float32)
    return pixels if not sigma_px > 0.0 else cv2.GaussianBlur(pixels, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)


def roughly_aligned(frame: np.ndarray, drawn: Drawn, camera: Camera) -> np.ndarray:
    """The body's place (3,) [m] in `camera` by centre of brightness and lit pixels of frame and believed frame."""
    found, expected = _rough(frame), _rough(drawn.pixels)
    shift_px = brightness_center_px(found) - brightness_center_px(expected) - drawn.corner_px
    scale = np.sqrt(np.count_nonzero(found) / np.count_nonzero(expected))
    return placed(camera, camera.project(drawn.here.r_body_camera_m) + shift_px, drawn.here.range_m / scale)


def placed(camera: Camera, center_px: np.ndarray, range_m: float) -> np.ndarray:
    """Place (3,) [m] of what is seen at a pixel from a distance."""
    return range_m * camera.direction(center_px)


def shift_between(camera: Camera, before_m: np.ndarray, after_m: np.ndarray) -> tuple[float, float]:
    """How far [px] and by which factor of its size a body moves between two places in `camera`."""
    shift_px = float(np.linalg.norm(camera.project(after_m) - camera.project(before_m)))
    return shift_px, float(abs(np.log(np.linalg.norm(before_m) / np.linalg.norm(after_m))))


class Refined:
    """A body's place, improved step by step against frames drawn where it is believed to be.

    The first step is rough; then each draws anew, until a step is below `enough_px` at the centre and at the limb.
    """

    def __init__(self, frame: np.ndarray, believed: StateLike, camera: Camera, body: BelievedBody,
                 render: Callable[..., Any], *, products: Sequence[str] = (), enough_px: float = 0.5, most: int = 4):
        self._frame, self._state, self._camera, self._body = frame, believed, camera, body
        self._render, self._products, self._enough_px, self._most = render, products, enough_px, most

    def __call__(self, step: Callable[[Drawn, int], tuple[np.ndarray, Any]]) -> tuple[np.ndarray, Any]:
        """The place (3,) [m] and what `step(drawn, number)` says of it: (place, anything)."""
        drawn = self._draw(sight(self._state, self._camera, self._body.name).r_body_camera_m)
        rough_m = roughly_aligned(self._frame, drawn, self._camera)
        if self._size_px(drawn, rough_m) > 2.0:
            drawn = self._draw(rough_m)
        for number in range(self._most):
            place_m, told = step(drawn, number)
            if not np.isfinite(place_m).all() or not place_m[2] > 0.0:
                raise NotFound("the solution went astray")
            if self._size_px(drawn, place_m) < self._enough_px:
                return place_m, told
            if number + 1 < self._most:
                drawn = self._draw(place_m)
        return place_m, told

    def _draw(self, place_m: np.ndarray) -> Drawn:
        return draw(self._render, moved(self._state, self._camera, self._body.name, place_m), self._camera, self._body,
                    self._products)

    def _size_px(self, drawn: Drawn, place_m: np.ndarray) -> float:
        shift_px, scale = shift_between(self._camera, drawn.here.r_body_camera_m, place_m)
        return shift_px + scale * self._camera.focal_length_px * self._body.mean_radius_m / drawn.here.range_m


def _rough(pixels: np.ndarray) -> np.ndarray:
    lit = lit_pixels(pixels)
    lit[lit < _ROUGH_LEVEL * np.quantile(lit[lit > 0.0], 0.99)] = 0.0
    return lit
