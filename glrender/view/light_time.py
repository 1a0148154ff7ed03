"""Apparent places of bodies from a moving spacecraft: light time and aberration, applied to a state on request."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from glrender_camera.spectrum import SPEED_OF_LIGHT_M_S
from glrender_camera.stars import aberrated

from ..base.errors import SceneError
from .state import Pose, State, StatesAfter


def apparent_state(state: State, *, light_time: bool = True, aberration: bool = True) -> State:
    """A state as its light shows it to the spacecraft.

    Each body goes back along its rates by the time that its light takes, and turns back; then directions are
    aberrated by the spacecraft's velocity, at the same ranges, the Sun's as the bodies'. Phase angles change
    by v / c at most, 1e-4 rad.

    Parameters
    ----------
    state : State
        Velocities relative to the Sun.
    light_time : bool
        Needs `v_inertial_m_s` of every body (0 is a velocity).
    aberration : bool
        Needs `v_inertial_m_s` of the spacecraft.

    Returns
    -------
    State
        With the rates of `state`, and its course.

    Raises
    ------
    SceneError
        A velocity is missing.

    Source: Explanatory Supplement to the Astronomical Almanac, section 7.2.
    """
    r_craft = state.spacecraft.r_inertial_m
    bodies, r_sun = dict(state.bodies), state.r_sun_inertial_m
    if light_time:
        for name, pose in bodies.items():
            if pose.v_inertial_m_s is None:
                raise SceneError(f"state.bodies.{name}.v_inertial_m_s", "missing: light time needs it")
            bodies[name] = _earlier(pose, r_craft)
    if aberration:
        velocity = state.spacecraft.v_inertial_m_s
        if velocity is None:
            raise SceneError("state.spacecraft.v_inertial_m_s", "missing: aberration needs it")
        bodies = {name: replace(pose, r_inertial_m=_aberrated(pose.r_inertial_m, r_craft, velocity))
                  for name, pose in bodies.items()}
        r_sun = _aberrated(r_sun, r_craft, velocity)
    made = replace(state, bodies=bodies, r_sun_inertial_m=r_sun)
    if state.course is None:
        return made
    return made.with_course(_Apparent(course=state.course, light_time=light_time, aberration=aberration))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Apparent:
    """The course of an apparent state: that of the state, as it appears."""

    course: StatesAfter
    light_time: bool
    aberration: bool

    def __call__(self, dt_s: np.ndarray) -> list[State]:
        return [apparent_state(state, light_time=self.light_time, aberration=self.aberration)
                for state in self.course(dt_s)]


def _earlier(pose: Pose, r_craft: np.ndarray) -> Pose:
    """A pose at the time t before it when |r - v t| = c t: at its rates it moves along a straight line."""
    offset_m, velocity_m_s = pose.r_inertial_m - r_craft, pose.v_inertial_m_s
    along, slower = offset_m @ velocity_m_s, SPEED_OF_LIGHT_M_S**2 - velocity_m_s @ velocity_m_s
    return pose.after(-float(np.sqrt(along**2 + slower * (offset_m @ offset_m)) - along) / float(slower))


def _aberrated(r_inertial_m: np.ndarray, r_craft: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    offset = r_inertial_m - r_craft
    range_m = float(np.linalg.norm(offset))
    return r_craft + range_m * aberrated(offset[None, :] / range_m, velocity)[0] if range_m > 0.0 else r_inertial_m
