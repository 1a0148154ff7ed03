"""Warnings of scenes and of images that show nothing, though nothing is wrong enough to refuse them. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from glrender_camera import PinholeCamera

from ..base import rotations as frames
from ..base.constants import AU_M
from ..base.plausible import SUN_DISTANCES_AU, Advice
from ..planner.plan import RenderPlan
from ..scene.scene import Scene
from ..view.plausible import state_doubts
from ..view.state import State
from ..view.view import BodyView, view_bodies

LEAST_BODY_PX = 1e-3
"""Size of a body [px] below which its unit or range is doubted: missions have seen their targets from 5e-3 px on."""
LEAST_CONE_PX = 4.0
"""Width [px] of a lamp's cone from which the flux of a spot on a plane is within 1 % at 2 % RMS: -100 % at 0.3."""
NIGHT_PHASE_DEG = 175.0
"""Phase angle from which on a body shows its night side: a Lambert sphere has 7e-5 of its light at zero phase."""
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
    found += _narrow_cones(scene, camera)
    found += state_doubts(state, scene.hulls) + _distance_advice(scene, state) + _size_advice(state, plan)
    in_view = [body.name for body in plan.bodies if body.is_visible]
    x0, y0, x1, y1 = roi
    is_dark = not has_points and not (some_rows(light[y0:y1, x0:x1]).any() or light[y0:y1, x0:x1].any())
    if behind := _behind_ground(scene, state, camera, {body.name: is_dark or math.isinf(body.size_px)
                                                       for body in plan.bodies if body.is_visible}):
        found += behind
    elif is_dark:
        # Most of the light by areas is missed, or rays do not know that there is none.
        if in_view and 2.0 * plan.predicted_error > 1.0 and not all(_is_night(state, name) for name in in_view):
            found.append(Advice("dark", "max_error", (
                f"no sample met light, and its predicted error is {plan.predicted_error:.2g}: what is lit of "
                f"{_printable(in_view[0])} may be narrower than samples are apart; give max_error in place of samples, "
                "or a smaller one")))
        elif in_view or not has_stars:
            found += _why_dark(scene, state, camera, in_view, region, has_stars)
    elif in_view and not scene.emission and not scene.lamps and all(_is_night(state, name) for name in in_view):
        name = _printable(in_view[0])
        found.append(_night_side(name, 180.0 - math.degrees(_lit_angle(state, in_view[0]))))
    return tuple(found)


def some_rows(part: np.ndarray) -> np.ndarray:
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


def _narrow_cones(scene: Scene, camera: PinholeCamera) -> list[Advice]:
    across_px = [2.0 * camera.focal_length_px * math.tan(math.radians(lamp.half_angle_deg)) for lamp in scene.lamps]
    return [Advice("lamp_cone", f"lamps.{_printable(lamp.name)}.half_angle_deg", (
        f"the cone of {_printable(lamp.name)} is {each:.2g} px wide on what is as far from it as from the camera, and "
        f"samples miss some of its light below {LEAST_CONE_PX:g} px; widen half_angle_deg, or take a longer focal "
        "length")) for lamp, each in zip(scene.lamps, across_px, strict=True) if 0.0 < each < LEAST_CONE_PX]


def _behind_ground(scene: Scene, state: State, camera: PinholeCamera, is_doubted: Mapping[str, bool]) -> list[Advice]:
    """Warnings of rooms in view, and of doubted open shells, whose nearest facets turn away from the camera."""
    bodies = [body for body in scene.bodies if body.name in is_doubted and (
        body.shape.inside or is_doubted[body.name] and not body.shape.report.is_watertight)]
    if not bodies:
        return []
    place_m = {view.name: view.r_camera_body_m
               for view in view_bodies(state, camera.without_distortion, scene.hulls)}
    return [Advice("behind_ground", "state.spacecraft.r_inertial_m", (
        f"the camera is {'outside the room' if body.shape.inside else 'behind the ground of'} {_printable(body.name)}, "
        f"or {'in its walls' if body.shape.inside else 'under it'}: the facets nearest to it turn their backs, which "
        "nobody sees; check state.spacecraft.r_inertial_m, or wind the facets the other way"))
        for body in bodies if body.hull.is_behind(place_m[body.name])]


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
    views = view_bodies(state, camera.without_distortion, scene.hulls)
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
    if not scene.lamps and any(body.shape.inside for body in scene.bodies if body.name == middle.name):
        return [Advice("dark", "lamps", f"no sunlight is on the inside of {name}; give the scene a lamp")]
    if phase_deg > 90.0 and not scene.lamps:
        return [_night_side(name, phase_deg)]
    beyond = "out of the lamps' cones, " if scene.lamps else ""
    return [Advice("dark", f"state.bodies.{name}", (
        f"nothing that is in view of {name} is lit, at a phase of {phase_deg:.3g} deg: it may be in shadow, its own or "
        f"another body's, {beyond}between its parts where the camera looks past it along its +Z, or have an albedo of "
        "0"))]


def _cos_off_axis(view: BodyView) -> float:
    """Cosine of the angle between a body's origin and the boresight; 0 in the middle of a ring."""
    return -float(view.camera_from_body[2] @ view.r_camera_body_m) / view.range_m if view.range_m > 0.0 else 0.0


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
        seen += f", where the image reaches {math.degrees(math.acos(camera.least_cosine)):.3g} deg"
    way_out = "check state.spacecraft.q_from_inertial: the camera looks along its +Z"
    if not np.allclose(np.abs(camera.q_camera_from_spacecraft), (1.0, 0.0, 0.0, 0.0)):
        way_out += ", turned by its q_camera_from_spacecraft"
    cx, cy = camera.principal_point_px
    if not (-0.5 <= cx <= camera.width_px - 0.5 and -0.5 <= cy <= camera.height_px - 0.5):
        way_out += f", and its principal_point_px, [{cx:g}, {cy:g}], is outside the image"
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
