"""Attitudes: pointing at a target, fixed, spinning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from glrender_camera.validate import finite, one_of, unit_quaternion, within
from scipy.spatial.transform import Rotation

from ..base.errors import ConfigError, SceneError
from .checks import angle_deg, rates, unit
from .epochs import Epoch, needed

IDENTITY: Any = (1.0, 0.0, 0.0, 0.0)
UP_RULES = ("north", "sun", "orbit_normal")
# Sine of the angle between boresight and up below which there is no roll to speak of.
_LEAST_SINE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Geometry:
    """Places and velocities of everything at the times of a scenario.

    Parameters
    ----------
    start : Epoch or None
    t_s : (N,) float64 [s]
        From the start.
    r_m, v_m_s : mapping of name to (N, 3) float64 [m], [m/s]
        Places and velocities of "sun", "spacecraft" and the bodies from one origin, ICRF axes.
    """

    start: Epoch | None
    t_s: np.ndarray
    r_m: Mapping[str, np.ndarray]
    v_m_s: Mapping[str, np.ndarray]

    def between(self, a: str, b: str) -> tuple[np.ndarray, np.ndarray]:
        """Position (N, 3) [m] and velocity (N, 3) [m/s] of b relative to a."""
        for name in (a, b):
            if name not in self.r_m:
                raise SceneError("target", "must be in the scenario", name, f"there are {', '.join(self.r_m)}")
        return self.r_m[b] - self.r_m[a], self.v_m_s[b] - self.v_m_s[a]


class Attitude(Protocol):
    """A source of attitudes of a frame."""

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray | None]:
        """Quaternions (N, 4) `q_from_inertial` and angular velocities (N, 3) [rad/s] in the frame, as a gyroscope has.

        Angular velocities that are not known are None. `owner` is "spacecraft" or the body whose frame it is.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class Fixed:
    """An attitude that stays.

    Parameters
    ----------
    q_from_inertial : (4,) float
    """

    q_from_inertial: np.ndarray = field(default=IDENTITY)

    def __post_init__(self):
        object.__setattr__(self, "q_from_inertial", unit_quaternion("q_from_inertial", self.q_from_inertial))

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them."""
        count = len(geometry.t_s)
        return np.tile(self.q_from_inertial, (count, 1)), np.zeros((count, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Spin:
    """A frame that turns about one axis at a constant rate: a body's spin, a spin-stabilised spacecraft.

    Parameters
    ----------
    q_from_inertial : (4,) float
        At `epoch`.
    angular_velocity_rad_s : (3,) float [rad/s]
        In the frame.
    epoch : Epoch, optional
        The scenario's start by default.
    """

    q_from_inertial: np.ndarray = field(default=IDENTITY)
    angular_velocity_rad_s: np.ndarray
    epoch: Epoch | None = None

    def __post_init__(self):
        object.__setattr__(self, "q_from_inertial", unit_quaternion("q_from_inertial", self.q_from_inertial))
        object.__setattr__(self, "angular_velocity_rad_s", rates("angular_velocity_rad_s", self.angular_velocity_rad_s))

    @classmethod
    def about_pole(cls, *, pole_right_ascension_deg: float, pole_declination_deg: float,
                   rotation_period_s: float | None = None, rate_deg_day: float | None = None,
                   prime_meridian_deg: float = 0.0, epoch: Epoch | None = None) -> Spin:
        """The spin of a body about its pole, +Z, by the IAU's parameters.

        Parameters
        ----------
        pole_right_ascension_deg, pole_declination_deg : float [deg]
            ICRF.
        rotation_period_s, rate_deg_day : float [s], [deg/day]
            One of the two; negative turns the other way.
        prime_meridian_deg : float [deg]
            The angle W at the epoch.
        epoch : Epoch, optional
            The scenario's start by default; the IAU's own is J2000, `Epoch(0)`.

        Source: Archinal et al. (2018), figure 1; one day is 86,400 s.
        """
        if (rotation_period_s is None) == (rate_deg_day is None):
            raise ConfigError("rotation_period_s", "needs exactly one of `rotation_period_s` and `rate_deg_day`")
        if rotation_period_s is not None:
            if not abs(finite("rotation_period_s", rotation_period_s)) > 1e-2:
                raise ConfigError("rotation_period_s", "must be longer than 0.01 s", rotation_period_s)
            rate = 2.0 * np.pi / rotation_period_s
        else:
            rate = np.radians(finite("rate_deg_day", rate_deg_day)) / 86400.0
        angles = [angle_deg("pole_right_ascension_deg", pole_right_ascension_deg) + 90.0,
                  90.0 - within("pole_declination_deg", pole_declination_deg, -90.0, 90.0),
                  angle_deg("prime_meridian_deg", prime_meridian_deg)]
        # The rotation takes the frame's axes to where they are: it is inertial from body.
        inertial_from_body = Rotation.from_euler("ZXZ", angles, degrees=True)
        return cls(q_from_inertial=inertial_from_body.inv().as_quat(scalar_first=True),
                   angular_velocity_rad_s=np.array([0.0, 0.0, rate]), epoch=epoch)

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them."""
        t = geometry.t_s
        if self.epoch is not None:
            t = t + (needed(geometry.start) - self.epoch)
        rate = float(np.linalg.norm(self.angular_velocity_rad_s))
        # Whole turns cost digits.
        angle = np.remainder(rate * t, 2.0 * np.pi)
        turn = Rotation.from_rotvec(-angle[:, None] * (self.angular_velocity_rad_s / (rate or 1.0)))
        q = (turn * Rotation.from_quat(self.q_from_inertial, scalar_first=True)).as_quat(scalar_first=True)
        return q, np.tile(self.angular_velocity_rad_s, (len(t), 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Pointing:
    """A camera that looks at a target, rolled so that a direction is up in the image.

    Parameters
    ----------
    target : str
        A body, or "sun".
    up : "north", "sun", "orbit_normal" or (3,) float
        Points up (-Y): the ICRF pole, the Sun, the normal of the motion about the target (nadir pointing), or a
        direction, ICRF axes.
    roll_deg : float [deg]
        By which the camera is turned on about its boresight, +X towards +Y.
    q_camera_from_spacecraft : (4,) float
        The camera's mounting.
    """

    target: str
    up: str | np.ndarray = "north"
    roll_deg: float = 0.0
    q_camera_from_spacecraft: np.ndarray = field(default=IDENTITY)

    def __post_init__(self):
        if isinstance(self.up, str):
            one_of("up", self.up, UP_RULES)
        else:
            object.__setattr__(self, "up", unit("up", self.up))
        object.__setattr__(self, "roll_deg", angle_deg("roll_deg", self.roll_deg))
        object.__setattr__(self, "q_camera_from_spacecraft",
                           unit_quaternion("q_camera_from_spacecraft", self.q_camera_from_spacecraft))

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them; the rates are those of the moving line of sight.

        Raises
        ------
        SceneError
            A target that is not in the scenario, or where the spacecraft is; `up` along the boresight.
        """
        r, v = geometry.between(owner, self.target)
        if not (np.linalg.norm(r, axis=1) > 0.0).all():
            raise SceneError("target", "must be away from the spacecraft", self.target)
        up, up_rate = self._up(geometry, owner, r, v)
        z, dz = _unit_and_rate(r, v)
        x_long = np.cross(z, up)
        along = np.linalg.norm(x_long, axis=1) < _LEAST_SINE * np.linalg.norm(up, axis=1)
        if along.any():
            raise SceneError("up", f"is along the boresight at t_s = {geometry.t_s[np.argmax(along)]:g}", self.up,
                             "choose another direction that is up in the image")
        x, dx = _unit_and_rate(x_long, np.cross(dz, up) + np.cross(z, up_rate))
        y, dy = np.cross(z, x), np.cross(dz, x) + np.cross(z, dx)
        dot = lambda a, b: np.einsum("ij,ij->i", a, b)  # noqa: E731
        camera = Rotation.from_matrix(np.stack([x, y, z], axis=1))
        rates = np.stack([dot(dy, z), dot(dz, x), dot(dx, y)], axis=-1)
        # The camera's axes turn one way, components in them the other.
        roll = Rotation.from_euler("z", -self.roll_deg, degrees=True)
        to_craft = Rotation.from_quat(self.q_camera_from_spacecraft, scalar_first=True).inv() * roll
        return (to_craft * camera).as_quat(scalar_first=True), to_craft.apply(rates)

    def _up(self, geometry: Geometry, owner: str, r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A direction (N, 3) that is up, of any length, and its rate."""
        rule = self.up if isinstance(self.up, str) else None
        if rule == "sun":
            return _unit_and_rate(*geometry.between(owner, "sun"))
        if rule == "orbit_normal":
            # A central motion has a constant r x v, so its rate is 0.
            normal = np.cross(r, v)
            return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300), np.zeros_like(r)
        return np.tile(np.eye(3)[2] if rule == "north" else self.up, (len(r), 1)), np.zeros_like(r)


def _unit_and_rate(r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) of r, and their rates [1/s] of r's rates v."""
    length = np.linalg.norm(r, axis=1, keepdims=True)
    z = r / length
    return z, (v - np.einsum("ij,ij->i", z, v)[:, None] * z) / length
