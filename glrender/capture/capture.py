"""From a state to a camera's frame: the one chain that server, command line and users share.

    bodies → distortion → mean over the exposure → the camera model (point spread, stars, detector)

Stages that a scene does not need are skipped, and `stages` says so.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from glrender_camera import Frame, PinholeCamera, time_average
from glrender_camera.camera import checked_exposure
from glrender_camera.faults.frame_faults import FrameFaults, checked_faults
from glrender_camera.notebook import png
from glrender_camera.shutter import row_weights

from ..base.errors import ConfigError, SceneError
from ..base.plausible import Advice
from ..engines.advice import image_advice
from ..engines.derivatives.jacobian import Jacobian
from ..planner.plan import RenderPlan
from ..scene.scene import Scene
from ..view.regions import union
from ..view.state import State
from .frame_advice import frame_advice, frame_notes
from .frame_derivatives import check_still, of_digital_numbers, without_margin
from .motion_blur import STILL, Motion, checked_sub_states, given_motion, plan_motion
from .motion_path import moves
from .off_axis_light import light_beyond
from .outputs import checked_output
from .sensor import PosePoints, Sensor, with_points
from .static_exposure import Drawing, Still, is_resampled, lens_margin, margin_of

# Poses of a motion whose light from beyond the image is followed: a wing is wide.
_BEYOND_POSES = 9


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """The frame of a camera at a state.

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
        The plan of the image at `t_s`: its pixels are the frame's, or those of the margin and the oversampled
        rectilinear image that `stages` describe.
    stages : dict of str to str
        Each stage between the bodies and the digital numbers: how it was modelled, or why it was skipped.
    timings_ms : dict of str to float
    warnings : tuple of Advice
        Warnings: nothing in view or lit, saturation, an exposure at its limit; the plan's warnings.
    notes : tuple of Advice
        Notes: the exposure that "auto" chose.
    jacobian : Jacobian, optional
        Derivatives by the parameters that were asked for: with a frame of its mean digital numbers [DN], through the
        point spread function, stray light, exposure and gain; else of the irradiance.
    """

    irradiance_W_m2: np.ndarray
    products: dict[str, np.ndarray]
    frame: Frame | None
    plan: RenderPlan
    stages: dict[str, str]
    timings_ms: dict[str, float]
    warnings: tuple[Advice, ...] = ()
    notes: tuple[Advice, ...] = ()
    jacobian: Jacobian | None = None

    def __repr__(self) -> str:
        height, width = self.irradiance_W_m2.shape
        return (f"<Capture {self.plan.camera} {width} x {height} px, predicted RMS error "
                f"{self.plan.predicted_error:.2%}, {self.frame or 'irradiance alone'}, {len(self.warnings)} warnings>")

    def _repr_png_(self) -> bytes:
        """For notebooks: the digital numbers in grey, or the irradiance of what has none."""
        return png(self.irradiance_W_m2) if self.frame is None else self.frame._repr_png_()


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Exposed(Capture):
    """A capture with its frame, as `take_frame` gives it."""

    frame: Frame


def draw_still(renderer: Any, state: State, camera: str | None = None, *, products: Iterable[str] = (),
               roi: tuple[int, int, int, int] | None = None, **options: Any) -> Capture:
    """The irradiance image of a camera, distorted as its lens does it.

    Parameters
    ----------
    renderer
        A renderer of `glrender.open_renderer`.
    state : State
    camera : str, optional
        Name; the scene's only camera by default.
    products
        As of `Renderer.render`.
    roi : (x0, y0, x1, y1) int [px], optional
        The part that is asked for, one past the last: no other is drawn where there is no coma, and the rest of the
        arrays is dark. The tolerance is held in it, with samples that the planner chose for it alone.
    **options
        `max_error`, `samples`, `on_progress`, `out`, and the renderer's own (`Backend.options`, as `derivatives`); one
        that takes no `on_progress` or `out` is not given it.

    Raises
    ------
    SceneError, ConfigError
    """
    pinhole = renderer.scene.camera(camera)
    began, margin_px = time.perf_counter(), lens_margin(pinhole) if is_resampled(renderer, pinhole) else 0
    drawing = Drawing(renderer, pinhole, margin_px, False, roi=None if renderer.scene.emission else roi, **options)
    still = drawing.still(state, products)
    light = _without_margin(still.irradiance_W_m2, margin_px)
    warnings = image_advice(renderer.scene, state, pinhole, still.plan, light, _in_frame(still.roi, margin_px, pinhole),
                            region=roi)
    timings = _timings(still, began)
    return Capture(irradiance_W_m2=light, products=still.products, frame=None, timings_ms=timings, warnings=warnings,
                   plan=replace(still.plan, milliseconds=sum(timings.values())),
                   jacobian=still.jacobian and without_margin(still.jacobian, margin_px, pinhole),
                   stages={"distortion": drawing.distortion_text, "region": drawing.region_text})


def take_frame(renderer: Any, state: State, camera: str | None = None, *, seed: int = 0,
               exposure_s: float | str | None = None, previous: Frame | None = None, products: Iterable[str] = (),
               sub_states: Sequence[State] = (), faults: Sequence[Any] | None = None, **options: Any) -> Exposed:
    """The frame that a camera with a model sends.

    Parameters
    ----------
    renderer
        A renderer of `glrender.open_renderer`.
    state : State
        At the middle of the exposure. What moves is blurred: along the course of a scenario's state, at the rates of
        others.
    camera : str, optional
        Name; the scene's only camera by default.
    seed : int, 0..2**64 - 1
        Seed of the temporal noise.
    exposure_s : float [s] > 0 or "auto", optional
        Default is the model's. "auto" meters the light of `state`, standing still.
    previous : Frame, optional
        This camera's last frame: an automatic exposure is then what that one asks for, as on board.
    products
        As of `Renderer.render`.
    sub_states : sequence of State
        Poses during the exposure, of rising `t_s` that spans it, around `state.t_s`: drawn instead of those that
        rates would make; the light is linear in time between them.
    faults : sequence of tables, optional
        Instead of the model's (docs/camera_model.md); empty for none. `frame.faults` has their places.
    **options
        As of `draw_still`, but for `out`; the tolerance holds after the point spread function. A frame is that of the
        whole detector: there is no `roi`, and each pose has its own image.

    Returns
    -------
    Exposed

    Raises
    ------
    SceneError, ConfigError
        Also for a camera without a model.
    """
    scene: Scene = renderer.scene
    pinhole = scene.camera(camera)
    checked_output("dn", pinhole)
    model: Any = pinhole.model
    for name in ("roi", "out"):
        if name in options:
            raise ConfigError(name, "is of draw_still alone: light is spread over the whole frame", options[name])
    exposure: Any = checked_exposure("exposure_s", model.exposure_s if exposure_s is None else exposure_s)
    asked = exposure
    if exposure == "auto" and previous is not None:
        exposure = model.auto_exposure.after(previous, model.detector)
    faults = model.faults if faults is None else checked_faults("faults", faults)
    if stuck_s := FrameFaults(faults, pinhole.noise_seed(seed), model.detector.sensor_seed).exposure_s:
        asked = exposure = stuck_s
    began = time.perf_counter()
    sub_states = checked_sub_states(sub_states)
    n_rows, row_s = pinhole.height_px, model.detector.rolling_shutter_row_s
    longest_s = model.auto_exposure.max_s if exposure == "auto" else exposure
    is_moving = bool(sub_states) or _moves(state, 0.5 * (longest_s + abs(row_s) * n_rows))
    if options.get("derivatives"):
        check_still(pinhole, is_moving)
    margin_px, margin_text = margin_of(renderer, state, pinhole, is_moving)
    drawing = Drawing(renderer, pinhole, margin_px, True, exposure, **options)
    sensor = Sensor(scene, pinhole, margin_px)
    n_rows += 2 * margin_px
    planned = lambda exposure_s: (  # noqa: E731
        given_motion(state, sub_states, exposure_s, row_s, n_rows) if sub_states else
        plan_motion(scene, state, pinhole, exposure_s, row_s, margin_px))
    motion = planned(exposure) if is_moving and exposure != "auto" else STILL
    # How many poses an exposure takes that is metered first is not known: then the first counts as half of all.
    first = 0.5 if is_moving and exposure == "auto" else 1.0 / _n_drawn(state, motion)
    still = drawing.still(state, products, (0.0, first))
    irradiance, roi = still.irradiance_W_m2, still.roi
    poses = [PosePoints(state=state, bodies=still.points)]
    beyond, beyond_text = light_beyond(renderer, pinhole, margin_px, [(state, still.apart, 1.0)])
    bodies, stars = sensor.bodies(poses), sensor.stars(poses)
    timings = _timings(still, began)
    if is_moving:
        moved = time.perf_counter()
        if exposure == "auto":
            exposure = sensor.expose(irradiance, seed, exposure, roi, [bodies, beyond], stars, ()).exposure_s
            motion = planned(exposure)
        if not motion.is_still:
            irradiance, roi, poses, apart = _mean(drawing, state, still, motion, first)
            beyond, beyond_text = light_beyond(renderer, pinhole, margin_px, _some(poses, apart))
            bodies, stars = sensor.bodies(poses), sensor.stars(poses)
        timings["motion_blur"] = 1e3 * (time.perf_counter() - moved)
    drawing.progress.finish()
    exposed = time.perf_counter()
    frame = sensor.expose(irradiance, seed, exposure, roi, [bodies, beyond], stars, faults)
    timings["camera"] = 1e3 * (time.perf_counter() - exposed)
    stages = {"distortion": drawing.distortion_text, "margin": margin_text, "motion_blur": motion.text,
              "sun": still.sun_text, "stars": sensor.stars_text(), "beyond": beyond_text,
              **sensor.told(frame, still.n_small)}
    light, lit = with_points(_without_margin(irradiance, margin_px), bodies), _in_frame(roi, margin_px, pinhole)
    has_stars, has_sun = any(len(points.xy_px) for points in stars.values()), still.sun_text == "in view"
    warnings = (*image_advice(scene, state, pinhole, still.plan, light, lit,
                              has_points=bool(bodies.irradiance_W_m2.any()), has_stars=has_stars),
                *frame_advice(scene, pinhole, asked, frame, light, lit, has_stars=has_stars, has_sun=has_sun))
    if motion.warning:
        warnings = (*warnings, Advice("motion", "exposure_s", motion.warning))
    return Exposed(irradiance_W_m2=light, products=still.products, frame=replace(frame, stages=stages),
                   plan=replace(still.plan, milliseconds=sum(timings.values())), stages=stages, timings_ms=timings,
                   warnings=warnings, notes=frame_notes(asked, frame),
                   jacobian=still.jacobian and of_digital_numbers(still.jacobian, pinhole, margin_px, frame))


def _n_drawn(state: State, motion: Motion) -> int:
    """Poses that are drawn, the state's own among them."""
    return 1 if motion.is_still else len(motion.states) + (0 if state in motion.states else 1)


