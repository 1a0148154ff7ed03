"""The slow exact engine: float64 rays (Embree), sampled until the frame's error is known.

Each pixel is sampled over its area; of crescents, and where that finds no light, the facets that face Sun and camera
are (`aimed`). Embree finds the facet in float32; the point is worked out again in float64 from the facet's plane, and
the laws are the float64 ones. It shares no line with the OpenGL passes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer

from ...base.own_process import OwnProcess
from ...base.progress import Progress
from ...planner.adaptive_samples import frame_error
from ...planner.error_model import CRESCENT_RAD, lit_share
from ...planner.predicted import rms_tolerance
from ...planner.walls import between_walls
from ...scene.scene import Scene
from ...scene.tolerance import checked_max_error
from ...view.regions import region
from ...view.state import State
from ...view.view import BodyView, view_bodies
from ..image import Image, checked_products
from .aimed import AimedRays
from .emission import Emitted
from .engine import RayEngine
from .products import full_shape_plan, traced_products

# Rounds before a pixel's scatter is believed, and at which even the worst pixel is given up.
_FIRST_ROUNDS, _MAX_ROUNDS = 4, 256
# Samples of a round along a pixel's side: one in each cell of the grid, jittered.
_STRATA = 2
# Ways out of a tolerance that is missed, of a lit and of a dark frame.
_TOO_FEW = f"it is out of reach with {_MAX_ROUNDS * _STRATA * _STRATA} rays a pixel: the backend \"cycles\" casts more"
_DARK = "no ray met light: give a larger max_error"
# Width [px] below which crescents are drawn from their facets: 0.02 takes less time so, of spheres of 20 to 300 px, a
# contact binary and Itokawa at 125 to 172 deg.
_THIN_PX = 8.0
# Error of the rays of facets [1] that a crescent's grid of samples is held against.
_AIMED_ERROR = 0.02


class RayTracer:
    """Draws a scene's states with rays; the interface is `Renderer`'s.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    DeviceError
        embreex is not installed.
    """

    settings: tuple[str, ...] = ()
    options: tuple[str, ...] = ("seed", "on_progress")

    def __init__(self, scene: Scene):
        self._own, self.scene = OwnProcess(), scene
        self._engine, self._left_out = RayEngine(scene), between_walls(scene)
        self._emitted = Emitted(scene, lambda: self._engine)

    def __enter__(self) -> RayTracer:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Release the acceleration structures; in a forked child it does nothing."""
        if self._own.is_here:
            self._engine.close()

    @property
    def draws_lenses(self) -> bool:
        """Whether it draws what a camera that distorts sees: without the light of a coma."""
        return not self.scene.emission

    @property
    def info(self) -> dict[str, Any]:
        """Name of the engine that draws."""
        return {"backend": "raytrace", "gl_renderer": "Embree (embreex)", "gl_version": ""}

    def render(self, state: State, camera: str | PinholeCamera | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None, seed: int = 0,
               on_progress: Callable[[float], None] | None = None) -> Image:
        """Draw one frame until the standard error of its pixels is below the tolerance.

        Parameters
        ----------
        state, camera, products
            As `Renderer.render`; products are those of the pixel's centre.
        max_error : float [1] or mapping, optional
            Root mean square standard error over the mean of the lit pixels, or as `Renderer.render`.
        samples : int, optional
            Samples along a pixel's side on a regular grid, and no adaptation. Their error is what they differ by from
            other rays: from one at random in each cell of the grid, or, of a crescent, from rays of its facets.
        seed : int
            Seed of the jitter: equal seeds give equal images.
        on_progress : callable, optional
            Called with the share done, 0..1: the rounds still to come are a guess.

        Returns
        -------
        Image
            `plan.predicted_error` is the standard error reached, or the one expected of `samples`. Of a dark frame it
            is the share of the light of the facets that face Sun and camera which may have been missed: 1 where these
            are so near or large that no rays are aimed at them.
        """
        self._own.check()
        began = time.perf_counter()
        pinhole = self.scene.drawn_camera(camera, self.draws_lenses)
        wanted = checked_products(products)
        max_error = self.scene.max_error if max_error is None else checked_max_error(max_error)
        if samples is not None:
            samples = integer("samples", samples, 1, 256)
        views = view_bodies(state, pinhole, self.scene.hulls)
        tolerance = rms_tolerance(max_error, views, pinhole)
        roi = region(views, pinhole)
        irradiance = np.zeros((pinhole.height_px, pinhole.width_px), np.float32)
        x0, y0, x1, y1 = roi
        aimed, rng = AimedRays(self._engine, pinhole, views, roi), np.random.default_rng(seed)
        rays = _PixelRays(lambda place, draw: self._engine.irradiance(place, pinhole, views, draw), roi,
                          aimed.may_be_lit, rng)
        is_thin = aimed.is_able and all(_is_thin(view) for view in views if view.is_visible)
        if samples is not None:
            mean, reached = _on_grid(rays, aimed, is_thin, samples, rng)
        else:
            mean, reached = _until(rays, aimed, is_thin, tolerance, rng, Progress(on_progress))
        irradiance[y0:y1, x0:x1] = mean
        arrays = traced_products(self._engine, wanted, pinhole, views, roi)
        way_out = "leave samples out" if samples is not None else _TOO_FEW if mean.any() else _DARK
        frame_plan = full_shape_plan(self.scene, pinhole, views, max_error=max_error, predicted_error=reached,
                                     roi=roi, way_out=way_out, left_out=self._left_out)
        frame_plan = self._emitted.add(irradiance, state, pinhole, views, frame_plan)
        took_ms = 1e3 * (time.perf_counter() - began)
        return Image(irradiance_W_m2=irradiance, products=arrays, plan=replace(frame_plan, milliseconds=took_ms),
                     request=(self.scene, state, pinhole), timings_ms={"trace": took_ms})


