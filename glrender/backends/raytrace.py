"""The slow exact engine: float64 rays (Embree), each pixel sampled over its area until its error is known.

Embree finds the facet in float32; the point is worked out again in float64 from the facet's
plane, and the laws are the float64 ones. It shares no line with the OpenGL passes.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from glrender_camera.validate import integer

from ..grouping import region
from ..image import Image, checked_products
from ..plan import BodyPlan, RenderPlan
from ..ray_engine import BESIDE, RayEngine
from ..scene import Scene, checked_max_error
from ..state import State
from ..view import view_bodies

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
        self.scene = scene
        self._engine = RayEngine(scene)

    def __enter__(self) -> RayTracer:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Release the acceleration structures."""
        self._engine.close()

    @property
    def info(self) -> dict[str, Any]:
        """Which engine draws."""
        return {"backend": "raytrace", "gl_renderer": "Embree (embreex)", "gl_version": ""}

    def render(self, state: State, camera: str | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None, seed: int = 0) -> Image:
        """Draw one frame until the standard error of its pixels is below the budget.

        Parameters
        ----------
        state, camera, products
            As `Renderer.render`; products are those of the pixel's centre.
        max_error : float [1], optional
            Root mean square standard error over the mean of the lit pixels.
        samples : int, optional
            Samples along a pixel's side on a regular grid, and no adaptation.
        seed : int
            Of the jitter: equal seeds give equal images.

        Returns
        -------
        Image
            `plan.predicted_error` is the standard error reached.
        """
        began = time.perf_counter()
        pinhole = self.scene.camera(camera)
        wanted = checked_products(products)
        budget = self.scene.max_error if max_error is None else checked_max_error(max_error)
        if samples is not None:
            samples = integer("samples", samples, 1, 256)
        views = view_bodies(state, pinhole, {body.name: body.hull for body in self.scene.bodies})
        roi = region([v for v in views if v.is_visible], pinhole) if any(v.is_visible for v in views) else (0, 0, 0, 0)
        irradiance = np.zeros((pinhole.height_px, pinhole.width_px))
        x0, y0, x1, y1 = roi
        y, x = (axis.ravel() for axis in np.mgrid[y0:y1, x0:x1])
        pixel = np.stack([x, y], axis=1).astype(np.float64)
        shoot = lambda place: self._engine.irradiance(place, pinhole, views)  # noqa: E731
        if samples is not None:
            offsets = (np.arange(samples) + 0.5) / samples - 0.5
            mean = sum((shoot(pixel + (dx, dy)) for dy in offsets for dx in offsets), np.zeros(len(pixel)))
            mean, reached = mean / samples**2, 0.0
        else:
            mean, reached = _adapt(shoot, pixel, (y1 - y0, x1 - x0), budget, np.random.default_rng(seed))
        irradiance[y, x] = mean
        arrays = {}
        if wanted:
            seen = self._engine.products(pixel, pinhole, views)
            for name in wanted:
                values = seen[name]
                arrays[name] = np.full((*irradiance.shape, *values.shape[1:]), BESIDE[name], values.dtype)
                arrays[name][y, x] = values
        frame_plan = RenderPlan(
            camera=pinhole.name, max_error=budget, roi=roi, windows=(), predicted_error=reached,
            left_out=tuple(f"light around {each.body}: rays draw surfaces only" for each in self.scene.emission),
            bodies=tuple(BodyPlan(
                name=v.name, is_visible=v.is_visible, n_facets=len(self.scene.bodies[k].shape.facets),
                level=0, law=self.scene.bodies[k].brdf.glsl, shadow_map_px=None, shadow_map_reused=False,
                relative_to_camera=True, normal_lookup=True, size_px=v.size_px) for k, v in enumerate(views)))
        return Image(irradiance_W_m2=irradiance.astype(np.float32), products=arrays, plan=frame_plan,
                     timings_ms={"trace": 1e3 * (time.perf_counter() - began)})


def _adapt(shoot, pixel: np.ndarray, shape: tuple[int, int], budget: float,
           rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Mean of each pixel, sampled until the frame's standard error meets the budget, and that error.

    Each round puts one jittered sample into each cell of a pixel; the scatter of the rounds'
    means is the pixel's variance. Pixels that scatter less than their share stop early.
    """
    cells = (np.arange(_STRATA) + 0.5) / _STRATA - 0.5
    total, squares, rounds = (np.zeros(len(pixel)) for _ in range(3))
    active = np.arange(len(pixel))
    for count in range(1, _MAX_ROUNDS + 1):
        jitter = rng.uniform(-0.5 / _STRATA, 0.5 / _STRATA, (_STRATA**2, len(active), 2))
        places = [(dx, dy) for dy in cells for dx in cells]
        mean = sum(shoot(pixel[active] + place + jitter[k]) for k, place in enumerate(places)) / len(places)
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
            return mean, 0.0
        level = mean[lit].mean()
        reached = float(np.sqrt(variance[lit].mean()) / level)
        if reached <= budget:
            break
        active = np.flatnonzero(variance > (0.5 * budget * level) ** 2)
    return mean, reached


def _neighbours_mean(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return cv2.blur(values.reshape(shape), (3, 3), borderType=cv2.BORDER_REFLECT_101).ravel()
