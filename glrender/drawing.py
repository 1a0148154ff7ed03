"""One pose of a camera of the scene: its margin, its lens and the Sun around what a renderer draws."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from glrender_camera import ConfigError, DistortingLens, PinholeCamera, lens_of
from glrender_camera.projection import MAX_IMAGE_PX

from .background import sun_box, sunlight
from .grouping import union
from .image import checked_products
from .render_plan import RenderPlan
from .scene import Scene, checked_max_error
from .state import State
from .view import view_bodies

# Products that vary smoothly over a facet are interpolated between cells while neighbours' ranges differ by less
# than so many footprints: a slope of 76 degrees.
_SMOOTH = ("range", "r_body")
_LARGEST_STEP = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Still:
    """What stands still: irradiance (h, w) with the margin, its region `roi`, products (height, width) without it."""

    irradiance_W_m2: np.ndarray
    roi: tuple[int, int, int, int]
    products: dict[str, np.ndarray]
    plan: RenderPlan
    sun_text: str
    timings_ms: dict[str, float]


class Drawing:
    """Draws poses of one camera.

    Parameters
    ----------
    renderer
        Of `glrender.open_renderer`.
    camera : PinholeCamera
        One of the scene's.
    margin_px : int [px]
    is_for_detector : bool
        Whether the budget holds after the point spread function, and the Sun is drawn.
    max_error, samples
        As of `Renderer.render`.
    **options
        Of the renderer; those that it does not take are left out.
    """

    def __init__(self, renderer: Any, camera: PinholeCamera, margin_px: int, is_for_detector: bool, *,
                 max_error: float | None = None, samples: int | None = None, **options: Any):
        self._renderer, self._camera, self._margin_px = renderer, camera, margin_px
        self._is_for_detector = is_for_detector
        wide = camera.with_margin(margin_px)
        self.lens = lens_of(wide)
        self.source = wide if self.lens is None else self.lens.source
        taken = inspect.signature(renderer.render).parameters
        self._options = {name: value for name, value in options.items() if name in taken}
        self._budget = renderer.scene.max_error if max_error is None else checked_max_error(max_error)
        # What the frame keeps of the drawn image's error, where the renderer does not know.
        self._share = camera.model.psf_noise_gain if is_for_detector else 1.0
        if self.lens is None and "after_psf" in taken:
            self._options["after_psf"], self._share = is_for_detector, 1.0
        n = 1 if self.lens is None else self.lens.oversampling
        # Cells' errors are independent: their mean has 1 / n of them.
        self._share /= n
        self._options["max_error"] = min(self._budget / self._share, 1.0)
        self._options["samples"] = -(-samples // n) if isinstance(samples, int) else samples

    @property
    def distortion_text(self) -> str:
        """The stage in words."""
        if self.lens is None:
            return "skipped: the camera has none"
        n = self.lens.oversampling
        return (f"{self.lens.distortion.text}; drawn as {self.source.width_px} x {self.source.height_px} cells, "
                f"{n} x {n} a pixel")

    def still(self, state: State, products: Iterable[str] = ()) -> Still:
        """One pose."""
        wanted = checked_products(products)
        asked = wanted if self.lens is None or not set(wanted) & set(_SMOOTH) else {*wanted, *_SMOOTH, "body_id"}
        image = self._renderer.render(state, self.source, products=asked, **self._options)
        light, roi, sun_text = image.irradiance_W_m2, image.roi, "skipped: out of view"
        box = sun_box(state, self.source) if self._is_for_detector else None
        if box is not None:
            x0, y0, x1, y1 = box
            light[y0:y1, x0:x1] += sunlight(self._renderer, state, self.source, box)
            roi, sun_text = union([roi, box]) if any(roi) else box, "in view"
        plan, made = image.plan, image.products
        if self._share != 1.0:
            plan = replace(plan, max_error=self._budget, predicted_error=plan.predicted_error * self._share)
        if self.lens is not None:
            light, roi = self.lens.apply(light, roi), self.lens.reached_box(roi)
            made = sampled(made, self.lens, self._camera, wanted)
        elif self._margin_px:
            inside = np.s_[self._margin_px:-self._margin_px, self._margin_px:-self._margin_px]
            made = {name: np.ascontiguousarray(values[inside]) for name, values in made.items()}
        return Still(irradiance_W_m2=light, roi=roi, products=made, plan=plan, sun_text=sun_text,
                     timings_ms=image.timings_ms)


def margin_of(scene: Scene, state: State, camera: PinholeCamera) -> tuple[int, str]:
    """How far beyond the frame of a camera with a model to draw [px], and why."""
    reach = _largest_margin(camera)
    if not reach:
        why = "the lens images nothing there" if camera.model.psf_margin_px > 0 else "no light is spread that far"
        return 0, f"skipped: {why}"
    text = f"{reach} px, as far as light is spread"
    # Comae have no edge; another margin would be another lens to prepare, or another size from pose to pose.
    if scene.emission or camera.distortion is not None or state.is_moving:
        return reach, text
    wide = camera.with_margin(reach)
    boxes = [view.bounds_px for view in view_bodies(state, wide, scene.hulls)
             if view.is_visible]
    boxes.append(sun_box(state, wide) or (reach, reach, reach, reach))
    size = np.array([camera.width_px, camera.height_px])
    if all(box is not None and (np.array(box[:2]) >= reach - 0.5).all()
           and (np.array(box[2:]) <= reach + size - 0.5).all() for box in boxes):
        return 0, "skipped: nothing reaches beyond the frame"
    return reach, text


def drawn_pixels(camera: PinholeCamera) -> int:
    """Most pixels of an image that is drawn for a camera's frame."""
    wide = camera.with_margin(_largest_margin(camera) if camera.model is not None else 0)
    lens = lens_of(wide)
    source = wide if lens is None else lens.source
    return source.width_px * source.height_px