def _is_thin(view: BodyView) -> bool:
    return view.phase_rad > CRESCENT_RAD and lit_share(view.phase_rad, 0.0) * view.size_px < _THIN_PX


def _on_grid(rays: _PixelRays, aimed: AimedRays, is_thin: bool, samples: int, rng: np.random.Generator
             ) -> tuple[np.ndarray, float]:
    """Means (rows, columns) of a regular grid in each pixel, and what they differ by from other rays."""
    mean, other = rays.on_grid(samples), None
    if not is_thin:
        other = rays.on_grid(samples, is_jittered=True)
    if aimed.is_able and (other is None or not (mean + other).any()):
        other, own = aimed.until(_AIMED_ERROR, rng)
        if not other.any():
            return mean, frame_error(mean, mean) or own
        return mean, frame_error(other, mean - other)
    return mean, frame_error(0.5 * (mean + other), mean - other) or aimed.of_darkness(0.0)


def _until(rays: _PixelRays, aimed: AimedRays, is_thin: bool, tolerance: float, rng: np.random.Generator,
           progress: Progress) -> tuple[np.ndarray, float]:
    """Means (rows, columns) that meet the tolerance, or of the two kinds of rays those that err less; their error.

    A dark image's error is a share of all light, so that of a dark and a lit image the lit one stays.
    """
    made = []
    if not is_thin:
        made.append(rays.until(tolerance, progress.part(0.0, 0.5)))
    if aimed.is_able and not (made and made[0][0].any() and made[0][1] <= tolerance):
        found = aimed.until(tolerance, rng, progress.part(0.5 * len(made), 1.0))
        made.append(found)
    progress.finish()
    mean, error = min([each for each in made if each[0].any()] or made[-1:], key=lambda each: each[1])
    return mean, error if mean.any() else aimed.of_darkness(error)


