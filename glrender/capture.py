"""From a state to what a camera sees of it: the one chain that server, command line and users share.

    bodies → distortion → mean over the exposure → the camera model (point spread, stars, detector)

What a scene does not need is skipped, and `stages` says so.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from glrender_camera import Frame, MosaicModel, PinholeCamera, PointSources, time_average
from glrender_camera.camera import checked_exposure
from glrender_camera.shutter import row_weights

from .background import merged, stars_behind
from .drawing import Drawing, Still, lens_margin, margin_of
from .errors import ConfigError
from .grouping import union
from .motion import STILL, Motion, plan_motion
from .render_plan import RenderPlan
from .scene import Scene, band_irradiances
from .state import State


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """What a camera sees of a state.

    Attributes
    ----------
    irradiance_W_m2 : (height, width) float32 [W/m2]
        From each pixel's solid angle, before optics and stars: of the bodies at `t_s`; with a frame the mean over
        its exposure, and the Sun's disc.
    products : dict of str to array
        At `t_s` and each pixel's centre, as of `Image`.
    frame : Frame or None
        With `take_frame`: digital numbers, exposure, seed.
    plan : RenderPlan
        Of the image that was drawn at `t_s`: its pixels are the frame's, or those of the margin and the oversampled
        rectilinear image that `stages` tell of.
    stages : dict of str to str
        What was modelled between the bodies and the digital numbers, and what was skipped, with why.
    timings_ms : dict of str to float
    """

    irradiance_W_m2: np.ndarray
    products: dict[str, np.ndarray]
    frame: Frame | None
    plan: RenderPlan
    stages: dict[str, str]
    timings_ms: dict[str, float]


def draw_still(renderer: Any, state: State, camera: str | None = None, *, products: Iterable[str] = (),
               **options: Any) -> Capture:
    """The irradiance image of a camera, distorted as its lens does it.

    Parameters
    ----------
    renderer
        Of `glrender.open_renderer`.
    state : State
    camera : str, optional
        Name; the scene's only camera by default.
    products
        As of `Renderer.render`.
    **options
        `max_error`, `samples`, `allow_slow`, `on_progress` of `Renderer.render`; those that another renderer does
        not take are left out.

    Raises
    ------
    SceneError, ConfigError
    """
    pinhole = renderer.scene.camera(camera)
    began, margin_px = time.perf_counter(), lens_margin(pinhole)
    drawing = Drawing(renderer, pinhole, margin_px, False, **options)
    still = drawing.still(state, products)
    return Capture(irradiance_W_m2=_without_margin(still.irradiance_W_m2, margin_px), products=still.products,
                   frame=None, plan=still.plan, stages={"distortion": drawing.distortion_text},
                   timings_ms=_timings(still, began))


def take_frame(renderer: Any, state: State, camera: str | None = None, *, seed: int = 0,
               exposure_s: float | str | None = None, previous: Frame | None = None, products: Iterable[str] = (),
               **options: Any) -> Capture:
    """The frame that a camera with a model sends.

    Parameters
    ----------
    renderer
        Of `glrender.open_renderer`.
    state : State
        At the middle of the exposure; with rates what moves is blurred.
    camera : str, optional
        Name; the scene's only camera by default.
    seed : int, 0..2**64 - 1
        Of the temporal noise.
    exposure_s : float [s] > 0 or "auto", optional
        Default is the model's. "auto" meters the light of `state`, standing still.
    previous : Frame, optional
        This camera's last frame: an automatic exposure is then what that one asks for, as on board.
    products
        As of `Renderer.render`.
    **options
        As of `draw_still`; the budget holds after the point spread function.

    Returns
    -------
    Capture

    Raises
    ------
    SceneError, ConfigError
        Also for a camera without a model.
    """
    scene: Scene = renderer.scene
    pinhole = scene.camera(camera)
    model = pinhole.model
    if model is None:
        raise ConfigError("output", f"camera {pinhole.name!r} has no optics and detector", "dn",
                          "give it a `model` in the scene, or ask for 'irradiance'")
    exposure = checked_exposure("exposure_s", model.exposure_s if exposure_s is None else exposure_s)
    if exposure == "auto" and previous is not None:
        exposure = model.auto_exposure.after(previous, model.detector)
    began = time.perf_counter()
    margin_px, margin_text = margin_of(scene, state, pinhole)
    drawing = Drawing(renderer, pinhole, margin_px, True, **options)
    sensor = _Sensor(scene, pinhole, margin_px)
    still, motion = drawing.still(state, products), STILL
    irradiance, roi, points = still.irradiance_W_m2, still.roi, sensor.points([(state, None)])
    timings = _timings(still, began)
    if state.is_moving:
        moved = time.perf_counter()
        if exposure == "auto":
            exposure = sensor.expose(irradiance, seed, exposure, roi, points).exposure_s
        motion = plan_motion(scene, state, pinhole, exposure, model.detector.rolling_shutter_row_s, margin_px)
        if not motion.is_still:
            irradiance, roi, weights = _mean(drawing, state, still, motion)
            points = sensor.points([(state.after(dt), weight) for dt, weight in zip(motion.times_s, weights.T,
                                                                                  strict=True)])
        timings["motion_blur"] = 1e3 * (time.perf_counter() - moved)
    exposed = time.perf_counter()
    frame = sensor.expose(irradiance, seed, exposure, roi, points)
    timings["camera"] = 1e3 * (time.perf_counter() - exposed)
    stages = {"distortion": drawing.distortion_text, "margin": margin_text, "motion_blur": motion.text,
              "sun": still.sun_text, "stars": sensor.stars_text(points), **frame.stages}
    return Capture(irradiance_W_m2=_without_margin(irradiance, margin_px), products=still.products,
                   frame=replace(frame, stages=stages), plan=still.plan, stages=stages, timings_ms=timings)


class _Sensor:
    """A camera's model behind images with a margin, in all of its bands."""

    def __init__(self, scene: Scene, camera: PinholeCamera, margin_px: int):
        self._scene, self._camera, self._margin_px = scene, camera, margin_px

    def points(self, poses: list[tuple[State, np.ndarray | None]]) -> dict[str, PointSources] | None:
        """Stars of some poses, each with its weights of the image's rows; None where there are none."""
        if self._scene.stars is None:
            return None
        parts: dict[str, list] = {}
        for state, weights in poses:
            for letter, points in stars_behind(self._scene, state, self._camera).items():
                if weights is None:
                    share = np.ones(len(points.xy_px))
                else:
                    row = np.rint(points.xy_px[:, 1]).astype(int) + self._margin_px
                    share = weights[np.clip(row, 0, len(weights) - 1)]
                parts.setdefault(letter, []).append((points, share))
        found = {letter: merged(each) for letter, each in parts.items()}
        return found if any(len(points.xy_px) for points in found.values()) else None

    def stars_text(self, points: dict[str, PointSources] | None) -> str:
        """The stage in words."""
        if self._scene.stars is None:
            return "skipped: the scene has none"
        if points is None:
            return "skipped: none is in view"
        return f"to magnitude {self._scene.stars.magnitude_limit:g}" + self._scene.stars.aberration * ", aberrated"

    def expose(self, irradiance: np.ndarray, seed: int, exposure_s: float | str, roi: tuple[int, int, int, int],
               points: dict[str, PointSources] | None) -> Frame:
        """The frame. The bodies are grey: a band's image is the drawn one times the Sun's irradiance in the band."""
        options = {"exposure_s": exposure_s, "roi": roi, "margin_px": self._margin_px}
        if not isinstance(self._camera.model, MosaicModel):
            return self._camera.expose(irradiance, seed, points=points and points[""], **options)
        solar = band_irradiances(self._camera.model)
        drawn = self._scene.solar_irradiance_of(self._camera)
        images = {letter: irradiance * np.float32(own / drawn) for letter, own in solar.items()}
        return self._camera.expose(images, seed, points=points, **options)


