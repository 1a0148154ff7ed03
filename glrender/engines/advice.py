"""Warnings of frames that show too little or too much, though nothing is wrong enough to refuse them. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from glrender_camera import CameraModel, Frame, MosaicModel, PinholeCamera
from glrender_camera.exposure import MAX_EXPOSURE_S

from ..base import rotations as frames
from ..base.constants import AU_M
from ..base.plausible import SUN_DISTANCES_AU, Advice
from ..planner.plan import RenderPlan
from ..scene.scene import Scene, band_irradiances
from ..view.plausible import state_doubts
from ..view.state import State
from ..view.view import BodyView, view_bodies

SATURATED_SHARE, SATURATED_LIT_SHARE = 0.5, 0.05
"""Share of a frame's pixels, and of its lit ones, from which on a warning names saturation: an automatic exposure
leaves one in a hundred of the lit ones."""
LEAST_BODY_PX = 1e-3
"""Size of a body [px] below which its unit or range is doubted: missions have seen their targets from 5e-3 px on."""
MIN_LIT_PX = 100
"""Least number of lit pixels for a warning of their share: fewer are a point source, which saturates its few pixels."""
NIGHT_PHASE_DEG = 175.0
"""Phase angle from which on a body shows its night side: a Lambert sphere has 7e-5 of its light at zero phase."""
LIMIT_RATIO = 1.5
"""Least ratio of the exposure that is wanted to the limit that it stopped at, either way, for a warning."""
LEAST_DN = 0.5
"""Signal of the brightest pixel [DN] below which rounding leaves nothing."""
# Rays along each side of the image that look for a body around the camera.
_RAYS = 5
# Rows of an image that are looked at before the whole image is.
_ROWS = 8


def scene_advice(scene: Scene) -> tuple[Advice, ...]:
    """Warnings of the reports of a scene's shapes, and of its cameras' fields, each once."""
    shapes = [Advice("shape", f"bodies[{index}].shape", _printable(f"{body.name}: {text}"))
              for index, body in enumerate(scene.bodies) for text in body.shape.report.warnings]
    return tuple(dict.fromkeys([*shapes, *(advice for found in scene.doubts.values() for advice in found)]))


def image_advice(scene: Scene, state: State, camera: PinholeCamera, plan: RenderPlan, light: np.ndarray,
                 roi: tuple[int, int, int, int], *, region: tuple[int, int, int, int] | None = None,
                 has_points: bool = False, has_stars: bool = False) -> tuple[Advice, ...]:
    """Warnings of an irradiance image, with those of its plan, of its camera's fields and of its state.

    Parameters
    ----------
    scene : Scene
    state : State
    camera : PinholeCamera
    plan : RenderPlan
    light : (height, width) float32 [W/m2]
    roi : (x0, y0, x1, y1) int [px]
        Outside it `light` is zero.
    region : (x0, y0, x1, y1) int [px], optional
        The part that was asked for.
    has_points : bool
        Whether bodies' light comes as points besides.
    has_stars : bool
        Whether the frame has stars, so that it has something to show without a body.
    """
    found = [Advice("plan", "plan.warnings", _printable(text)) for text in plan.warnings]
    found += scene.doubts.get(camera.name, ())
    found += state_doubts(state, scene.hulls) + _distance_advice(scene, state) + _size_advice(state, plan)
    in_view = [body.name for body in plan.bodies if body.is_visible]
    x0, y0, x1, y1 = roi
    if not has_points and not (_some_rows(light[y0:y1, x0:x1]).any() or light[y0:y1, x0:x1].any()):
        if in_view or not has_stars:
            found += _why_dark(scene, state, camera, in_view, region, has_stars)
    elif in_view and not scene.emission and all(_is_night(state, name) for name in in_view):
        name = _printable(in_view[0])
        found.append(_night_side(name, 180.0 - math.degrees(_lit_angle(state, in_view[0]))))
    return tuple(found)


def frame_advice(scene: Scene, camera: PinholeCamera, asked: float | str, frame: Frame, light: np.ndarray,
                 roi: tuple[int, int, int, int], *, has_stars: bool = False,
                 has_sun: bool = False) -> tuple[Advice, ...]:
    """Warnings of a detector's frame: saturation, an exposure at its limit, light that it does not show.

    Parameters
    ----------
    scene : Scene
    camera : PinholeCamera
        With a model.
    asked : float [s] or "auto"
    frame : Frame
    light, roi
        As of `image_advice`: the image that was exposed, before the optics.
    has_stars, has_sun : bool
        Whether stars, or the Sun, are in the frame: bodies before stars are overexposed on purpose.
    """
    x0, y0, x1, y1 = roi
    part = light[y0:y1, x0:x1]
    found = _saturation(scene, camera, frame, part, roi, has_stars, has_sun)
    found += _exposure_limit(camera.model, asked, frame, has_sun)
    if part.size and not found and not has_stars and (
            _signal_DN(scene, camera, frame, _some_rows(part).max()) < LEAST_DN):
        peak = float(part.max())
        signal = _signal_DN(scene, camera, frame, peak)
        if 0.0 < signal < LEAST_DN:
            found.append(Advice("underexposed", "exposure_s", (
                f"the brightest pixel has {signal:.2g} DN in {frame.exposure_s:.3g} s, so that the frame has nothing "
                f"of the bodies; {_fitting_exposure_s(scene, camera, peak, 0.7):.2g} s would put it at 70 % of the "
                'range, as "auto" does')))
    return tuple(found)


def frame_notes(asked: float | str, frame: Frame) -> tuple[Advice, ...]:
    """Notes of a detector's frame: the exposure that "auto" chose."""
    if asked != "auto":
        return ()
    return (Advice("exposure", "exposure_s", f"automatic exposure of {frame.exposure_s:.4g} s"),)