class _PixelRays:
    """Rays through the pixels of a part of an image.

    Parameters
    ----------
    shoot : callable
        Places (N, 2) [px] and numbers of draws of the Sun's disc to irradiances (N,).
    roi : (x0, y0, x1, y1) int [px]
    may_be_lit : (rows, columns) bool
        The pixels that are asked.
    rng : Generator
    """

    def __init__(self, shoot: Callable[[np.ndarray, int], np.ndarray], roi: tuple[int, int, int, int],
                 may_be_lit: np.ndarray, rng: np.random.Generator):
        self._shoot, self._rng, self._shape = shoot, rng, may_be_lit.shape
        self._asked = np.flatnonzero(may_be_lit)
        row, column = np.divmod(self._asked, max(self._shape[1], 1))
        self._pixel = np.stack([roi[0] + column, roi[1] + row], axis=1).astype(np.float64)

    def _image(self, values: np.ndarray) -> np.ndarray:
        image = np.zeros(self._shape)
        image.ravel()[self._asked] = values
        return image

    def on_grid(self, samples: int, is_jittered: bool = False) -> np.ndarray:
        """Means (rows, columns) of a regular grid of samples, or of one at random in each of its cells."""
        offsets, total = (np.arange(samples) + 0.5) / samples - 0.5, np.zeros(len(self._pixel))
        for draw, (row, column) in enumerate(np.ndindex(samples, samples)):
            aside = self._rng.uniform(-0.5, 0.5, self._pixel.shape) / samples if is_jittered else 0.0
            # Other points of the Sun's disc, too.
            total += self._shoot(self._pixel + (offsets[column], offsets[row]) + aside,
                                 draw + samples**2 * is_jittered)
        return self._image(total / samples**2)

    def until(self, tolerance: float, report: Callable[[float], None]) -> tuple[np.ndarray, float]:
        """Means (rows, columns) sampled until the frame's standard error meets the tolerance, and that error.

        Each round puts one jittered sample into each cell of a pixel; the scatter of the rounds'
        means is the pixel's variance. Pixels that scatter less than their share stop early.
        """
        if not len(self._pixel):
            return self._image(0.0), 0.0
        cells = (np.arange(_STRATA) + 0.5) / _STRATA - 0.5
        places = [(dx, dy) for dy in cells for dx in cells]
        total, squares, rounds = (np.zeros(len(self._pixel)) for _ in range(3))
        active, share_done = np.arange(len(self._pixel)), 0.0
        for count in range(1, _MAX_ROUNDS + 1):
            jitter = self._rng.uniform(-0.5 / _STRATA, 0.5 / _STRATA, (_STRATA**2, len(active), 2))
            done = (count - 1) * len(places)
            mean = sum(self._shoot(self._pixel[active] + place + jitter[k], done + k)
                       for k, place in enumerate(places)) / len(places)
            total[active] += mean
            squares[active] += mean**2
            rounds[active] += 1.0
            if count < _FIRST_ROUNDS:
                continue
            mean = total / rounds
            if not mean.any():
                # Laplace's rule of succession: of all rays, the next one may meet light.
                return self._image(mean), 1.0 / (count * len(places) * len(mean) + 2.0)
            # A pixel whose few rounds agree by chance must not stop while its neighbours scatter.
            own = np.maximum(squares / rounds - mean**2, 0.0) / (rounds - 1.0)
            variance = np.maximum(own, _neighbours_mean(self._image(own)).ravel()[self._asked])
            reached = frame_error(mean, np.sqrt(variance))
            share_done = max(share_done, min((tolerance / max(reached, 1e-30)) ** 2, 1.0), count / _MAX_ROUNDS)
            report(share_done)
            if reached <= tolerance:
                break
            level = mean[mean > 0.0].mean()
            active = np.flatnonzero(variance > (0.5 * tolerance * level) ** 2)
        return self._image(mean), reached


def _neighbours_mean(values: np.ndarray) -> np.ndarray:
    return cv2.blur(values, (3, 3), borderType=cv2.BORDER_REFLECT_101)
