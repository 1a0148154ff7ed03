"""Motion during an exposure: its length in the image, and the times at which poses are drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from glrender_camera import PinholeCamera

from ..base import rotations as frames
from ..base.errors import ConfigError
from ..scene.scene import Scene
from ..scene.shape.convex_hull import Hull
from ..view.state import Pose, State
from ..view.view import BodyView, view_bodies
from .sky_background import Place

# Light is linear in time between poses: half a pixel apart they widen a blurred edge by 0.04 px2.
_STEP_PX = 0.5
MAX_POSES = 65
"""Most poses of a frame: 32 pixels of motion at half a pixel; longer motion is drawn in longer steps, and told."""
MAX_GIVEN_POSES = 257
"""Most poses of a frame, where a request gives them."""
# A frame that moves by less stands still: the blur of 0.05 px adds 2e-4 px2 to any point spread function.
_STILL_PX = 0.05
# Turn between the instants at which a path is measured, about; and how many there are at most.
_INSTANT_RAD, _MOST_INSTANTS = 0.8, 129


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Times (N,) [s] of the poses to draw, after the state's; and what they are, in words.

    `states` are those poses where they are given; otherwise the state's rates make them, N odd, 0 in the middle.
    """

    times_s: np.ndarray
    text: str
    exposure_s: float = 0.0
    row_s: float = 0.0
    states: tuple[State, ...] = ()

    @property
    def is_still(self) -> bool:
        """Whether one pose is enough."""
        return len(self.times_s) == 1


    def poses(self, state: State) -> list[State]:
        """The states to draw."""
        return list(self.states) or [state.after(dt) for dt in self.times_s]


STILL = Motion(times_s=np.zeros(1), text="skipped: the state has no rates")


def checked_sub_states(value: object) -> tuple[State, ...]:
    """Check `sub_states`: none, or 2 to 257 states of rising `t_s`.

    Raises
    ------
    ConfigError
    """
    if not isinstance(value, Sequence) or not all(isinstance(each, State) for each in value):
        raise ConfigError("sub_states", "must be a list of State", value)
    if len(value) == 1 or len(value) > MAX_GIVEN_POSES:
        raise ConfigError("sub_states", f"must be 2 to {MAX_GIVEN_POSES} states, or none", len(value))
    times = [each.t_s for each in value]
    if any(not a < b for a, b in pairwise(times)):
        raise ConfigError("sub_states", "t_s must rise", times[:8])
    return tuple(value)


def given_motion(state: State, sub_states: tuple[State, ...], exposure_s: float, row_s: float, n_rows: int) -> Motion:
    """The poses of a simulation instead of rates: their light is linear in time between them.

    Parameters
    ----------
    state : State
        At the middle of all rows' exposures.
    sub_states : tuple of State
        Of `checked_sub_states`; must span the exposures of all rows.
    exposure_s, row_s : float [s]
    n_rows : int
        Of the image with its margin.

    Raises
    ------
    ConfigError
    """
    times = np.array([each.t_s - state.t_s for each in sub_states])
    half_s = 0.5 * (exposure_s + abs(row_s) * (n_rows - 1))
    # t_s may be seconds of decades: float64 then has 1e-7 s.
    slack = 1e-9 * half_s + 4.0 * np.spacing(abs(state.t_s))
    if times[0] > -half_s + slack or times[-1] < half_s - slack:
        raise ConfigError("sub_states", f"t_s must span {state.t_s - half_s:.9g} to {state.t_s + half_s:.9g} s, the "
                          "exposures of all rows", (sub_states[0].t_s, sub_states[-1].t_s))
    times[0], times[-1] = min(times[0], -half_s), max(times[-1], half_s)
    return Motion(times_s=times, text=f"{len(times)} poses as given, over {2.0 * half_s:.3g} s",
                  exposure_s=exposure_s, row_s=row_s, states=sub_states)


