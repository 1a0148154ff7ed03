"""Geometry of the bodies of a state before a camera, in float64, the camera's position subtracted first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import did_you_mean

from ..base import rotations as frames
from ..base.constants import AU_M, SUN_RADIUS_M
from ..base.errors import ConfigError, SceneError
from ..scene.lamp import ALL_ROUND_DEG, FAINT, Lamp
from ..scene.shape.convex_hull import Hull
from .plausible import sun_way_out
from .state import State

FINE_FOOTPRINT = 1e-5
"""Side of a pixel's footprint, in radii, below which rays need coordinates about the camera: a round choice, of 170
float32 steps."""
# The outline's edges, float64 pixel coordinates, are then good to 1e-4 of its size.
_MIN_SIZE_PX = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyView:
    """One body as one camera sees it.

    Attributes
    ----------
    camera_from_body : (3, 3) float64
    r_camera_body_m : (3,) float64 [m]
        The camera, body-fixed, about the origin.
    sun_direction_body : (3,) float64 [1]
        Towards the Sun.
    sun_distance_au : float [au]
    range_m : float [m]
        Camera to the origin.
    phase_rad : float [rad]
        At the origin.
    depth_m : (float, float) [m]
        Nearest and farthest depth along the boresight; both > 0.
    bounds_px : (4,) float64 [px] or None
        x0, y0, x1, y1 of the outline, `pixel` frame; None when part of the body is in the camera's plane or
        behind the camera, so that it may fill any of the image.
    is_visible : bool
        Whether any part may be in the image.
    is_whole : bool
        Whether the whole body is.
    footprint_m : float [m]
        Side of what a pixel sees of its nearest point.
    centre_m : (3,) float64 [m]
        `Shape.centre_m`: in the body's frame, the origin of all places here. Zero but for shapes far from their own.
    """

    name: str
    camera_from_body: np.ndarray
    r_camera_body_m: np.ndarray
    sun_direction_body: np.ndarray
    sun_distance_au: float
    range_m: float
    phase_rad: float
    depth_m: tuple[float, float]
    bounds_px: np.ndarray | None
    is_visible: bool
    is_whole: bool
    footprint_m: float = np.inf
    centre_m: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @cached_property
    def size_px(self) -> float:
        """Larger side of the outline's box [px]; infinite when it has none."""
        return np.inf if self.bounds_px is None else float(np.max(self.bounds_px[2:] - self.bounds_px[:2]))

    @property
    def sun_radius_rad(self) -> float:
        """Angular radius of the Sun: its sine, from which it differs by 4e-6 of itself at 1 au."""
        return SUN_RADIUS_M / (self.sun_distance_au * AU_M)

    @property
    def finest_px(self) -> float:
        """Size [px] of the body if all were as near as its nearest point: a shadow map must resolve this."""
        near, far = self.depth_m
        return min(self.size_px * 0.5 * (near + far) / near, 1e5)


def _is_within(box: np.ndarray | None, bounds_px: tuple[float, float, float, float]) -> bool:
    x0, y0, x1, y1 = bounds_px
    return box is not None and bool(x0 <= box[0] and y0 <= box[1] and box[2] <= x1 and box[3] <= y1)