def _mean(drawing: Drawing, state: State, still: Still,
          motion: Motion) -> tuple[np.ndarray, tuple[int, int, int, int], np.ndarray]:
    """Mean irradiance over each row's exposure, its region, and the weights (rows, poses) of the poses."""
    regions = []

    def images() -> Iterator[np.ndarray]:
        for dt in motion.times_s:
            pose = still if dt == 0.0 else drawing.still(state.after(dt))
            regions.append(pose.roi)
            yield pose.irradiance_W_m2

    n_rows = len(still.irradiance_W_m2)
    # The middle of all rows' exposures is the state's time.
    start_s = -0.5 * (motion.exposure_s + motion.row_s * (n_rows - 1))
    mean = time_average(images(), motion.times_s, start_s=start_s, exposure_s=motion.exposure_s,
                        line_time_s=motion.row_s)
    weights = row_weights(motion.times_s, start_s + motion.row_s * np.arange(n_rows), motion.exposure_s)
    return mean, union([region for region in regions if region[0] < region[2]]), weights


def _without_margin(image: np.ndarray, margin_px: int) -> np.ndarray:
    height, width = image.shape
    return np.ascontiguousarray(image[margin_px:height - margin_px, margin_px:width - margin_px])


def _timings(still: Still, began: float) -> dict[str, float]:
    """The renderer's laps, and what lens, Sun and stars took besides."""
    rest = 1e3 * (time.perf_counter() - began) - sum(still.timings_ms.values())
    return {**still.timings_ms, "lens_and_sky": max(rest, 0.0)}