def prepare(scene: Scene) -> None:
    """Do now what first frames would wait for: kernels, the sensors' patterns, the moves of lenses, stars' kernels."""
    for camera in scene.cameras:
        wide = camera.with_margin(lens_margin(camera))
        if camera.model is not None:
            camera.with_margin(_largest_margin(camera)).cos_field_angle  # noqa: B018 (a cached property)
            camera.model.detector.fixed_pattern((camera.height_px, camera.width_px))
            for band in camera.model.bands.values():
                if scene.stars is not None and band.optics.is_diffracted:
                    band.optics.psf_fine_kernel  # noqa: B018 (a cached property)
        if (lens := lens_of(wide)) is not None:
            lens.prepare()


def lens_margin(camera: PinholeCamera) -> int:
    """Margin [px] that all images of a distorting camera have, so that it has one lens; none of any other camera."""
    return 0 if camera.distortion is None or camera.model is None else _largest_margin(camera)


@lru_cache(maxsize=16)
def _largest_margin(camera: PinholeCamera) -> int:
    """As far as light is spread, or 0 where the lens images nothing there [px]."""
    reach = min(camera.model.psf_margin_px, (MAX_IMAGE_PX - max(camera.width_px, camera.height_px)) // 2)
    try:
        lens_of(camera.with_margin(reach))
    except ConfigError:
        return 0
    return reach


def sampled(products: dict[str, np.ndarray], lens: DistortingLens, camera: PinholeCamera,
            wanted: Iterable[str]) -> dict[str, np.ndarray]:
    """Products of a lens's source where the pixels of a distorted camera look.

    Those of the nearest cell; ranges and places are interpolated where four cells see one smooth part of one body.

    Parameters
    ----------
    products : dict of str to (h, w, ...) array
    lens : DistortingLens
        Of the camera, or of the camera with its margin.
    camera : PinholeCamera
    wanted : iterable of str

    Returns
    -------
    dict of str to (height, width, ...) array
    """
    wanted = tuple(wanted)
    if not wanted:
        return {}
    source = lens.source
    place = camera.seen * source.focal_length_px + np.array(source.principal_point_px)
    limits = np.array([source.width_px, source.height_px]) - 1
    nearest = np.clip(np.rint(place).astype(np.intp), 0, limits)
    made = {name: products[name][nearest[..., 1], nearest[..., 0]] for name in wanted}
    if not set(made) & set(_SMOOTH):
        return made
    low = np.clip(np.floor(place).astype(np.intp), 0, limits - 1)
    x, y = np.moveaxis(place - low, -1, 0)
    corners = [(low[..., 1] + dy, low[..., 0] + dx) for dy in (0, 1) for dx in (0, 1)]
    weights = [(y if dy else 1.0 - y) * (x if dx else 1.0 - x) for dy in (0, 1) for dx in (0, 1)]
    body, ranges = (np.stack([products[name][corner] for corner in corners]) for name in ("body_id", "range"))
    with np.errstate(invalid="ignore"):
        is_smooth = (body == body[0]).all(axis=0) & (
            np.ptp(ranges, axis=0) < _LARGEST_STEP * ranges[0] / source.focal_length_px)
    for name in set(made) & set(_SMOOTH):
        parts = [products[name][corner] for corner in corners]
        shape = weights[0].shape + (1,) * (parts[0].ndim - 2)
        mean = sum(weight.reshape(shape) * part for weight, part in zip(weights, parts, strict=True))
        made[name] = np.where(is_smooth.reshape(shape), mean, made[name]).astype(products[name].dtype)
    return made
