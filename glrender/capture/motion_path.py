"""Paths in the image of what moves during an exposure: measured at some instants, their length and their extent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from glrender_camera import PinholeCamera

from ..base import rotations as frames
from ..scene.scene import Scene
from ..scene.shape.convex_hull import Hull
from ..view.state import Pose, State
from ..view.view import BodyView, view_bodies
from .sky_background import Place

STILL_PX = 0.05
"""A frame that moves by less stands still [px]: the blur adds 2e-4 px2 to any point spread function."""
MOST_INSTANTS = 257
"""Instants of a motion that fewer do not follow."""
# Turn between the instants at which a path of known rates is measured, about; and how many there are at most.
_INSTANT_RAD, _MOST_OF_RATES = 0.8, 129
# Instants of a course, the fewest first; more do not matter where the path has grown by less than this share.
_INSTANTS, _GROWTH = (7, 21, 129, MOST_INSTANTS), 1.1
# Points of a body that are followed where there are many instants, about.
_POINTS = 256
# Fractions of its multiples are evenly spread however many there are: no period falls in step with them.
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """The motion of an exposure, at some of its instants.

    Attributes
    ----------
    times_s : (M,) float64 [s]
        After the state's, ascending, 0 among them.
    states : sequence of M State
    xy_px : (M, P, 2) float64 [px]
        Places of the fastest body's points, or the sky's; P may be 0.
    length_px, extent_px : float [px]
        The longest path of a point, and the largest distance between two places of one.
    is_followed : bool
        Whether more instants would find no longer path.
    """

    times_s: np.ndarray
    states: Sequence[State]
    xy_px: np.ndarray
    length_px: float
    extent_px: float
    is_followed: bool


def path_of(scene: Scene, state: State, camera: PinholeCamera, half_s: float) -> Path:
    """The motion from `half_s` before a state to `half_s` after it, of bodies and sky in the image of a camera.

    A motion of unknown frequencies is looked at more and more often, at instants in step with no frequency.

    Raises
    ------
    ConfigError, SceneError
        Errors of the state's course.
    """
    if state.course is None:
        turn_rad = 2.0 * half_s * max(_rate(pose.angular_velocity_rad_s) for pose in _poses(state))
        # A turn between two instants is a chord.
        n = 2 * math.ceil(turn_rad / _INSTANT_RAD) + 3
        is_followed = n <= 2 * _MOST_OF_RATES
        times = even_times(min(n, _MOST_OF_RATES), half_s) if is_followed else _uneven_times(MOST_INSTANTS, half_s)
        return _measured(scene, state, camera, times, is_followed)
    path = None
    for n in _INSTANTS:
        before, path = path, _measured(scene, state, camera, _uneven_times(n, half_s), True)
        if before is not None and path.length_px <= max(_GROWTH * before.length_px, before.length_px + STILL_PX):
            return path
    return replace(path, is_followed=False)


def path_at(scene: Scene, state: State, camera: PinholeCamera, half_s: float) -> Path:
    """The motion of `path_of`, at `MOST_INSTANTS`."""
    return _measured(scene, state, camera, _uneven_times(MOST_INSTANTS, half_s), True)


def moves(state: State, half_s: float) -> bool:
    """Whether anything moves from `half_s` before a state to `half_s` after it; yes where its course does not know."""
    if state.is_moving or state.course is None:
        return state.is_moving
    return any(not np.array_equal(a.r_inertial_m, b.r_inertial_m) or not np.array_equal(a.q_from_inertial,
               b.q_from_inertial) for other in state.at(_uneven_times(_INSTANTS[0], half_s))
               for a, b in zip(_poses(state), _poses(other), strict=True))


def even_times(n: int, half_s: float) -> np.ndarray:
    """Times (n,) [s] from -half_s to half_s at even distances, 0 in the middle; n is odd."""
    times = np.linspace(-half_s, half_s, n)
    times[n // 2] = 0.0
    return times


def _uneven_times(n: int, half_s: float) -> np.ndarray:
    """Times (n,) [s] from -half_s to half_s, 0 among them, at distances in step with no period."""
    k = np.arange(n - 3)
    places = (k + np.modf((k + 1) * _GOLDEN)[0]) / (n - 3)
    return np.unique(np.concatenate([[-half_s, 0.0, half_s], half_s * (2.0 * places - 1.0)]))


def _measured(scene: Scene, state: State, camera: PinholeCamera, times: np.ndarray, is_followed: bool) -> Path:
    states = state.at(times)
    corners = np.array([[x, y] for x in (0, camera.width_px - 1) for y in (0, camera.height_px - 1)])
    rays = camera.directions(corners)
    totals = _totals(state, states, times)
    longest, extent, moving = 0.0, 0.0, []
    for view, body in zip(view_bodies(state, camera.without_distortion, scene.hulls), scene.bodies, strict=True):
        most_px = _most_px(totals, camera, view, body.hull, rays[:, 2].min())
        if most_px < STILL_PX or (view.bounds_px is None and view.is_visible):
            longest, extent = max(longest, most_px), max(extent, most_px)
        else:
            moving.append((view, body))
    xy = np.zeros((len(times), 0, 2))
    if scene.stars is None and not moving:
        return Path(times_s=times, states=states, xy_px=xy, length_px=longest, extent_px=extent,
                    is_followed=is_followed)
    places = [Place.of(each, camera) for each in states]
    tracks = []
    if scene.stars is not None:
        sky = rays @ Place.of(state, camera).camera_from_inertial
        tracks.append([sky @ place.camera_from_inertial.T for place in places])
    for view, body in moving:
        points = body.hull.points_m.T + view.centre_m
        if len(times) > _INSTANTS[0] or state.course is not None:
            points = points[::max(1, len(points) // _POINTS)]
        tracks.append([_in_camera(each.bodies[body.name], place, points)
                       for each, place in zip(states, places, strict=True)])
    for track in tracks:
        places_px, length, reach = _of_points(camera, track)
        if length >= longest:
            longest, xy = length, places_px
        extent = max(extent, reach)
    return Path(times_s=times, states=states, xy_px=xy, length_px=longest, extent_px=extent, is_followed=is_followed)


def _of_points(camera: PinholeCamera, track: list[np.ndarray]) -> tuple[np.ndarray, float, float]:
    """Places (M, P, 2) [px] of the points of a track that pass near the frame, their longest path and extent [px]."""
    xy = []
    for points in track:
        depth = np.where(points[:, 2:] > 0.0, points[:, 2:], np.nan)
        xy.append(camera.focal_length_px * points[:, :2] / depth + np.array(camera.principal_point_px))
    size = np.array([camera.width_px, camera.height_px])
    near = np.any([((np.fmax(a, b) > -size) & (np.fmin(a, b) < 2 * size)).all(axis=1) for a, b in pairwise(xy)], axis=0)
    path = sum(np.hypot(*(b - a).T) for a, b in pairwise(xy))[near]
    places = np.array(xy)[:, near]
    # A body that comes from behind the camera, or goes there, crosses all of the frame.
    across = float(np.hypot(*size))
    reach = np.hypot(*(np.max(places, axis=0) - np.min(places, axis=0)).T) if places.size else np.zeros(0)
    longest, extent = (float(np.nan_to_num(each, nan=across).max(initial=0.0)) for each in (path, reach))
    return places[:, np.isfinite(places).all(axis=(0, 2))], longest, extent


def _poses(state: State) -> list[Pose]:
    return [state.spacecraft, *state.bodies.values()]


def _rate(value: np.ndarray | None) -> float:
    return 0.0 if value is None else float(np.linalg.norm(value))


def _totals(state: State, states: Sequence[State], times: np.ndarray) -> dict[str, tuple[float, float]]:
    """How far [m] each body moves against the spacecraft, and how far it turns [rad]; the spacecraft of name ""."""
    span = float(times[-1] - times[0])
    if state.course is None:
        rate = lambda value: np.zeros(3) if value is None else value  # noqa: E731
        return {name: (_rate(rate(pose.v_inertial_m_s) - rate(state.spacecraft.v_inertial_m_s)) * span,
                       _rate(pose.angular_velocity_rad_s) * span)
                for name, pose in {"": state.spacecraft, **state.bodies}.items()}
    craft = np.array([each.spacecraft.r_inertial_m for each in states])
    totals = {"": (0.0, _turned(np.array([each.spacecraft.q_from_inertial for each in states])))}
    for name in state.bodies:
        r = np.array([each.bodies[name].r_inertial_m for each in states]) - craft
        totals[name] = (float(np.linalg.norm(np.diff(r, axis=0), axis=1).sum()),
                        _turned(np.array([each.bodies[name].q_from_inertial for each in states])))
    return totals


def _turned(q: np.ndarray) -> float:
    """How far [rad] unit quaternions (N, 4), of either sign, turn from each to the next."""
    chord = np.minimum(np.linalg.norm(q[1:] - q[:-1], axis=1), np.linalg.norm(q[1:] + q[:-1], axis=1))
    return float(4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)).sum())


def _most_px(totals: dict[str, tuple[float, float]], camera: PinholeCamera, view: BodyView, hull: Hull,
             least_cosine: float) -> float:
    """A path [px] that nothing on a body exceeds that reaches behind the camera's plane."""
    moved_m, turned_rad = totals[view.name]
    # About the body's origin, which the view's need not be.
    arm_m = float(np.linalg.norm(view.r_camera_body_m + view.centre_m))
    moved_m += turned_rad * arm_m
    return float(camera.focal_length_px * (moved_m / hull.distance_m(view.r_camera_body_m) + totals[""][1])
                 / least_cosine**2)


def _in_camera(pose: Pose, place: Place, points_body_m: np.ndarray) -> np.ndarray:
    inertial = points_body_m @ frames.dcm(pose.q_from_inertial) + pose.r_inertial_m
    return (inertial - place.r_inertial_m) @ place.camera_from_inertial.T