def _some_rows(part: np.ndarray) -> np.ndarray:
    """Rows of an image at even distances, which cost little to look at."""
    return part[:: max(1, len(part) // _ROWS)]


def _printable(text: str) -> str:
    """A text that forges no line of a log, whatever names are in it."""
    return text if text.isprintable() else repr(text)


# Distances


def _distance_advice(scene: Scene, state: State) -> list[Advice]:
    found, r_sun = [], state.r_sun_inertial_m.tolist()
    for body in scene.bodies:
        sun_au = math.dist(r_sun, state.bodies[body.name].r_inertial_m.tolist()) / AU_M
        if not SUN_DISTANCES_AU[0] <= sun_au <= SUN_DISTANCES_AU[1]:
            found.append(Advice("sun_distance", "state.r_sun_inertial_m", (
                f"the Sun is {sun_au:.3g} au from {_printable(body.name)}; check state.r_sun_inertial_m: a position in "
                "metres, from the same origin as the bodies'")))
    return found


def _size_advice(state: State, plan: RenderPlan) -> list[Advice]:
    found = []
    for body in plan.bodies:
        if body.is_visible and body.size_px < LEAST_BODY_PX:
            range_m = math.dist(state.bodies[body.name].r_inertial_m, state.spacecraft.r_inertial_m)
            found.append(Advice("body_size", f"state.bodies.{body.name}.r_inertial_m", (
                f"{_printable(body.name)} is {body.size_px:.2g} px across at a range of {range_m:.3g} m; check its "
                "length_unit (km or m), and that positions are in metres")))
    return found


# Dark images


def _lit_angle(state: State, name: str) -> float:
    """Angle [rad] at a body between the Sun and the point opposite to the spacecraft: 180 deg less the phase."""
    r_body = state.bodies[name].r_inertial_m
    to_sun, away = state.r_sun_inertial_m - r_body, r_body - state.spacecraft.r_inertial_m
    return math.atan2(float(np.linalg.norm(np.cross(to_sun, away))), float(to_sun @ away))


def _is_night(state: State, name: str) -> bool:
    r_body, r_sun, r_camera = (r_m.tolist() for r_m in (
        state.bodies[name].r_inertial_m, state.r_sun_inertial_m, state.spacecraft.r_inertial_m))
    # A cosine is enough to leave by, and the quickest; NumPy is slow with three numbers.
    along = sum((sun - body) * (camera - body) for sun, camera, body in zip(r_sun, r_camera, r_body, strict=True))
    return along < _COS_NIGHT * math.dist(r_sun, r_body) * math.dist(r_camera, r_body)


_COS_NIGHT = math.cos(math.radians(NIGHT_PHASE_DEG))


def _night_side(name: str, phase_deg: float) -> Advice:
    return Advice("night_side", "state.r_sun_inertial_m", (
        f"only the night side of {name} is in view (phase {phase_deg:.3g} deg); check state.r_sun_inertial_m: a "
        "position in metres, from the same origin as the bodies'"))


def _why_dark(scene: Scene, state: State, camera: PinholeCamera, in_view: Sequence[str],
              region: tuple[int, int, int, int] | None, has_stars: bool) -> list[Advice]:
    ideal = camera if camera.distortion is None else replace(camera, distortion=None)
    views = view_bodies(state, ideal, scene.hulls)
    # The image that was drawn may have a margin, or be the region alone; that of a lens is another.
    visible = [view for view in views if (_is_seen(view, camera, scene) if camera.distortion is None
                                          else view.name in in_view)]
    if not visible:
        return [] if has_stars else [_out_of_view(state, camera, views)]
    middle = max(visible, key=_cos_off_axis)
    name = _printable(middle.name)
    if region is not None and middle.name not in in_view:
        return [Advice("out_of_region", "roi", (
            f"nothing of the bodies is in the region {list(map(int, region))} px; the outline of {name} is within "
            f"{_box_text(middle)}"))]
    phase_deg = math.degrees(middle.phase_rad)
    if phase_deg > 90.0:
        return [_night_side(name, phase_deg)]
    return [Advice("dark", f"state.bodies.{name}", (
        f"nothing that is in view of {name} is lit, at a phase of {phase_deg:.3g} deg: it may be in shadow, its own or "
        "another body's, between its parts where the camera looks past it along its +Z, or have an albedo of 0"))]


def _cos_off_axis(view: BodyView) -> float:
    return view.cos_off_axis if view.range_m > 0.0 else 0.0  # in the middle of a ring


def _is_seen(view: BodyView, camera: PinholeCamera, scene: Scene) -> bool:
    """Whether a body is in the image: by a grid of rays if it reaches behind the camera's plane."""
    if view.bounds_px is not None or not view.is_visible:
        return view.is_visible
    x0, y0, x1, y1 = camera.bounds_px
    grid = np.stack(np.meshgrid(np.linspace(x0, x1, _RAYS), np.linspace(y0, y1, _RAYS)), axis=-1).reshape(-1, 2)
    directions = camera.directions(grid) @ view.camera_from_body
    return bool(scene.hulls[view.name].is_met(view.r_camera_body_m, directions).any())


def _box_text(view: BodyView) -> str:
    return "all of the image" if view.bounds_px is None else f"{[round(float(edge), 1) for edge in view.bounds_px]} px"


def _out_of_view(state: State, camera: PinholeCamera, views: Sequence[BodyView]) -> Advice:
    """A warning with the place of the body nearest to the boresight, and the attitude that would have it in view."""
    nearest = max(views, key=_cos_off_axis)
    off_deg = math.degrees(math.acos(min(max(_cos_off_axis(nearest), -1.0), 1.0)))
    is_behind, name = off_deg > 90.0, _printable(nearest.name)
    where = "behind the camera" if is_behind else "out of view"
    seen = f"{name} is {where} ({off_deg:.3g} deg off the boresight"
    if len(views) > 1:
        seen = f"none of the {len(views)} bodies is in view; the nearest to the boresight, {name}, is {where} (" \
               f"{off_deg:.3g} deg off it"
    if not is_behind:
        corners = camera.directions(np.array([[x, y] for x in camera.bounds_px[::2] for y in camera.bounds_px[1::2]]))
        seen += f", where the image reaches {math.degrees(math.acos(float(corners[:, 2].min()))):.3g} deg"
    way_out = "check state.spacecraft.q_from_inertial: the camera looks along its +Z"
    if not np.allclose(np.abs(camera.q_camera_from_spacecraft), (1.0, 0.0, 0.0, 0.0)):
        way_out += ", turned by its q_camera_from_spacecraft"
    if other := _attitude_in_view(state, camera, nearest.name):
        way_out += f"; {other} has it in view"
    return Advice("behind_camera" if is_behind else "out_of_view", "state.spacecraft.q_from_inertial",
                  f"{seen}); {way_out}")


def _attitude_in_view(state: State, camera: PinholeCamera, name: str) -> str:
    """The usual mistake with the spacecraft's quaternion that, once undone, has a body's origin in the image."""
    w, x, y, z = state.spacecraft.q_from_inertial
    meant = {"its conjugate [w, -x, -y, -z], inertial from spacecraft,": (w, -x, -y, -z),
             "read as [x, y, z, w] it": (z, w, x, y),
             "read as [x, y, z, w], its conjugate": (z, -w, -x, -y)}
    to_body = state.bodies[name].r_inertial_m - state.spacecraft.r_inertial_m
    x0, y0, x1, y1 = camera.bounds_px
    for text, q in meant.items():
        seen = frames.dcm(camera.q_camera_from_spacecraft) @ (
            frames.dcm(q) @ to_body - camera.r_camera_spacecraft_m)
        column, row = camera.project(seen)
        if x0 <= column <= x1 and y0 <= row <= y1:
            return text
    return ""


# Detector frames


def _saturation(scene: Scene, camera: PinholeCamera, frame: Frame, part: np.ndarray, roi: tuple[int, int, int, int],
                has_stars: bool, has_sun: bool) -> list[Advice]:
    x0, y0, x1, y1 = roi
    saturated, region, text = frame.saturated, frame.saturated[y0:y1, x0:x1], ""
    some, near = _some_rows(saturated), _some_rows(region)
    # The limits for some rows are half of those for all, so that the whole image decides.
    if np.count_nonzero(some) <= 0.5 * SATURATED_SHARE * some.size and (
            not np.count_nonzero(near) or np.count_nonzero(near & (lit := _some_rows(part) > 0.0))
            <= 0.5 * SATURATED_LIT_SHARE * np.count_nonzero(lit)):
        return []
    count, n_pixels = np.count_nonzero(saturated), saturated.size
    if count > SATURATED_SHARE * n_pixels:
        text = f"all {n_pixels} pixels" if count == n_pixels else f"{count} of {n_pixels} pixels"
    elif count and not has_stars:
        lit = part > 0.0
        n_lit, count = np.count_nonzero(lit), np.count_nonzero(region & lit)
        if n_lit >= MIN_LIT_PX and count > SATURATED_LIT_SHARE * n_lit:
            text = f"{'all' if count == n_lit else f'{count / n_lit:.0%} of'} {n_lit} lit pixels"
    if not text:
        return []
    fitting_s = _fitting_exposure_s(scene, camera, float(part.max(initial=0.0)), 1.0)
    way_out = f"the brightest would fit below {fitting_s:.2g} s"
    if has_sun:
        way_out = "the Sun is in view"
    elif not fitting_s < frame.exposure_s:
        way_out = "by light from outside the image, dark current or cosmic rays, not by the bodies in view"
    return [Advice("saturated", "exposure_s", f"{text} are saturated at an exposure_s of {frame.exposure_s:.3g}; "
                                              f"{way_out}")]


def _exposure_limit(model: CameraModel | MosaicModel, asked: float | str, frame: Frame, has_sun: bool) -> list[Advice]:
    rules, exposure_s = model.auto_exposure, frame.exposure_s
    if "auto" not in (asked, model.exposure_s) or rules.min_s < exposure_s < rules.max_s or rules.min_s == rules.max_s:
        return []
    # A loop that sends the exposure back which the rules gave is at their limit too; one with its own is not.
    if asked != "auto" and exposure_s not in (rules.min_s, rules.max_s):
        return []
    detector, is_long = model.detector, exposure_s >= rules.max_s
    free = replace(rules, min_s=1e-12, max_s=MAX_EXPOSURE_S, max_step=1e6)
    wanted_s = free.after(frame, detector)
    if (wanted_s / rules.max_s if is_long else rules.min_s / wanted_s) < LIMIT_RATIO:
        return []
    full_scale = min(detector.full_well_electrons * detector.gain_DN_per_electron,
                     detector.max_DN - detector.offset_DN)
    level = (float(frame.dn.max()) - detector.offset_DN) / full_scale
    return [Advice("exposure_limit", f"auto_exposure.{'max_s' if is_long else 'min_s'}", (
        f"automatic exposure stays at its limit of {exposure_s:.3g} s: the brightest pixel is at "
        f"{100.0 * min(max(level, 0.0), 1.0):.3g} % of the range; "
        f"{'the Sun is in view' if has_sun else 'check the light in view'}, or set "
        f"auto_exposure.{'max_s' if is_long else 'min_s'}"))]


def _bands(scene: Scene, camera: PinholeCamera) -> list[tuple[CameraModel, float]]:
    """Each band's model, and the irradiance in it [1] over that of the image."""
    model = camera.model
    if not isinstance(model, MosaicModel):
        return [(model, 1.0)]
    drawn = scene.solar_irradiance_of(camera)
    return [(model.bands[letter], own / drawn) for letter, own in band_irradiances(model).items()]


def _signal_DN(scene: Scene, camera: PinholeCamera, frame: Frame, light_W_m2: float) -> float:
    """Number of a pixel with so much light, in the band that has most light, were it unbounded."""
    electrons_s = max(share * band.optics.aperture_area_m2 * band.electrons_per_joule
                      for band, share in _bands(scene, camera))
    return electrons_s * float(light_W_m2) * frame.exposure_s * camera.model.detector.gain_DN_per_electron


def _fitting_exposure_s(scene: Scene, camera: PinholeCamera, light_W_m2: float, target: float) -> float:
    """Exposure [s] that puts a pixel with so much light at a share of the range; before the optics spread it."""
    pixel, detector = np.full((1, 1), light_W_m2, np.float32), camera.model.detector
    rules = replace(camera.model.auto_exposure, percentile=100.0, target=target, min_s=1e-12, max_s=MAX_EXPOSURE_S)
    return min(rules.of_irradiance(share * pixel, band.optics.aperture_area_m2 * band.electrons_per_joule, detector)
               for band, share in _bands(scene, camera))