def plan_motion(scene: Scene, state: State, camera: PinholeCamera, exposure_s: float, row_s: float,
                margin_px: int) -> Motion:
    """Choose the poses of a frame from the rates of its state.

    Parameters
    ----------
    scene : Scene
    state : State
        At the middle of the frame's exposure: of all its rows, where the shutter rolls.
    camera : PinholeCamera
        One of the scene's.
    exposure_s : float [s]
    row_s : float [s]
        Delay from row to row.
    margin_px : int [px]
        Rows that are drawn beyond the frame.
    """
    half_s = 0.5 * (exposure_s + abs(row_s) * (camera.height_px - 1 + 2 * margin_px))
    path_px = motion_px(scene, state, camera.with_margin(margin_px), half_s)
    if path_px < _STILL_PX:
        return Motion(times_s=np.zeros(1), text=f"skipped: {path_px:.2g} px of motion")
    # An odd number: the middle one is the state itself.
    n_poses = min(2 * math.ceil(0.5 * path_px / _STEP_PX) + 1, MAX_POSES)
    step_px = path_px / (n_poses - 1)
    bounded = "" if step_px <= _STEP_PX else f", at most {MAX_POSES} are drawn: {step_px:.2g} px from pose to pose"
    times = np.linspace(-half_s, half_s, n_poses)
    times[n_poses // 2] = 0.0
    return Motion(times_s=times, text=f"{n_poses} poses, {path_px:.3g} px in {2.0 * half_s:.3g} s{bounded}",
                  exposure_s=exposure_s, row_s=row_s)


def motion_px(scene: Scene, state: State, camera: PinholeCamera, half_s: float) -> float:
    """Longest path [px] in the image, of bodies and sky, from `half_s` before the state to `half_s` after it."""
    # A turn between two instants is a chord; of whole turns it would be nothing.
    turn_rad = 2.0 * half_s * max(
        0.0 if pose.angular_velocity_rad_s is None else float(np.linalg.norm(pose.angular_velocity_rad_s))
        for pose in (state.spacecraft, *state.bodies.values()))
    corners = np.array([[x, y] for x in (0, camera.width_px - 1) for y in (0, camera.height_px - 1)])
    rays = camera.directions(corners)
    longest, moving = 0.0, []
    if turn_rad > 2.0 * _INSTANT_RAD * _MOST_INSTANTS:
        # Too fast to follow: all of the frame, each half turn.
        longest = turn_rad / math.pi * math.hypot(camera.width_px, camera.height_px)
    pinhole = camera if camera.distortion is None else replace(camera, distortion=None)
    for view, body in zip(view_bodies(state, pinhole, scene.hulls), scene.bodies, strict=True):
        most_px = _bound_px_s(state, camera, view, body.hull, rays[:, 2].min()) * 2.0 * half_s
        if most_px < _STILL_PX or (view.bounds_px is None and view.is_visible):
            longest = max(longest, most_px)
        else:
            moving.append((view, body))
    if scene.stars is None and not moving:
        return longest
    n_instants = min(2 * math.ceil(turn_rad / _INSTANT_RAD) + 3, _MOST_INSTANTS)
    times = np.linspace(-half_s, half_s, n_instants)
    times[n_instants // 2] = 0.0
    states = [state.after(dt) for dt in times]
    places = [Place.of(each, camera) for each in states]
    if scene.stars is not None:
        sky = rays @ places[n_instants // 2].camera_from_inertial
        longest = max(longest, _path_px(camera, [sky @ place.camera_from_inertial.T for place in places]))
    for view, body in moving:
        tracks = [_in_camera(each.bodies[body.name], place, body.hull.points_m.T + view.centre_m)
                  for each, place in zip(states, places, strict=True)]
        longest = max(longest, _path_px(camera, tracks))
    return longest


def _path_px(camera: PinholeCamera, tracks: list[np.ndarray]) -> float:
    """Longest path [px] of points (N, 3) in `camera` at an odd number of times, of those that pass near the frame."""
    xy = []
    for points in tracks:
        depth = np.where(points[:, 2:] > 0.0, points[:, 2:], np.nan)
        xy.append(camera.focal_length_px * points[:, :2] / depth + np.array(camera.principal_point_px))
    size = np.array([camera.width_px, camera.height_px])
    near = np.any([((np.fmax(a, b) > -size) & (np.fmin(a, b) < 2 * size)).all(axis=1) for a, b in pairwise(xy)], axis=0)
    path = sum(np.hypot(*(b - a).T) for a, b in pairwise(xy))[near]
    # What comes from behind the camera, or goes there, crosses all of the frame.
    return float(np.nan_to_num(path, nan=float(np.hypot(*size))).max(initial=0.0))


def _bound_px_s(state: State, camera: PinholeCamera, view: BodyView, hull: Hull, least_cosine: float) -> float:
    """Speed [px/s] that nothing on a body exceeds that reaches beside or behind the camera."""
    rate = lambda value: np.zeros(3) if value is None else value  # noqa: E731
    body, craft = state.bodies[view.name], state.spacecraft
    speed = np.linalg.norm(rate(body.v_inertial_m_s) - rate(craft.v_inertial_m_s))
    # About the body's origin, which the view's need not be.
    arm_m = np.linalg.norm(view.r_camera_body_m + view.centre_m)
    speed += np.linalg.norm(rate(body.angular_velocity_rad_s)) * arm_m
    turn = np.linalg.norm(rate(craft.angular_velocity_rad_s))
    return float(camera.focal_length_px * (speed / hull.distance_m(view.r_camera_body_m) + turn) / least_cosine**2)


def _in_camera(pose: Pose, place: Place, points_body_m: np.ndarray) -> np.ndarray:
    inertial = points_body_m @ frames.dcm(pose.q_from_inertial) + pose.r_inertial_m
    return (inertial - place.r_inertial_m) @ place.camera_from_inertial.T