def _moves(state: State, half_s: float) -> bool:
    """Whether the state moves so long about its time; where its course does not know, plan_motion says so."""
    try:
        return moves(state, half_s)
    except (ConfigError, SceneError):
        return True


def _mean(drawing: Drawing, state: State, still: Still, motion: Motion,
          done: float) -> tuple[np.ndarray, tuple[int, int, int, int], list[PosePoints], list[frozenset[str]]]:
    """Mean irradiance over each row's exposure, its region, and the poses' points; `done` says how far it is."""
    regions, points, apart, states = [], [], [], motion.states
    shares = pairwise(np.linspace(done, 1.0, _n_drawn(state, motion)).tolist())

    def images() -> Iterator[np.ndarray]:
        for each in states:
            pose = still if each is state else drawing.still(each, part=next(shares))
            regions.append(pose.roi)
            points.append(pose.points)
            apart.append(pose.apart)
            yield pose.irradiance_W_m2

    n_rows = len(still.irradiance_W_m2)
    # The middle of all rows' exposures is the state's time.
    start_s = -0.5 * (motion.exposure_s + motion.row_s * (n_rows - 1))
    mean = time_average(images(), motion.times_s, start_s=start_s, exposure_s=motion.exposure_s,
                        line_time_s=motion.row_s)
    weights = row_weights(motion.times_s, start_s + motion.row_s * np.arange(n_rows), motion.exposure_s)
    poses = [PosePoints(state=pose, bodies=each, row_weights=weight)
             for pose, each, weight in zip(states, points, weights.T, strict=True)]
    return mean, union([region for region in regions if region[0] < region[2]]), poses, apart


