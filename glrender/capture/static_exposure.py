"""One pose of a camera of the scene: its margin, its lens and the Sun around what a renderer draws."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from glrender_camera import ConfigError, DistortingLens, PinholeCamera, PointSources, lens_of, noise
from glrender_camera.projection import MAX_IMAGE_PX
from glrender_camera.validate import integer

from ..base.progress import Progress
from ..engines.derivatives.jacobian import Jacobian
from ..engines.image import checked_products
from ..planner.account import in_pixels, restated
from ..planner.plan import RenderPlan
from ..planner.request import ImageUse
from ..scene.scene import Scene
from ..scene.tolerance import LEAST_DEADLINE_S, SIGMAS, by_unit, checked_deadline, checked_max_error
from ..view.regions import union
from ..view.state import State
from ..view.view import view_bodies
from .sky_background import sun_box, sunlight

# Products that vary smoothly over a facet are interpolated between cells while neighbours' ranges differ by less
# than so many footprints: a slope of 76 degrees.
_SMOOTH = ("range", "r_body")
_LARGEST_STEP = 4.0
# Smaller bodies are spread as points: an image of pixels has lost their places, a crescent's of 8 px by 0.06 px.
_APART_PX = 24.0
# Error of light that is moved in cells over their squared size [px2] and the image's second difference [1]: Itokawa of
# 12 and 40 px and spheres behind five lenses have 0.09 to 0.23.
_MOVED = 0.25
# Share of the brightest pixel's light [1] that a coma has less of.
_FAINT = 0.01
# Options of a capture, whatever its renderer takes.
_OPTIONS = ("max_error", "samples", "on_progress", "out")
# Values of products on the sky that are not NaN.
_BESIDE = {"body_id": -1, "facet_id": -1, "sunlit": 0}


@dataclass(frozen=True, kw_only=True, eq=False)
class Still:
    """One static exposure: irradiance (h, w) with the margin, its region `roi`, products (height, width) without it.

    `points` is the light of `n_small` bodies, or groups, of a few pixels or less, in the frame's `pixel`; it is not in
    the image. `apart` are these bodies' names.
    """

    irradiance_W_m2: np.ndarray
    roi: tuple[int, int, int, int]
    points: PointSources
    n_small: int
    apart: frozenset[str]
    products: dict[str, np.ndarray]
    plan: RenderPlan
    sun_text: str
    timings_ms: dict[str, float]
    jacobian: Jacobian | None = None
    """With the margin."""


class Drawing:
    """Draws poses of one camera.

    Parameters
    ----------
    renderer
        A renderer of `glrender.open_renderer`.
    camera : PinholeCamera
        One of the scene's.
    margin_px : int [px]
    is_for_detector : bool
        Whether the tolerance holds after the point spread function, and the Sun is drawn.
    exposure_s : float [s] or "auto", optional
        The frame's, whose noise a tolerance in deviations is of; the camera's by default.
    roi : (x0, y0, x1, y1) int [px], optional
        The part of the image that is asked for: where no image is moved by a lens no more is drawn, and the rest is
        dark, without a body.
    max_error, samples
        As of `Renderer.render`.
    on_progress : callable, optional
        Called with the share done, 0..1, of all poses: it never falls.
    **options
        Of the renderer; those of `Renderer.render` that it does not take are left out.

    Raises
    ------
    ConfigError
        An option that the renderer does not have.
    """

    def __init__(self, renderer: Any, camera: PinholeCamera, margin_px: int, is_for_detector: bool,
                 exposure_s: float | str | None = None, /, *,
                 roi: tuple[int, int, int, int] | None = None, max_error: float | Mapping[str, float] | None = None,
                 samples: int | None = None,
                 on_progress: Callable[[float], None] | None = None, **options: Any):
        self.progress = Progress(on_progress)
        self._renderer, self._camera, self._margin_px = renderer, camera, margin_px
        self._is_for_detector = is_for_detector
        wide = camera.with_margin(margin_px)
        self.lens = lens_of(wide) if is_resampled(renderer, camera) else None
        self.source = wide if self.lens is None else self.lens.source
        self._box = None
        if roi is not None:
            roi = checked_region(roi, wide)
        if roi is not None and self.lens is None:
            self._box, self._shape, self.source = roi, (wide.height_px, wide.width_px), _part(wide, roi)
        taken = renderer.options
        known = {*taken, *_OPTIONS} - {"use"}
        for name, value in options.items():
            if name not in known:
                raise ConfigError(name, "is no option", value, f"there are {', '.join(sorted(known))}")
        self._options = {name: value for name, value in options.items() if name in taken}
        self._tells = on_progress is not None and "on_progress" in taken
        self._tolerance = renderer.scene.max_error if max_error is None else checked_max_error(max_error)
        if exposure_s is not None and SIGMAS in by_unit(self._tolerance) and self.source.model is not None:
            self.source = replace(self.source, model=replace(self.source.model, exposure_s=exposure_s))
        # What the frame keeps of the drawn image's errors, but for the flux's: for the renderer to know, where it can.
        # Cells' errors are independent: their mean has 1 / n of each.
        n = self._n = 1 if self.lens is None else self.lens.oversampling
        self._share = (camera.model.psf_noise_gain if is_for_detector else 1.0) / n
        if "use" in taken:
            self._options["use"] = ImageUse(error_gain=self._share, out=options.get("out"),
                                            apart_px=_APART_PX * n if is_for_detector else 0.0)
            self._share = 1.0
        asked = in_pixels(by_unit(self._tolerance), n)
        if "rms" in asked:
            asked["rms"] = min(asked["rms"] / self._share, 1.0)
        seconds = self._options.pop("deadline_s", None)
        self._ends_s = None if seconds is None else time.monotonic() + checked_deadline(seconds)
        self._options["max_error"] = asked if isinstance(self._tolerance, Mapping) else asked["rms"]
        self._options["samples"] = -(-samples // n) if isinstance(samples, int) else samples

    @property
    def distortion_text(self) -> str:
        """The stage in words."""
        if self._camera.distortion is None:
            return "skipped: the camera has none"
        if self.lens is None:
            return f"{self._camera.distortion.text}; drawn behind the lens"
        n = self.lens.oversampling
        return (f"{self.lens.distortion.text}; drawn as {self.source.width_px} x {self.source.height_px} cells, "
                f"{n} x {n} a pixel")

    @property
    def region_text(self) -> str:
        """The stage in words."""
        if self._box is None:
            return "skipped: the whole image is drawn"
        return f"drawn alone: {list(self._box)} px"

    def still(self, state: State, products: Iterable[str] = (), part: tuple[float, float] = (0.0, 1.0)) -> Still:
        """One pose, which is `part` of the whole that `on_progress` reports: from one share of the whole to another."""
        wanted = checked_products(products)
        asked = wanted if self.lens is None or not set(wanted) & set(_SMOOTH) else {*wanted, *_SMOOTH, "body_id"}
        told = {"on_progress": self.progress.part(*part)} if self._tells else {}
        # All poses of an exposure share the time.
        left = {} if self._ends_s is None else {"deadline_s": max(self._ends_s - time.monotonic(), LEAST_DEADLINE_S)}
        image = self._renderer.render(state, self.source, products=asked, **told, **left, **self._options)
        light, roi, sun_text = image.irradiance_W_m2, image.roi, "skipped: out of view"
        box = sun_box(state, self.source) if self._is_for_detector else None
        if box is not None:
            x0, y0, x1, y1 = box
            disc = sunlight(self._renderer, state, self.source, box)
            light[y0:y1, x0:x1] += disc
            roi, sun_text = union([roi, box]) if any(roi) else box, "in view"
            if not disc.any():
                sun_text = "skipped: hidden by a body, or outside the image"
        plan, made, jacobian = image.plan, image.products, image.jacobian
        if self._box is not None:
            x0, y0, _, _ = self._box
            roi = (roi[0] + x0, roi[1] + y0, roi[2] + x0, roi[3] + y0) if any(roi) else roi
            light = self._in_place(light, 0.0)
            jacobian = jacobian and jacobian.moved(x0, y0)
            made = {name: self._in_place(values, _BESIDE.get(name, np.nan)) for name, values in made.items()}
        moved = 0.0
        if self.lens is not None:
            light, roi = self.lens.apply(light, roi), self.lens.reached_box(roi)
            made = sampled(made, self.lens, self._camera, wanted)
            moved = self._moved_error(light)
        if self._share != 1.0 or self._n != 1:
            rms = plan.max_error * self._share if isinstance(self._tolerance, Mapping) else self._tolerance
            plan = restated(plan, cells=self._n, max_error=rms, asked=by_unit(self._tolerance),
                            predicted_error=math.hypot(plan.predicted_error * self._share, moved),
                            navigation=in_pixels(plan.navigation, 1.0 / self._n))
        if self.lens is None and self._margin_px:
            inside = np.s_[self._margin_px:-self._margin_px, self._margin_px:-self._margin_px]
            made = {name: np.ascontiguousarray(values[inside]) for name, values in made.items()}
        small = [body for body in image.small_bodies if body.is_apart]
        return Still(irradiance_W_m2=light, roi=roi, points=self._placed([body.points for body in small]),
                     n_small=len(small), apart=frozenset(name for body in small for name in body.names),
                     products=made, plan=plan, sun_text=sun_text, timings_ms=image.timings_ms, jacobian=jacobian)

    def _moved_error(self, light: np.ndarray) -> float:
        """RMS error [1] of an image (h, w) whose light was moved in cells: they blur it by their squared size."""
        # The mean is that of bodies, not of a coma, whose light has no edges.
        lit = light > _FAINT * light.max()
        if self.lens is None or not lit.any():
            return 0.0
        cell_px = self._camera.with_margin(self._margin_px).lens_map.stretch / self._n
        bend = cv2.Laplacian(light.astype(np.float64), cv2.CV_64F, borderType=cv2.BORDER_REPLICATE)[lit]
        gain = self._camera.model.psf_noise_gain if self._is_for_detector else 1.0
        return gain * _MOVED * cell_px**2 * float(np.sqrt(np.mean(bend**2)) / light[lit].mean(dtype=np.float64))

    def _placed(self, kept: Sequence[PointSources]) -> PointSources:
        """Points of the source's image in the frame."""
        if not kept:
            return PointSources([], [])
        xy = np.concatenate([points.xy_px for points in kept])
        if self.lens is None:
            xy = xy - self._margin_px
        else:
            xy = self._camera.project(self.source.directions(xy))
        light = np.concatenate([points.irradiance_W_m2 for points in kept])
        seen = np.isfinite(xy).all(axis=1)
        return PointSources(xy[seen], light[seen])

    def _in_place(self, part: np.ndarray, beside: float) -> np.ndarray:
        """The whole image, of which a part was drawn."""
        whole = np.full((*self._shape, *part.shape[2:]), beside, part.dtype)
        x0, y0, x1, y1 = self._box
        whole[y0:y1, x0:x1] = part
        return whole


