"""The state vector: where the Sun, the spacecraft and the bodies are, and how they are turned."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from glrender_camera.validate import finite, known_keys, position, unit_quaternion, vector
from scipy.spatial.transform import Rotation

from ..base.constants import FIRST_YEAR, LAST_YEAR, SPEED_OF_LIGHT_M_S
from ..base.errors import ConfigError, error_path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_STATE_REQUIRED = ("r_sun_inertial_m", "spacecraft", "bodies")
_STATE_KEYS = ("t_s", *_STATE_REQUIRED, "date_tdb")
_POSE_REQUIRED = ("r_inertial_m",)
_POSE_KEYS = (*_POSE_REQUIRED, "q_from_inertial")
_RATE_KEYS = ("v_inertial_m_s", "angular_velocity_rad_s")
# 160 turns a second: beyond it degrees were given, or worse.
_MAX_RATE_RAD_S = 1e3
_OF_YEARS = f"must be of the years {FIRST_YEAR} to {LAST_YEAR}"
# The frame's axes are those of `inertial`.
_IDENTITY: Any = tuple(Rotation.identity().as_quat(scalar_first=True).tolist())


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """Position and attitude of a frame, and how they change.

    Parameters
    ----------
    r_inertial_m : (3,) float [m]
        Origin of the frame in `inertial`; each component within 1e16 m, about a light year.
    q_from_inertial : (4,) float, optional
        Unit quaternion [w, x, y, z]: components in `inertial` to components in the frame. Not given, the frame's axes
        are those of `inertial`.
    v_inertial_m_s : (3,) float [m/s], optional
        Velocity of the origin in `inertial`, below the speed of light. Not given, it stands still.
    angular_velocity_rad_s : (3,) float [rad/s], optional
        Rate of the frame against `inertial`, in the frame's own components, as a gyroscope has it; each within 1e3.
    """

    r_inertial_m: np.ndarray
    q_from_inertial: np.ndarray = field(default=_IDENTITY)
    v_inertial_m_s: np.ndarray | None = None
    angular_velocity_rad_s: np.ndarray | None = None

    if TYPE_CHECKING:  # lists of numbers go in, arrays come out
        def __init__(self, *, r_inertial_m: ArrayLike, q_from_inertial: ArrayLike = ...,
                     v_inertial_m_s: ArrayLike | None = None,
                     angular_velocity_rad_s: ArrayLike | None = None) -> None: ...

    def __post_init__(self):
        object.__setattr__(self, "r_inertial_m", position("r_inertial_m", self.r_inertial_m))
        object.__setattr__(self, "q_from_inertial", unit_quaternion("q_from_inertial", self.q_from_inertial))
        if self.v_inertial_m_s is not None:
            velocity = vector("v_inertial_m_s", self.v_inertial_m_s)
            if not np.linalg.norm(velocity) < SPEED_OF_LIGHT_M_S:
                raise ConfigError("v_inertial_m_s", "must be below the speed of light", velocity.tolist())
            object.__setattr__(self, "v_inertial_m_s", velocity)
        if self.angular_velocity_rad_s is not None:
            turn = vector("angular_velocity_rad_s", self.angular_velocity_rad_s)
            if not (np.abs(turn) <= _MAX_RATE_RAD_S).all():
                raise ConfigError("angular_velocity_rad_s", f"must be within {_MAX_RATE_RAD_S:g} rad/s", turn.tolist())
            object.__setattr__(self, "angular_velocity_rad_s", turn)

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], path: str = "") -> Pose:
        known_keys(path, table, (*_POSE_KEYS, *_RATE_KEYS), required=_POSE_REQUIRED)
        with error_path(path):
            return cls(**table)

    def to_dict(self) -> dict[str, Any]:
        """The plain dictionary that the wire carries; rates only where they are known."""
        names = (*_POSE_KEYS, *(name for name in _RATE_KEYS if getattr(self, name) is not None))
        return {name: getattr(self, name).tolist() for name in names}

    @property
    def is_moving(self) -> bool:
        """Whether a rate is given and not zero."""
        return any(rate is not None and bool(rate.any()) for rate in (self.v_inertial_m_s, self.angular_velocity_rad_s))

    def after(self, dt_s: float) -> Pose:
        """The pose a time later [s], at these rates: straight on, and turning about a fixed axis."""
        if not self.is_moving:
            return self
        r, q = self.r_inertial_m, self.q_from_inertial
        if self.v_inertial_m_s is not None:
            r = r + self.v_inertial_m_s * dt_s
        if self.angular_velocity_rad_s is not None:
            # Components in a frame that turns one way turn the other.
            turn = Rotation.from_rotvec(-self.angular_velocity_rad_s * dt_s)
            q = (turn * Rotation.from_quat(q, scalar_first=True)).as_quat(scalar_first=True)
        return replace(self, r_inertial_m=r, q_from_inertial=q)


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """One epoch of a simulation; geometry is used as given, without light time or aberration.

    Parameters
    ----------
    t_s : float [s], optional
        Time of mid-exposure; carried through, not interpreted. 0 if not given.
    r_sun_inertial_m : (3,) float [m]
        Within 1e16 m; at least a solar radius, 6.957e8 m, from every body.
    spacecraft : Pose
    bodies : mapping of body name to Pose
        Every body of the scene.
    date_tdb : str, optional
        The calendar date of mid-exposure in TDB, "2029-02-13T12:00:00.5", to the microsecond: for the frames' files.
        The axes of `inertial` are those of ICRF then.

    The Sun stands still in `inertial`; rates of the poses are for motion blur and stellar aberration.

    Attributes
    ----------
    course : callable or None
        From times (N,) [s] after this state to the N states then, of a source that knows more than the rates, as a
        scenario does: `with_course`. Neither `to_dict` nor `dataclasses.replace` takes it along.
    """

    t_s: float = 0.0
    r_sun_inertial_m: np.ndarray
    spacecraft: Pose
    bodies: Mapping[str, Pose]
    date_tdb: str | None = None
    course: StatesAfter | None = field(init=False, default=None, repr=False)

    if TYPE_CHECKING:  # lists of numbers go in, arrays come out
        def __init__(self, *, t_s: float = 0.0, r_sun_inertial_m: ArrayLike, spacecraft: Pose,
                     bodies: Mapping[str, Pose], date_tdb: str | None = None) -> None: ...

    def __post_init__(self):
        object.__setattr__(self, "t_s", finite("t_s", self.t_s))
        object.__setattr__(self, "r_sun_inertial_m", position("r_sun_inertial_m", self.r_sun_inertial_m))
        if not isinstance(self.spacecraft, Pose):
            raise ConfigError("spacecraft", "must be a Pose", self.spacecraft)
        if not isinstance(self.bodies, Mapping):
            raise ConfigError("bodies", "must map body names to Poses", self.bodies)
        for name, pose in self.bodies.items():
            if not isinstance(pose, Pose):
                raise ConfigError(f"bodies.{name}", "must be a Pose", pose)
        if self.date_tdb is not None:
            object.__setattr__(self, "date_tdb", later(_checked_date(self.date_tdb), 0.0))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], path: str = "state") -> State:
        """A State of the plain dictionary that the wire carries (`state_dict`).

        Raises
        ------
        ConfigError
            With the path of the field, e.g. ``state.bodies.itokawa.q_from_inertial``.
        """
        known_keys(path, table, _STATE_KEYS, required=_STATE_REQUIRED)
        bodies = table["bodies"]
        if not isinstance(bodies, Mapping):
            raise ConfigError(f"{path}.bodies", "must map body names to poses", bodies)
        poses = {str(name): Pose.from_dict(pose, f"{path}.bodies.{name}") for name, pose in bodies.items()}
        spacecraft = Pose.from_dict(table["spacecraft"], f"{path}.spacecraft")
        with error_path(path):
            return cls(**{**table, "spacecraft": spacecraft, "bodies": poses})

    def to_dict(self) -> dict[str, Any]:
        """The plain dictionary that the wire carries: without the course, the date only where it is known."""
        date = {} if self.date_tdb is None else {"date_tdb": self.date_tdb}
        return {"t_s": self.t_s, "r_sun_inertial_m": self.r_sun_inertial_m.tolist(),
                "spacecraft": self.spacecraft.to_dict(),
                "bodies": {name: pose.to_dict() for name, pose in self.bodies.items()}, **date}

    @property
    def is_moving(self) -> bool:
        """Whether any pose has a rate that is not zero."""
        return any(pose.is_moving for pose in (self.spacecraft, *self.bodies.values()))

    def with_course(self, course: StatesAfter) -> State:
        """The same state, with knowledge of its motion besides the rates."""
        state = replace(self)
        object.__setattr__(state, "course", course)
        return state

    def at(self, dt_s: Sequence[float] | np.ndarray) -> list[State]:
        """The states times (N,) [s] later, of its course, or at its poses' rates where it has none.

        Raises
        ------
        ConfigError, SceneError
            The course does not know the states.
        """
        if self.course is None:
            return [self.after(dt) for dt in dt_s]
        # The state itself is the one that is drawn.
        return [self if dt == 0.0 else other for dt, other in zip(dt_s, self.course(np.asarray(dt_s)), strict=True)]

    def after(self, dt_s: float) -> State:
        """The state a time later [s], at its poses' rates."""
        if not self.is_moving or dt_s == 0.0:
            return self
        return replace(self, t_s=self.t_s + dt_s, spacecraft=self.spacecraft.after(dt_s),
                       date_tdb=None if self.date_tdb is None else later(self.date_tdb, dt_s),
                       bodies={name: pose.after(dt_s) for name, pose in self.bodies.items()})


def later(date: str, dt_s: float) -> str:
    """A calendar date a time later [s], to the microsecond, in the same uniform scale."""
    try:
        return (datetime.fromisoformat(date) + timedelta(seconds=dt_s)).isoformat(timespec="microseconds")
    except OverflowError:
        raise ConfigError("date_tdb", _OF_YEARS, f"{date} and {dt_s:g} s") from None


def _checked_date(value: object) -> str:
    hint = 'write "2029-02-13T12:00:00.5"'
    try:
        # Values that are no strings are refused as no dates.
        date = datetime.fromisoformat(cast(str, value))
    except (TypeError, ValueError):
        raise ConfigError("date_tdb", "must be a date year-month-dayThour:minute:second", value, hint) from None
    if date.tzinfo is not None:
        raise ConfigError("date_tdb", "must be TDB, without a Z or an offset", value, hint)
    if not FIRST_YEAR <= date.year <= LAST_YEAR:
        raise ConfigError("date_tdb", _OF_YEARS, value, hint)
    return date.isoformat()


StatesAfter = Callable[[np.ndarray], Sequence[State]]
"""From times (N,) [s] after a state to the states then."""
