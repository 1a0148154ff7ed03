"""Rigid-body attitude dynamics: Euler's equations with torques, of a spacecraft or of a tumbling body."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from glrender_camera.validate import unit_quaternion, vector, within
from scipy.integrate import DOP853, solve_ivp
from scipy.spatial.transform import Rotation

from ..base.errors import ConfigError
from .attitude import IDENTITY, Geometry
from .checks import MAX_RATE_RAD_S, gm, numbers, rates
from .epochs import Epoch
from .paths import Trajectory

_NONE: Any = (0.0, 0.0, 0.0)
# Steps from a state that is kept to the next [1]: a later call integrates no more anew, tens of milliseconds of a
# processor; and a turn a minute keeps 50 kB a day.
_STEPS_OF_A_LEG = 64
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
        Impulses that change the angular momentum at once, [N m s] in the frame: `DustImpacts`.
    wheel_momentum_N_m_s : (3,) float [N m s]
        Constant angular momentum of wheels, in the frame.
    rtol : float [1]
        Relative tolerance of the integration (DOP853).

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

    if TYPE_CHECKING:  # made in __post_init__
        _flights: Any = field(init=False)

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
        object.__setattr__(self, "_flights", [_Flight(self, sign) for sign in (-1.0, 1.0)])

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
        out = np.tile(np.concatenate([self.q_from_inertial, self.angular_velocity_rad_s]), (len(t_s), 1))
        for flight in self._flights:
            here = t_s * flight.sign > 0.0
            if here.any():
                times, places = np.unique(np.abs(t_s[here]), return_inverse=True)
                out[here] = flight.at(times)[places]
        q = out[:, :4]
        return q / np.linalg.norm(q, axis=1, keepdims=True), out[:, 4:]

    def _rates(self, t_s: float, y: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """Rates (7,) of a state (7,): of its quaternion [1/s] and of its angular velocity [rad/s2]."""
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


class _Beyond(Exception):
    """A step leads beyond the last time that is asked for: torques may not be known there."""


class _Flight:
    """The motion of a rigid body from the start on, forwards or backwards, and its states at some of its steps.

    Those steps do not depend on the times that are asked for, so a result does not depend on the times asked for
    before. Steps end where a torque jumps, and at impulses, where the state is that before them.
    """

    def __init__(self, body: RigidBody, sign: float):
        self.sign, self._body, self._inverse = sign, body, np.linalg.inv(body.inertia_kg_m2)
        edges = [sign * np.asarray(torque.edges_s) for torque in body.torques if hasattr(torque, "edges_s")]
        times = [sign * np.asarray(source.times_s, float) for source in body.impulses]
        breaks = np.unique(np.concatenate([[0.0, np.inf], *edges, *times]))
        self._breaks = breaks[breaks >= 0.0]
        self._kicks: dict[float, list[tuple[Any, int]]] = {}
        for source, of_source in zip(body.impulses, times, strict=True):
            for index, time in enumerate(of_source.tolist()):
                self._kicks.setdefault(time, []).append((source, index))
        # Time, state and number of the break before it; the list is replaced and never changed, as threads share it.
        self._marks = [(0.0, np.concatenate([body.q_from_inertial, body.angular_velocity_rad_s]), 0)]

    def at(self, times: np.ndarray) -> np.ndarray:
        """States (N, 7) at ascending times (N,) > 0 from the start; of times before it, their absolute values."""
        marks, found = list(self._marks), np.empty((len(times), 7))
        n_found = 0
        while n_found < len(times):
            k = bisect_left(marks, times[n_found], key=lambda mark: mark[0]) - 1
            n_found, mark = self._leg(marks[k], times, n_found, found)
            if mark is not None and k + 1 == len(marks):
                marks.append(mark)
        if len(marks) > len(self._marks):
            self._marks = marks
        return found

    def _leg(self, mark: tuple[float, np.ndarray, int], times: np.ndarray, n_found: int,
             found: np.ndarray) -> tuple[int, tuple[float, np.ndarray, int] | None]:
        """Integrate from a mark: fill in states, and give how many there are then, and the next mark."""
        t, y, number = mark
        begin, end = self._breaks[number:number + 2].tolist()
        # On an edge itself a torque is that of one side.
        low, high = math.nextafter(begin, end), math.nextafter(end, begin)
        accuracy = {"rtol": self._body.rtol, "atol": self._body.rtol * 1e-2}

        def rates(t_s: float, state: np.ndarray) -> np.ndarray:
            if t_s > times[-1]:
                raise _Beyond
            return self.sign * self._body._rates(self.sign * min(max(t_s, low), high), state, self._inverse)

        try:
            solver = DOP853(rates, t, y, end, **accuracy)
            for _ in range(_STEPS_OF_A_LEG):
                message = solver.step()
                _check(solver.status != "failed", message)
                n_now = int(np.searchsorted(times, solver.t, side="right"))
                if n_now > n_found:
                    found[n_found:n_now] = solver.dense_output()(times[n_found:n_now]).T
                    n_found = n_now
                t, y = solver.t, solver.y
                if solver.status == "finished":
                    return n_found, (end, self._kicked(end, y), number + 1)
        except _Beyond:
            if n_found < len(times):
                # The end is rounded: it is no place beyond.
                rest = solve_ivp(lambda t_s, state: rates(min(t_s, times[-1]), state), (t, times[-1]), y,
                                 method="DOP853", t_eval=times[n_found:], **accuracy)
                _check(rest.success, rest.message)
                found[n_found:] = rest.y.T
            return len(times), None
        return n_found, (t, y, number)

    def _kicked(self, time: float, y: np.ndarray) -> np.ndarray:
        """The state behind the impulses of a time."""
        y = y.copy()
        for source, index in self._kicks.get(time, ()):
            q = y[:4] / np.linalg.norm(y[:4])
            y[4:] += self.sign * self._inverse @ vector("impulses", source.impulse(index, q))
        return y


def _check(has_motion: bool, message: str | None) -> None:
    if not has_motion:
        raise ConfigError("torques", f"leave no motion to integrate: {message}")


@dataclass(frozen=True, kw_only=True, eq=False)
class GravityGradient:
    """The torque of a point mass's gravity on an extended body.

    Parameters
    ----------
    inertia_kg_m2 : (3, 3) or (3,) float [kg m2]
        As of `RigidBody`.
    gravitational_parameter_m3_s2 : float [m3/s2], > 0
        Parameter of the attracting mass.
    trajectory : Trajectory
        Trajectory of the turning body about that mass.
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