def between(view: BodyView, other: BodyView) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and shift (3,) [m] from a body's frame to another's."""
    if other is view:
        return np.eye(3), np.zeros(3)
    rotation = other.camera_from_body.T @ view.camera_from_body
    return rotation, other.r_camera_body_m - rotation @ view.r_camera_body_m


def lamp_in(view: BodyView, lamp: Lamp, camera: PinholeCamera) -> tuple[np.ndarray, np.ndarray]:
    """Place (3,) [m] and direction (3,) of a lamp in a body's frame, about the origin of a view's places."""
    body_from_spacecraft = view.camera_from_body.T @ frames.dcm(camera.q_camera_from_spacecraft)
    aside_m = lamp.r_spacecraft_m - camera.r_camera_spacecraft_m
    return view.r_camera_body_m + body_from_spacecraft @ aside_m, body_from_spacecraft @ lamp.direction


def largest_phase(view: BodyView, lamps: Sequence[Lamp], camera: PinholeCamera, solar_W_m2: float) -> float:
    """Largest phase angle [rad] of the lights, the Sun and lamps, of which a Lambert sphere there sends a part at all.

    Parameters
    ----------
    view : BodyView
    lamps : sequence of Lamp
    camera : PinholeCamera
    solar_W_m2 : float [W/m2]
        At 1 au.
    """
    lights, to_camera = [(solar_W_m2 / view.sun_distance_au**2, view.phase_rad)], view.r_camera_body_m / view.range_m
    for lamp in lamps:
        place_m, axis = lamp_in(view, lamp, camera)
        distance_m = max(float(np.linalg.norm(place_m)), 1e-9)
        if lamp.half_angle_deg == ALL_ROUND_DEG or axis @ place_m <= -lamp.least_cosine * distance_m:
            phase_rad = float(frames.angle_between(place_m / distance_m, to_camera))
            lights.append((lamp.intensity_W_sr / distance_m**2, phase_rad))
    # Russell (1916), of a Lambert sphere.
    sent = [light_W_m2 * (math.sin(phase) + (math.pi - phase) * math.cos(phase)) for light_W_m2, phase in lights]
    return max(phase for (_, phase), each in zip(lights, sent, strict=True) if each >= FAINT * max(sent))


def view_bodies(state: State, camera: PinholeCamera, hulls: dict[str, Hull]) -> list[BodyView]:
    """Views of all bodies of a scene.

    Parameters
    ----------
    state : State
    camera : PinholeCamera
    hulls : dict
        Body name to its Hull, in the scene's order.

    Raises
    ------
    ConfigError
        A value that is no State.
    SceneError
        A body that the state lacks or the scene does not know, a camera or a Sun inside a body,
        a visible body of less than 1e-9 px.
    """
    if not isinstance(state, State):
        raise ConfigError("state", "must be a State", state, "State.from_dict makes one of a dictionary")
    for name in state.bodies:
        if name not in hulls:
            raise SceneError(f"state.bodies.{name}", "unknown body",
                             hint=did_you_mean(name, hulls) or f"the scene has {', '.join(hulls)}")
    for name in hulls:
        if name not in state.bodies:
            raise SceneError(f"state.bodies.{name}", "missing", hint="give the pose of every body of the scene")
    spacecraft_from_inertial, camera_from_spacecraft, *bodies_from_inertial = frames.dcm(np.array(
        [state.spacecraft.q_from_inertial, camera.q_camera_from_spacecraft,
         *(state.bodies[name].q_from_inertial for name in hulls)]))
    camera_from_inertial = camera_from_spacecraft @ spacecraft_from_inertial
    r_camera_inertial_m = state.spacecraft.r_inertial_m + spacecraft_from_inertial.T @ camera.r_camera_spacecraft_m
    return [_view(name, hull, state, camera, camera_from_inertial, r_camera_inertial_m, body_from_inertial)
            for (name, hull), body_from_inertial in zip(hulls.items(), bodies_from_inertial, strict=True)]


def _view(name: str, hull: Hull, state: State, camera: PinholeCamera, camera_from_inertial: np.ndarray,
          r_camera_inertial_m: np.ndarray, body_from_inertial: np.ndarray) -> BodyView:
    pose = state.bodies[name]
    r_camera = body_from_inertial @ (r_camera_inertial_m - pose.r_inertial_m) - hull.centre_m
    r_sun = body_from_inertial @ (state.r_sun_inertial_m - pose.r_inertial_m) - hull.centre_m
    sun_distance, range_m = float(np.linalg.norm(r_sun)), float(np.linalg.norm(r_camera))
    if not sun_distance > hull.radius_m:
        raise SceneError("state.r_sun_inertial_m", f"must be outside body {name!r}",
                         state.r_sun_inertial_m.tolist(), sun_way_out(state.r_sun_inertial_m))
    if not sun_distance > SUN_RADIUS_M:
        raise SceneError("state.r_sun_inertial_m", f"must be at least a solar radius, {SUN_RADIUS_M:g} m, from body "
                         f"{name!r}", state.r_sun_inertial_m.tolist(), sun_way_out(state.r_sun_inertial_m))
    if not hull.is_outside(r_camera):
        raise SceneError("state.spacecraft.r_inertial_m", f"the camera must be outside body {name!r}",
                         state.spacecraft.r_inertial_m.tolist(), f"it is {range_m:.6g} m from the body's origin, and "
                         f"the body reaches {hull.radius_m:.6g} m: is its length unit right?")
    sun_direction = r_sun / sun_distance
    camera_from_body = camera_from_inertial @ body_from_inertial.T
    points = camera_from_body @ (hull.points_m - r_camera[:, None])
    depth = points[2]
    nearest, farthest = float(depth.min()), float(depth.max())
    bounds, edge = None, np.array([camera.width_px, camera.height_px]) - 0.5
    if nearest > 0.0:
        across = points[:2] / depth
        if camera.lens_map is not None:
            bounds = camera.lens_map.box_px(across)
        else:
            bounds = np.concatenate([edges * camera.focal_length_px + np.array(camera.principal_point_px)
                                     for edges in (across.min(axis=1), across.max(axis=1))])
        is_visible = bool((bounds[:2] < edge).all() and (bounds[2:] > -0.5).all())
        if is_visible and not (bounds[2:] - bounds[:2]).max() > _MIN_SIZE_PX:
            raise SceneError("state.spacecraft.r_inertial_m", f"body {name!r} must be {_MIN_SIZE_PX:g} px across",
                             state.spacecraft.r_inertial_m.tolist(), f"it is less at {range_m:.6g} m")
    else:
        is_visible = farthest > 0.0
        # Depth is range times the cosine off the boresight: least in the image's corner.
        nearest = hull.distance_m(r_camera) * camera.least_cosine
    finest_px = camera.focal_length_px * (1.0 if camera.lens_map is None else camera.lens_map.stretch)
    # At the origin of open terrain any direction and range do, by which others divide.
    to_camera, range_m = (r_camera / range_m, range_m) if range_m > 0.0 else (sun_direction, hull.radius_m)
    return BodyView(
        name=name, camera_from_body=camera_from_body, r_camera_body_m=r_camera, sun_direction_body=sun_direction,
        sun_distance_au=sun_distance / AU_M, range_m=range_m,
        phase_rad=float(frames.angle_between(sun_direction, to_camera)),
        depth_m=(nearest, farthest), bounds_px=bounds, is_visible=is_visible,
        is_whole=_is_within(bounds, camera.bounds_px), footprint_m=nearest / finest_px,
        centre_m=hull.centre_m)
