"""The state vector: where the Sun, the spacecraft and the bodies are, and how they are turned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from glrender_camera.validate import finite, known_keys, position, unit_quaternion

from .errors import ConfigError, error_path

_STATE_KEYS = ("t_s", "r_sun_inertial_m", "spacecraft", "bodies")
_POSE_KEYS = ("r_inertial_m", "q_from_inertial")


@dataclass(frozen=True, kw_only=True, eq=False)
class Pose:
    """Position and attitude of a frame.

    Parameters
    ----------
    r_inertial_m : (3,) float [m]
        Origin of the frame in `inertial`; each component within 1e16 m, about a light year.
    q_from_inertial : (4,) float
        Unit quaternion [w, x, y, z]: components in `inertial` to components in the frame.
    """

    r_inertial_m: np.ndarray
    q_from_inertial: np.ndarray = field(default=(1.0, 0.0, 0.0, 0.0))

    def __post_init__(self):
        object.__setattr__(self, "r_inertial_m", position("r_inertial_m", self.r_inertial_m))
        object.__setattr__(self, "q_from_inertial", unit_quaternion("q_from_inertial", self.q_from_inertial))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], path: str = "") -> Pose:
        known_keys(path, table, _POSE_KEYS, required=_POSE_KEYS)
        with error_path(path):
            return cls(**table)


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """One epoch of a simulation; geometry is used as given, without light time or aberration.

    Parameters
    ----------
    t_s : float [s]
        Time of mid-exposure; carried through, not interpreted.
    r_sun_inertial_m : (3,) float [m]
        Within 1e16 m; at least a solar radius, 6.957e8 m, from every body.
    spacecraft : Pose
    bodies : mapping of body name to Pose
        Every body of the scene.
    """

    t_s: float = 0.0
    r_sun_inertial_m: np.ndarray
    spacecraft: Pose
    bodies: Mapping[str, Pose]

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

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], path: str = "state") -> State:
        """A State of the plain dictionary that the wire carries (`state_dict`).

        Raises
        ------
        ConfigError
            With the path of the field, e.g. ``state.bodies.itokawa.q_from_inertial``.
        """
        known_keys(path, table, _STATE_KEYS, required=_STATE_KEYS)
        bodies = table["bodies"]
        if not isinstance(bodies, Mapping):
            raise ConfigError(f"{path}.bodies", "must map body names to poses", bodies)
        poses = {str(name): Pose.from_dict(pose, f"{path}.bodies.{name}") for name, pose in bodies.items()}
        spacecraft = Pose.from_dict(table["spacecraft"], f"{path}.spacecraft")
        with error_path(path):
            return cls(t_s=table["t_s"], r_sun_inertial_m=table["r_sun_inertial_m"], spacecraft=spacecraft,
                       bodies=poses)

    def to_dict(self) -> dict[str, Any]:
        """The plain dictionary that the wire carries."""
        pose = lambda p: {"r_inertial_m": p.r_inertial_m.tolist(),  # noqa: E731
                          "q_from_inertial": p.q_from_inertial.tolist()}
        return {"t_s": self.t_s, "r_sun_inertial_m": self.r_sun_inertial_m.tolist(),
                "spacecraft": pose(self.spacecraft),
                "bodies": {name: pose(p) for name, p in self.bodies.items()}}