def is_resampled(renderer: Any, camera: PinholeCamera) -> bool:
    """Whether a renderer draws a rectilinear image, whose light is moved by the camera's lens."""
    return camera.distortion is not None and not getattr(renderer, "draws_lenses", False)


def _part(camera: PinholeCamera, box: tuple[int, int, int, int]) -> PinholeCamera:
    """The camera that sees a part of another's image."""
    x0, y0, x1, y1 = box
    x, y = camera.principal_point_px
    return replace(camera, width_px=x1 - x0, height_px=y1 - y0, principal_point_px=(x - x0, y - y0))


def margin_of(renderer: Any, state: State, camera: PinholeCamera, is_moving: bool) -> tuple[int, str]:
    """The margin to draw beyond the frame of a camera with a model [px], and the reason in words."""
    scene = renderer.scene
    reach = _largest_margin(camera)
    if not reach:
        why = "the lens images nothing there" if camera.model.psf_margin_px > 0 else "no light is spread that far"
        return 0, f"skipped: {why}"
    text = f"{reach} px, as far as light is spread"
    # Comae have no edge; another margin would be another lens to prepare, or another size from pose to pose.
    if scene.emission or is_resampled(renderer, camera) or is_moving:
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
    """Prepare what first frames would wait for: kernels, the sensors' patterns, the moves of lenses."""
    for camera in scene.cameras:
        wide = camera.with_margin(lens_margin(camera))
        if camera.model is not None:
            noise.tables()
            camera.with_margin(_largest_margin(camera)).cos_field_angle  # noqa: B018 (a cached property)
            camera.own_model.detector.fixed_pattern((camera.height_px, camera.width_px))
            for band in camera.model.bands.values():
                if band.optics.is_diffracted or band.optics.psf_measured is not None:
                    band.optics.psf_fine_kernel  # noqa: B018 (a cached property: of stars and of small bodies)
        if (lens := lens_of(wide)) is not None and scene.emission:
            lens.prepare()
        for each in (camera, wide):
            if each.lens_map is not None:
                each.lens_map.pixels_solid_angles  # noqa: B018 (a cached property)


def lens_margin(camera: PinholeCamera) -> int:
    """Margin [px] of all images that a lens moves, so that a camera has one lens; none of any other camera."""
    return 0 if camera.distortion is None or camera.model is None else _largest_margin(camera)


@lru_cache(maxsize=16)
def _largest_margin(camera: PinholeCamera) -> int:
    """The distance over which light is spread [px], or 0 where the lens images nothing there."""
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


def checked_region(roi: object, camera: PinholeCamera) -> tuple[int, int, int, int]:
    """A region of interest x0, y0, x1, y1 [px], one past the last, within the image."""
    if not isinstance(roi, (tuple, list)) or len(roi) != 4:
        raise ConfigError("roi", "must be four integers: x0, y0, x1, y1, one past the last", roi)
    x0, y0, x1, y1 = (integer(f"roi[{k}]", number, 0, limit) for k, (number, limit) in enumerate(
        zip(roi, (camera.width_px, camera.height_px) * 2, strict=True)))
    if not (x0 < x1 and y0 < y1):
        raise ConfigError("roi", "must have x0 < x1 and y0 < y1", roi)
    return x0, y0, x1, y1
