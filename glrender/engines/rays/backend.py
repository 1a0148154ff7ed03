"""The slow exact engine: float64 rays (Embree), each pixel sampled over its area until its error is known.

Embree finds the facet in float32; the point is worked out again in float64 from the facet's
plane, and the laws are the float64 ones. It shares no line with the OpenGL passes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

import cv2
import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer

from ...base.own_process import OwnProcess
from ...planner.adaptive_samples import frame_error, pixel_errors
from ...planner.error_model import crescent_gain
from ...planner.predicted import rms_tolerance
from ...scene.scene import Scene
from ...scene.tolerance import checked_max_error
from ...view.state import State
from ...view.view import view_bodies
from ..image import Image, checked_products
from .emission import Emitted
from .engine import RayEngine
from .products import full_shape_plan, traced_products, visible_region

# Rounds before a pixel's scatter is believed, and at which even the worst pixel is given up.
_FIRST_ROUNDS, _MAX_ROUNDS = 4, 256
# Samples of a round along a pixel's side: one in each cell of the grid, jittered.
_STRATA = 2


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

    def __init__(self, scene: Scene):
        self._own, self.scene = OwnProcess(), scene
        self._engine = RayEngine(scene)
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
            Samples along a pixel's side on a regular grid, and no adaptation. Their error follows from how two halves
            of them differ; with one sample, from the contrast of 3 x 3 pixels.
        seed : int
            Of the jitter: equal seeds give equal images.
        on_progress : callable, optional
            Called with the share done, 0..1: the rounds still to come are a guess.

        Returns
        -------
        Image
            `plan.predicted_error` is the standard error reached, or the one expected of `samples`.
        """
        self._own.check()
        began = time.perf_counter()
        pinhole = self.scene.drawn_camera(camera)
        wanted = checked_products(products)
        max_error = self.scene.max_error if max_error is None else checked_max_error(max_error)
        if samples is not None:
            samples = integer("samples", samples, 1, 256)
        views = view_bodies(state, pinhole, self.scene.hulls)
        tolerance = rms_tolerance(max_error, views, pinhole)
        roi = visible_region(views, pinhole)
        irradiance = np.zeros((pinhole.height_px, pinhole.width_px))
        x0, y0, x1, y1 = roi
        y, x = (axis.ravel() for axis in np.mgrid[y0:y1, x0:x1])
        pixel = np.stack([x, y], axis=1).astype(np.float64)
        shoot = lambda place, draw: self._engine.irradiance(place, pinhole, views, draw)  # noqa: E731
        if samples is not None:
            mean, reached = _regular(shoot, pixel, (y1 - y0, x1 - x0), samples)
            reached *= crescent_gain(max((view.phase_rad for view in views if view.is_visible), default=0.0))
        else:
            mean, reached = _adapt(shoot, pixel, (y1 - y0, x1 - x0), tolerance, np.random.default_rng(seed),
                                   on_progress or (lambda share: None))
        irradiance[y, x] = mean
        irradiance = irradiance.astype(np.float32)
        arrays = traced_products(self._engine, wanted, pinhole, views, roi)
        frame_plan = full_shape_plan(self.scene, pinhole, views, max_error=max_error, predicted_error=reached, roi=roi)
        frame_plan = self._emitted.add(irradiance, state, pinhole, views, frame_plan)
        return Image(irradiance_W_m2=irradiance, products=arrays, plan=frame_plan,
                     request=(self.scene, state, pinhole), timings_ms={"trace": 1e3 * (time.perf_counter() - began)})


def _regular(shoot, pixel: np.ndarray, shape: tuple[int, int], samples: int) -> tuple[np.ndarray, float]:
    """Mean of each pixel, of a regular grid of samples, and the frame's error that they tell of."""
    if not len(pixel):
        return np.zeros(0), 0.0
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    # Like the fields of a chessboard: both halves are spread over the whole pixel.
    halves = np.zeros((2, len(pixel)))
    for draw, (row, column) in enumerate(np.ndindex(samples, samples)):
        halves[(row + column) % 2] += shoot(pixel + (offsets[column], offsets[row]), draw)
    mean = halves.sum(axis=0) / samples**2
    if samples == 1:
        return mean, frame_error(*pixel_errors(mean.reshape(shape).astype(np.float32), 1))
    n = samples**2
    return mean, frame_error(mean, 0.5 * (halves[0] / (n - n // 2) - halves[1] / (n // 2)))


def _adapt(shoot, pixel: np.ndarray, shape: tuple[int, int], tolerance: float,
           rng: np.random.Generator, report: Callable[[float], None]) -> tuple[np.ndarray, float]:
    """Mean of each pixel, sampled until the frame's standard error meets the tolerance, and that error.

    Each round puts one jittered sample into each cell of a pixel; the scatter of the rounds'
    means is the pixel's variance. Pixels that scatter less than their share stop early.
    """
    if not len(pixel):
        report(1.0)
        return np.zeros(0), 0.0
    cells = (np.arange(_STRATA) + 0.5) / _STRATA - 0.5
    total, squares, rounds = (np.zeros(len(pixel)) for _ in range(3))
    active, told = np.arange(len(pixel)), 0.0
    for count in range(1, _MAX_ROUNDS + 1):
        jitter = rng.uniform(-0.5 / _STRATA, 0.5 / _STRATA, (_STRATA**2, len(active), 2))
        places = [(dx, dy) for dy in cells for dx in cells]
        done = (count - 1) * len(places)
        mean = sum(shoot(pixel[active] + place + jitter[k], done + k)
                   for k, place in enumerate(places)) / len(places)
        total[active] += mean
        squares[active] += mean**2
        rounds[active] += 1.0
        if count < _FIRST_ROUNDS:
            continue
        mean = total / rounds
        # A pixel whose few rounds agree by chance must not stop while its neighbours scatter.
        own = np.maximum(squares / rounds - mean**2, 0.0) / (rounds - 1.0)
        variance = np.maximum(own, _neighbours_mean(own, shape))
        lit = mean > 0.0
        if not lit.any():
            report(1.0)
            return mean, 0.0
        level = mean[lit].mean()
        reached = float(np.sqrt(variance[lit].mean()) / level)
        told = max(told, min((tolerance / max(reached, 1e-30)) ** 2, 1.0), count / _MAX_ROUNDS)
        report(told)
        if reached <= tolerance:
            break
        active = np.flatnonzero(variance > (0.5 * tolerance * level) ** 2)
    return mean, reached


def _neighbours_mean(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return cv2.blur(values.reshape(shape), (3, 3), borderType=cv2.BORDER_REFLECT_101).ravel()
