"""Rigid-body attitude dynamics: Euler's equations with torques, of a spacecraft or of a tumbling body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from glrender_camera.validate import unit_quaternion, vector, within
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from ..base.errors import ConfigError
from .attitude import IDENTITY, Geometry
from .checks import MAX_RATE_RAD_S, gm, numbers, rates
from .epochs import Epoch
from .paths import Trajectory

_NONE: Any = (0.0, 0.0, 0.0)
Torque = Callable[[float, np.ndarray, np.ndarray], np.ndarray]
"""A function from t_s [s], `q_from_inertial` (4,) and angular velocity (3,) [rad/s], to a torque (3,) [N m] in
the frame that turns."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidBody:
    """The attitude of a rigid body that turns freely or under torques.

    Parameters
    ----------
    inertia_kg_m2 : (3, 3) or (3,) float [kg m2]
        About the centre of mass, in the frame; three numbers are the principal moments along its axes.
    angular_velocity_rad_s : (3,) float [rad/s]
        At the scenario's start, in the frame.
    q_from_inertial : (4,) float
        At the scenario's start.
    torques : sequence of callable
        As `Torque`: `GravityGradient`, `GasDrag`, `Thruster`, `Wheels`, or a function. The sum counts. One that jumps
        has the times of that as `edges_s`.
    impulses : sequence of object with `times_s` and `impulse(index, q_from_inertial)`
        What changes the angular momentum at once, [N m s] in the frame: `DustImpacts`.
    wheel_momentum_N_m_s : (3,) float [N m s]
        Constant angular momentum of wheels, in the frame.
    rtol : float [1]
        Of the integration (DOP853).

    Raises
    ------
    ConfigError
        An inertia that no body has: not symmetric, a moment that is not positive or above the sum of the others.

    Source: Wertz (1978), sections 16.1 and 16.2; Euler's equations and the kinematic equation of a quaternion.
    """

    inertia_kg_m2: np.ndarray
    angular_velocity_rad_s: np.ndarray
    q_from_inertial: np.ndarray = field(default=IDENTITY)
    torques: Sequence[Torque] = ()
    impulses: Sequence[Any] = ()
    wheel_momentum_N_m_s: np.ndarray = field(default=_NONE)
    rtol: float = 1e-10

    def __post_init__(self):
        object.__setattr__(self, "inertia_kg_m2", _checked_inertia(self.inertia_kg_m2))
        object.__setattr__(self, "q_from_inertial", unit_quaternion("q_from_inertial", self.q_from_inertial))
        object.__setattr__(self, "angular_velocity_rad_s", rates("angular_velocity_rad_s", self.angular_velocity_rad_s))
        momentum = vector("wheel_momentum_N_m_s", self.wheel_momentum_N_m_s)
        if not (np.abs(momentum) <= MAX_RATE_RAD_S * np.linalg.norm(self.inertia_kg_m2)).all():
            raise ConfigError("wheel_momentum_N_m_s", "must turn the body at no more than "
                              f"{MAX_RATE_RAD_S:g} rad/s", momentum.tolist())
        object.__setattr__(self, "wheel_momentum_N_m_s", momentum)
        within("rtol", self.rtol, 1e-13, 1e-3)
        if not all(callable(torque) for torque in self.torques):
            raise ConfigError("torques", "must be callables", self.torques)
        if not all(hasattr(source, "times_s") and hasattr(source, "impulse") for source in self.impulses):
            raise ConfigError("impulses", "must have times_s and impulse", self.impulses)

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them."""
        return self.motion(geometry.t_s)

    def motion(self, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Quaternions (N, 4) `q_from_inertial` and angular velocities (N, 3) [rad/s] at times (N,) [s] from the start.

        Raises
        ------
        ConfigError
            A torque that is not three finite numbers; an integration that fails.
        """
        t_s = np.asarray(t_s, float)
        begin = np.concatenate([self.q_from_inertial, self.angular_velocity_rad_s])
        out, inverse = np.tile(begin, (len(t_s), 1)), np.linalg.inv(self.inertia_kg_m2)
        for sign in (-1.0, 1.0):
            times = np.unique(np.abs(t_s[t_s * sign > 0.0]))
            if times.size:
                here = t_s * sign > 0.0
                out[here] = self._flown(sign, times, begin, inverse)[np.searchsorted(times, np.abs(t_s[here]))]
        q = out[:, :4]
        return q / np.linalg.norm(q, axis=1, keepdims=True), out[:, 4:]

    def _flown(self, sign: float, times: np.ndarray, y: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """States (N, 7) at ascending times from the start, forwards or backwards; integrated from break to break.

        At the time of an impulse the state is that before it, as the integration goes.
        """
        out, begin = np.empty((len(times), 7)), 0.0
        kicks = self._kicks(sign, times[-1])
        for end in np.unique([*(time for time, _, _ in kicks), *self._edges(sign, times[-1]), times[-1]]):
            here = (times > begin) & (times <= end)
            # On an edge itself a torque is that of one side.
            low, high = begin + 1e-12 * (end - begin), end - 1e-12 * (end - begin)
            asked = np.unique([*times[here], end])
            solved = solve_ivp(
                lambda t, y, low=low, high=high: sign * self._rates(sign * min(max(t, low), high), y, inverse),
                (begin, end), y, method="DOP853", t_eval=asked, rtol=self.rtol, atol=self.rtol * 1e-2)
            if not solved.success:
                raise ConfigError("torques", f"leave no motion to integrate: {solved.message}")
            out[here] = solved.y.T[:int(here.sum())]
            y, begin = solved.y[:, -1].copy(), end
            while kicks and kicks[0][0] == end:
                _, source, index = kicks.pop(0)
                q = y[:4] / np.linalg.norm(y[:4])
                y[4:] += sign * inverse @ vector("impulses", source.impulse(index, q))
        return out

    def _edges(self, sign: float, until_s: float) -> list[float]:
        """Times from the start, forwards or backwards, where a torque jumps."""
        edges = np.concatenate([np.zeros(0), *(sign * np.asarray(torque.edges_s) for torque in self.torques
                                               if hasattr(torque, "edges_s"))])
        return edges[(edges > 0.0) & (edges < until_s)].tolist()

    def _kicks(self, sign: float, until_s: float) -> list[tuple[float, Any, int]]:
        """Times, sources and numbers of the impulses, ascending."""
        kicks = [(sign * float(time), source, index) for source in self.impulses
                 for index, time in enumerate(source.times_s)]
        return sorted((kick for kick in kicks if 0.0 < kick[0] < until_s), key=lambda kick: kick[0])

    def _rates(self, t_s: float, y: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        q, omega = y[:4], y[4:]
        torque = -cross(omega, self.inertia_kg_m2 @ omega + self.wheel_momentum_N_m_s)
        if self.torques:
            unit = q / np.linalg.norm(q)
            for source in self.torques:
                torque = torque + vector("torques", source(t_s, unit, omega))
        w, x = q[0], q[1:]
        # Components in a frame that turns one way turn the other: q' = -1/2 omega q.
        q_rate = -0.5 * np.concatenate([[-omega @ x], w * omega + cross(omega, x)])
        return np.concatenate([q_rate, inverse @ torque])


@dataclass(frozen=True, kw_only=True, eq=False)
class GravityGradient:
    """The torque of a point mass's gravity on an extended body.

    Parameters
    ----------
    inertia_kg_m2 : (3, 3) or (3,) float [kg m2]
        As of `RigidBody`.
    gravitational_parameter_m3_s2 : float [m3/s2], > 0
        Of the attracting mass.
    trajectory : Trajectory
        Of the body that turns, about that mass.
    start : Epoch, optional
        The scenario's.

    Source: Wertz (1978), equation 17-31: 3 mu / r^3 (n x I n), n the unit vector to the mass.
    """

    inertia_kg_m2: np.ndarray
    gravitational_parameter_m3_s2: float
    trajectory: Trajectory
    start: Epoch | None = None

    def __post_init__(self):
        object.__setattr__(self, "inertia_kg_m2", _checked_inertia(self.inertia_kg_m2))
        gm("gravitational_parameter_m3_s2", self.gravitational_parameter_m3_s2)

    def __call__(self, t_s: float, q_from_inertial: np.ndarray, angular_velocity_rad_s: np.ndarray) -> np.ndarray:
        """The torque (3,) [N m] in the frame."""
        r = self.trajectory.at(self.start, np.array([t_s]))[0][0]
        range_m = float(np.linalg.norm(r))
        n = Rotation.from_quat(q_from_inertial, scalar_first=True).apply(-r / range_m)
        return 3.0 * self.gravitational_parameter_m3_s2 / range_m**3 * cross(n, self.inertia_kg_m2 @ n)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product (3,) of two vectors (3,), ten times as fast as NumPy's, which most of an integration is."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _checked_inertia(value: np.ndarray) -> np.ndarray:
    """(3, 3) inertia that a body can have."""
    name = "inertia_kg_m2"
    inertia = numbers(name, value)
    inertia = np.diag(inertia) if inertia.shape == (3,) else inertia
    if inertia.shape != (3, 3) or not (np.abs(inertia) <= 1e40).all():
        raise ConfigError(name, "must be three moments, or 3 x 3 numbers, within 1e40", value)
    if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=1e-9 * np.abs(inertia).max()):
        raise ConfigError(name, "must be symmetric", inertia.tolist())
    moments = np.linalg.eigvalsh(inertia)
    # A flat plate has the sum exactly: round-off is let through.
    if not (moments[0] > 0.0 and moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-9)):
        raise ConfigError(name, "must have principal moments > 0, none above the sum of the others", moments.tolist())
    return inertia