def _some(poses: Sequence[PosePoints], apart: Sequence[frozenset[str]]) -> list[tuple[State, frozenset[str], float]]:
    """A few of the poses, each with the weight of those nearest to it in the mean over the image's rows."""
    weight = np.array([1.0 if pose.row_weights is None else pose.row_weights.mean() for pose in poses])
    chosen = np.unique(np.rint(np.linspace(0, len(poses) - 1, min(len(poses), _BEYOND_POSES))).astype(int))
    nearest = np.abs(np.arange(len(poses))[:, None] - chosen).argmin(axis=1)
    shares = np.bincount(nearest, weight, len(chosen)).tolist()
    return [(poses[k].state, apart[k], share) for k, share in zip(chosen, shares, strict=True)]


def _without_margin(image: np.ndarray, margin_px: int) -> np.ndarray:
    height, width = image.shape
    return np.ascontiguousarray(image[margin_px:height - margin_px, margin_px:width - margin_px])


def _in_frame(roi: tuple[int, int, int, int], margin_px: int, camera: PinholeCamera) -> tuple[int, int, int, int]:
    """A region of the image with its margin, of the frame alone."""
    sizes = 2 * (camera.width_px, camera.height_px)
    x0, y0, x1, y1 = (min(max(edge - margin_px, 0), size) for edge, size in zip(roi, sizes, strict=True))
    return x0, y0, x1, y1


def _timings(still: Still, began: float) -> dict[str, float]:
    """The renderer's laps, and the time that lens, Sun and stars took besides."""
    rest = 1e3 * (time.perf_counter() - began) - sum(still.timings_ms.values())
    return {**still.timings_ms, "lens_and_sky": max(rest, 0.0)}
