"""Trajectories that need no orbit: at rest, hovering, circling, a function of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from glrender_camera.validate import one_of, position, positive, vector

from ..base.errors import ConfigError
from .checks import gm, length, unit
from .epochs import Epoch
from .kepler import EQUATORIAL_FROM_ECLIPTIC, Kepler


class Trajectory(Protocol):
    """A source of positions: relative to the origin of what it is `about`, "sun" or a body, in ICRF axes."""

    @property
    def about(self) -> str:
        """Name of the object that positions are relative to."""

    def at(self, start: Any, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) [m] and velocities (N, 3) [m/s] at times (N,) [s] from the scenario's start."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AtRest:
    """A place that does not move.

    Parameters
    ----------
    r_m : (3,) float [m]
        ICRF axes.
    about : str
    """

    r_m: np.ndarray
    about: str

    def __post_init__(self):
        object.__setattr__(self, "r_m", position("r_m", self.r_m))

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them."""
        return np.tile(self.r_m, (len(t_s), 1)), np.zeros((len(t_s), 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Hovering:
    """A place that stands still in a Hill frame of a body: X from the body to the Sun, Z along its orbit's normal.

    Parameters
    ----------
    r_hill_m : (3,) float [m]
        [d, 0, 0] is sunward, at phase 0.
    about : str
        The body.
    body_trajectory : Trajectory
        Trajectory of the body about the Sun.
    """

    r_hill_m: np.ndarray
    about: str
    body_trajectory: Trajectory

    def __post_init__(self):
        object.__setattr__(self, "r_hill_m", position("r_hill_m", self.r_hill_m))

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them."""
        axes, turn = hill_frame(*self.body_trajectory.at(start, t_s))
        r = axes @ self.r_hill_m
        return r, np.cross(turn, r)


def hill_frame(r_body_sun_m: np.ndarray, v_body_sun_m_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (N, 3, 3), as columns X, Y, Z in ICRF, and angular velocity (N, 3) [rad/s] of a body's Hill frame."""
    momentum = np.cross(r_body_sun_m, v_body_sun_m_s)
    length = np.linalg.norm(momentum, axis=1, keepdims=True)
    range_m = np.linalg.norm(r_body_sun_m, axis=1, keepdims=True)
    x, z = -r_body_sun_m / range_m, momentum / length
    return np.stack([x, np.cross(z, x), z], axis=-1), momentum / range_m**2


def circular_orbit(*, about: str, gravitational_parameter_m3_s2: float, radius_m: float, epoch: Epoch,
                   plane: str | np.ndarray, sun_direction: np.ndarray | None = None) -> Kepler:
    """A circular orbit about a body.

    Parameters
    ----------
    about : str
    gravitational_parameter_m3_s2 : float [m3/s2], > 0
    radius_m : float [m], > 0
    epoch : Epoch
        When the spacecraft is at its northernmost.
    plane : "terminator", "ecliptic", or (3,) float
        Or the normal of the plane, ICRF axes: a body's pole gives an equatorial orbit.
    sun_direction : (3,) float, optional
        From the body to the Sun at the epoch, ICRF axes: the normal of the terminator's plane.
    """
    if isinstance(plane, str):
        if one_of("plane", plane, ("terminator", "ecliptic")) == "terminator" and sun_direction is None:
            raise ConfigError("sun_direction", "missing: a terminator orbit needs it")
        normal = sun_direction if plane == "terminator" else EQUATORIAL_FROM_ECLIPTIC[:, 2]
    else:
        normal = plane
    normal = unit("plane", normal)
    north = np.eye(3)[2] if abs(normal[2]) < 1.0 - 1e-9 else np.eye(3)[0]
    out = north - (north @ normal) * normal
    out = out / np.linalg.norm(out)
    radius = length("radius_m", radius_m)
    speed = np.sqrt(gm("gravitational_parameter_m3_s2", gravitational_parameter_m3_s2) / radius)
    return Kepler(r_m=radius * out, v_m_s=speed * np.cross(normal, out), epoch=epoch, about=about,
                  gravitational_parameter_m3_s2=gravitational_parameter_m3_s2)


@dataclass(frozen=True, kw_only=True, eq=False)
class OfFunction:
    """A trajectory of a function of time.

    Parameters
    ----------
    function : callable
        Of t_s, a float [s] after the scenario's start, to a position (3,) [m], ICRF axes, or to a pair of position and
        velocity (3,) [m/s]. A position alone is differentiated over `step_s`.
    about : str
    step_s : float [s], > 0
    """

    function: Callable
    about: str
    step_s: float = 1e-2

    def __post_init__(self):
        if not callable(self.function):
            raise ConfigError("function", "must be callable", self.function)
        positive("step_s", self.step_s)

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them."""
        pairs = [self._pair(float(t)) for t in t_s]
        return np.array([r for r, _ in pairs]).reshape(-1, 3), np.array([v for _, v in pairs]).reshape(-1, 3)

    def _pair(self, t_s: float) -> tuple[np.ndarray, np.ndarray]:
        got = self.function(t_s)
        if np.shape(got) == (2, 3):
            return vector("r_m", got[0]), vector("v_m_s", got[1])
        r, half = vector("r_m", got), 0.5 * self.step_s
        return r, (vector("r_m", self.function(t_s + half)) - vector("r_m", self.function(t_s - half))) / self.step_s
