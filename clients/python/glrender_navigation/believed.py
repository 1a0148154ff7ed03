"""The believed scene's frame, to compare with the camera's: drawn where the body should be, and roughly aligned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from .body import BelievedBody
from .camera import Camera, Sight, StateLike, moved, others_px, sight
from .measurement import NotFound, is_anothers, lit_pixels

# Pixels round the body's bounding sphere that are drawn too.
_MARGIN_PX = 8
NEXT_PX = 8
"""How far from another body's believed image its light, and what it hides, may be [px]."""
# Ground is another body's where its place on the body is so far from the place that is seen; of the mean radius.
_OTHER_GROUND = 0.01
# A rough alignment is of images of so many pixels, in these sizes; and what each radius of shift must gain.
_ROUGH_PX, _ROUGH_SIZES = 48, (1.0, 0.8, 1.25)
_NEARER = 0.02
_LEAST_ROUGH = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A region of a believed frame.

    Attributes
    ----------
    pixels : (h, w) float32 [W/m2]
        Irradiance, spread by the camera's point spread function.
    products : dict of str to array (h, w, ...)
    is_clear : (h, w) bool
        Pixels that neither another body nor its surroundings have.
    corner_px : (2,) int [px]
        Place of its pixel (0, 0) in the whole frame.
    here : Sight
        Where the body was drawn.
    """

    pixels: np.ndarray
    products: dict[str, np.ndarray]
    is_clear: np.ndarray
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
    others = others_px(state, camera, body.name)
    products = sorted({*products, *(("range", "r_body") if others else ())})
    reply = render(state, products=products, roi=[int(low[0]), int(low[1]), int(high[0]), int(high[1])])
    arrays = {name: reply.arrays[name] for name in products}
    is_other = is_anothers_ground(arrays, low, camera, here, body) if others else np.zeros(reply.pixels.shape, bool)
    return Drawn(pixels=blurred(reply.pixels, camera.psf_sigma_px), corner_px=low, here=here, products=arrays,
                 is_clear=~grown(is_other, NEXT_PX))


def is_anothers_ground(products: dict[str, np.ndarray], corner_px: np.ndarray, camera: Camera, here: Sight,
                       body: BelievedBody) -> np.ndarray:
    """Which pixels (h, w) of a region show ground of another body, by its products `range` and `r_body`."""
    height, width = products["range"].shape
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1) + corner_px
    seen_m = camera.direction(pixels) * products["range"][..., None]
    ours_m = products["r_body"] @ here.camera_from_body.T + here.r_body_camera_m
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(seen_m - ours_m, axis=-1) > _OTHER_GROUND * body.mean_radius_m


def grown(mask: np.ndarray, reach_px: int) -> np.ndarray:
    """A mask (h, w) with all pixels within a reach of the given ones."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * reach_px + 1,) * 2, np.uint8), borderValue=0) > 0


def blurred(pixels: np.ndarray, sigma_px: float) -> np.ndarray:
    """An image after a Gaussian point spread function, float32."""
    pixels = np.ascontiguousarray(pixels, np.float32)
    return pixels if not sigma_px > 0.0 else cv2.GaussianBlur(pixels, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)


def roughly_aligned(frame: np.ndarray, drawn: Drawn, camera: Camera, body: BelievedBody,
                    others: dict[str, np.ndarray]) -> np.ndarray:
    """The body's place (3,) [m] in `camera` where small images of frame and believed frame correlate best.

    Other bodies are left out of the believed frame, and places of the body that are nearer to another's.

    Raises
    ------
    NotFound
        Nothing is lit, or no place correlates.
    """
    here, size = drawn.here, drawn.pixels.shape[::-1]
    believed_px = camera.project(here.r_body_camera_m)
    radius_px = camera.focal_length_px * body.mean_radius_m / here.range_m
    factor = min(1.0, _ROUGH_PX / max(size))
    found, expected = _shrunk(lit_pixels(frame), factor), lit_pixels(drawn.pixels) * drawn.is_clear
    best = (-np.inf, None)
    for scale in _ROUGH_SIZES:
        template = _shrunk(expected, factor * scale)
        mask = _shrunk(drawn.is_clear.astype(np.float32), factor * scale)
        reach = np.array(template.shape[::-1]) // 2
        wide = cv2.copyMakeBorder(found, *np.repeat(reach[::-1], 2).tolist(), cv2.BORDER_CONSTANT, value=0.0)
        score = np.nan_to_num(cv2.matchTemplate(wide, template, cv2.TM_CCORR_NORMED, mask=mask), posinf=0.0, neginf=0.0)
        rows, columns = np.indices(score.shape)
        # By the edges of pixels, which sizes leave in place.
        edge_px = (np.stack([columns, rows], axis=-1) - reach) / factor
        center_px = edge_px + scale * (believed_px - drawn.corner_px + 0.5) - 0.5
        off = np.linalg.norm(center_px - believed_px, axis=-1) / radius_px
        score = np.where(is_anothers(center_px, believed_px, others, radius_px), -np.inf,
                         score - _NEARER * (off + abs(np.log(scale))))
        top = np.unravel_index(score.argmax(), score.shape)
        best = max(best, (float(score[top]), (center_px[top], scale)), key=lambda each: each[0])
    if not best[0] > _LEAST_ROUGH:
        raise NotFound(f"the frame correlates with the believed frame by {best[0]:.2f}, {_LEAST_ROUGH} is needed")
    return placed(camera, best[1][0], here.range_m / best[1][1])


def _shrunk(image: np.ndarray, factor: float) -> np.ndarray:
    """An image in another size, float32."""
    size = [max(1, round(factor * side)) for side in image.shape[::-1]]
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR)


def placed(camera: Camera, center_px: np.ndarray, range_m: float) -> np.ndarray:
    """Place (3,) [m] of a point that is seen at a pixel from a distance."""
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
        self.frame, self._state, self._camera, self._body = frame, believed, camera, body
        self._render, self._products, self._enough_px, self._most = render, products, enough_px, most

    def __call__(self, step: Callable[[Drawn, int], tuple[np.ndarray, Any]]) -> tuple[np.ndarray, Any]:
        """The place (3,) [m] and the second value of `step(drawn, number)`, which gives the place first."""
        drawn = self._draw(sight(self._state, self._camera, self._body.name).r_body_camera_m)
        others = others_px(self._state, self._camera, self._body.name)
        rough_m = roughly_aligned(self.frame, drawn, self._camera, self._body, others)
        if self._size_px(drawn, rough_m) > 2.0:
            drawn = self._draw(rough_m)
        for number in range(self._most):
            place_m, result = step(drawn, number)
            if not np.isfinite(place_m).all() or not place_m[2] > 0.0:
                raise NotFound("the solution went astray")
            if self._size_px(drawn, place_m) < self._enough_px:
                return place_m, result
            if number + 1 < self._most:
                drawn = self._draw(place_m)
        raise NotFound(f"the place still moves by {self._size_px(drawn, place_m):.1f} px after {self._most} steps, "
                       f"{self._enough_px} is allowed")

    def _draw(self, place_m: np.ndarray) -> Drawn:
        return draw(self._render, moved(self._state, self._camera, self._body.name, place_m), self._camera, self._body,
                    self._products)

    def _size_px(self, drawn: Drawn, place_m: np.ndarray) -> float:
        shift_px, scale = shift_between(self._camera, drawn.here.r_body_camera_m, place_m)
        return shift_px + scale * self._camera.focal_length_px * self._body.mean_radius_m / drawn.here.range_m
