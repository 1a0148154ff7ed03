"""The motion of a source's states about one state, also where the source knows one side alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..base.errors import ConfigError, GlrenderError, SceneError
from .state import Pose, State


@dataclass(frozen=True, kw_only=True, eq=False)
class Course:
    """The states of a source at times about one state: `State.course`.

    Where the source has none, before its first time or after its last, the state moves on at its rates; a pose
    without rates as it moves on the other side.

    Parameters
    ----------
    states : callable
        From times (N,) [s] of the source to N states.
    state : State
        The state in the middle.
    """

    states: Callable[[np.ndarray], list[State]]
    state: State

    def __call__(self, dt_s: np.ndarray) -> list[State]:
        """The states at times (N,) [s] after it.

        Raises
        ------
        SceneError
            The source has states on neither side, and a pose has no rate.
        """
        try:
            return self._known(dt_s)
        except GlrenderError as error:
            why = error
        found: dict[float, State] = {}
        for side in (dt_s[dt_s < 0.0], dt_s[dt_s > 0.0]):
            try:
                found.update(zip(side.tolist(), self._known(side), strict=True))
            except GlrenderError as error:
                why = error
        nearest = min(found, key=abs) if found else 0.0
        moving = _with_rates(self.state, found.get(nearest), nearest, why)
        return [found[dt] if dt in found else moving.after(dt) for dt in dt_s.tolist()]

    def _known(self, dt_s: np.ndarray) -> list[State]:
        return list(self.states(self.state.t_s + dt_s)) if len(dt_s) else []


def _with_rates(state: State, other: State | None, dt_s: float, why: GlrenderError) -> State:
    """The state with rates that it lacks, of a state a time [s] later."""
    if other is None:
        if any(rate is None for pose in (state.spacecraft, *state.bodies.values())
               for rate in (pose.v_inertial_m_s, pose.angular_velocity_rad_s)):
            raise SceneError("state", f"has no rates, and its motion is not known: {why}")
        return state
    return replace(state, spacecraft=_of_two(state.spacecraft, other.spacecraft, dt_s),
                   bodies={name: _of_two(pose, other.bodies[name], dt_s) for name, pose in state.bodies.items()})


def _of_two(pose: Pose, other: Pose, dt_s: float) -> Pose:
    """The pose with differences to another one, a time [s] later, for rates that it lacks."""
    v, turn = pose.v_inertial_m_s, pose.angular_velocity_rad_s
    if v is None:
        v = (other.r_inertial_m - pose.r_inertial_m) / dt_s
    if turn is None:
        here, there = (Rotation.from_quat(each.q_from_inertial, scalar_first=True) for each in (pose, other))
        # Components in a frame that turns one way turn the other.
        turn = -(there * here.inv()).as_rotvec() / dt_s
    try:
        return replace(pose, v_inertial_m_s=v, angular_velocity_rad_s=turn)
    except ConfigError as error:
        raise SceneError("state", f"moves faster than a pose can: {error}") from None
