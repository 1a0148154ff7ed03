"""Torques on a rigid body: a coma's drag and dust, thrusters and wheels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from glrender_camera.validate import integer, positive, vector, within
from scipy.spatial.transform import Rotation

from ..base.errors import ConfigError
from .checks import at_most, duration, length, numbers, speed, unit
from .dynamics import cross
from .epochs import Epoch
from .paths import Trajectory

_MAX_IMPACTS = 100_000
_MAX_DENSITY_KG_M3, _MAX_AREA_M2, _MAX_FORCE_N, _MAX_MASS_KG = 10.0, 1e8, 1e9, 1e6

_ORIGIN: Any = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plate:
    """A flat part of a spacecraft's surface.

    Parameters
    ----------
    area_m2 : float [m2], > 0
    normal : (3,) float
        Outward, in the frame, of any length.
    centre_m : (3,) float [m]
        From the centre of mass, in the frame.
    """

    area_m2: float
    normal: np.ndarray
    centre_m: np.ndarray

    def __post_init__(self):
        at_most("area_m2", self.area_m2, _MAX_AREA_M2)
        object.__setattr__(self, "normal", unit("normal", self.normal))
        object.__setattr__(self, "centre_m", vector("centre_m", self.centre_m))


@dataclass(frozen=True, kw_only=True, eq=False)
class GasDrag:
    """The torque of a coma's gas that flows out radially and falls off with the square of the distance.

    Parameters
    ----------
    trajectory : Trajectory
        Trajectory of the turning body about the one with the coma.
    density_kg_m3 : float [kg/m3], > 0, or callable
        At `reference_distance_m`; or a function of the position (3,) [m] from the comet, ICRF axes.
    outflow_speed_m_s : float [m/s], > 0, or callable
        Radial; or a function of the position to the gas's velocity (3,) [m/s], relative to the comet.
    reference_distance_m : float [m], > 0
    area_m2, centre_of_pressure_m : float [m2], (3,) float [m]
        Cross-section, the same from everywhere, and its centre from the centre of mass in the frame; or
    plates : sequence of Plate
        Plates; those that face the flow count, without shadows of one on another.
    drag_coefficient : float [1], 0..10
    start : Epoch, optional
        The scenario's.

    Source: Vallado (2013), section 8.6.2: F = 1/2 rho v^2 C_D A, along the flow; of a plate A is A cos(incidence).
    """

    trajectory: Trajectory
    density_kg_m3: float | Callable[[np.ndarray], float]
    outflow_speed_m_s: float | Callable[[np.ndarray], np.ndarray]
    reference_distance_m: float = 1.0
    area_m2: float | None = None
    centre_of_pressure_m: np.ndarray = field(default=_ORIGIN)
    plates: Sequence[Plate] = ()
    drag_coefficient: float = 2.2
    start: Epoch | None = None

    def __post_init__(self):
        if not callable(self.density_kg_m3):
            at_most("density_kg_m3", self.density_kg_m3, _MAX_DENSITY_KG_M3)
        if not callable(self.outflow_speed_m_s):
            speed("outflow_speed_m_s", self.outflow_speed_m_s)
        length("reference_distance_m", self.reference_distance_m)
        within("drag_coefficient", self.drag_coefficient, 0.0, 10.0)
        if (self.area_m2 is None) == (not self.plates):
            raise ConfigError("area_m2", "needs exactly one of `area_m2` and `plates`", self.area_m2)
        if self.area_m2 is not None:
            at_most("area_m2", self.area_m2, _MAX_AREA_M2)
        object.__setattr__(self, "centre_of_pressure_m", vector("centre_of_pressure_m", self.centre_of_pressure_m))

    def __call__(self, t_s: float, q_from_inertial: np.ndarray, angular_velocity_rad_s: np.ndarray) -> np.ndarray:
        """The torque (3,) [N m] in the frame."""
        return sum((cross(place, force) for place, force in self.forces(t_s, q_from_inertial)), np.zeros(3))

    def forces(self, t_s: float, q_from_inertial: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Places (3,) [m] and forces (3,) [N] on the body, in the frame."""
        (r,), (flow,) = _flow(self.trajectory, self.start, self.outflow_speed_m_s, np.array([t_s]))
        if callable(self.density_kg_m3):
            density = float(self.density_kg_m3(r))
        else:
            density = self.density_kg_m3 * (self.reference_distance_m / float(np.linalg.norm(r)))**2
        flow = Rotation.from_quat(q_from_inertial, scalar_first=True).apply(flow)
        pressure = 0.5 * density * self.drag_coefficient * float(np.linalg.norm(flow)) * flow
        if self.area_m2 is not None:
            return [(self.centre_of_pressure_m, pressure * self.area_m2)]
        ahead = flow / max(float(np.linalg.norm(flow)), 1e-300)
        return [(plate.centre_m, pressure * plate.area_m2 * max(0.0, -float(plate.normal @ ahead)))
                for plate in self.plates]


@dataclass(frozen=True, kw_only=True, eq=False)
class DustImpacts:
    """Angular impulses of dust grains that hit at random times and places; the same for the same seed.

    Parameters
    ----------
    trajectory : Trajectory
        Trajectory of the turning body about the one that the dust flows from.
    rate_hz : float [1/s], > 0
        Mean number of impacts a second; arrivals are Poisson's.
    grain_mass_kg : float [kg], > 0
    outflow_speed_m_s : float [m/s], > 0, or callable
        As of `GasDrag`.
    radius_m : float [m], > 0
        Radius of the disc across the flow that grains hit evenly; each stops there.
    centre_m : (3,) float [m]
        Place of that disc from the centre of mass, in the frame.
    seed : int
    duration_s : float [s], > 0
        From the scenario's start, in which grains come: 1e5 at most.
    start : Epoch, optional
        The scenario's.

    Attributes
    ----------
    times_s : (K,) float64 [s]
        Times of the impacts, ascending.
    """

    trajectory: Trajectory
    rate_hz: float
    grain_mass_kg: float
    outflow_speed_m_s: float | Callable[[np.ndarray], np.ndarray]
    radius_m: float
    seed: int
    duration_s: float
    centre_m: np.ndarray = field(default=_ORIGIN)
    start: Epoch | None = None

    if TYPE_CHECKING:  # made in __post_init__
        times_s: np.ndarray = field(init=False)
        _places: np.ndarray = field(init=False)

    def __post_init__(self):
        at_most("grain_mass_kg", self.grain_mass_kg, _MAX_MASS_KG)
        length("radius_m", self.radius_m)
        if not callable(self.outflow_speed_m_s):
            speed("outflow_speed_m_s", self.outflow_speed_m_s)
        object.__setattr__(self, "centre_m", vector("centre_m", self.centre_m))
        if not positive("rate_hz", self.rate_hz) * duration("duration_s", self.duration_s) <= 0.9 * _MAX_IMPACTS:
            raise ConfigError("rate_hz", f"times duration_s must be at most {0.9 * _MAX_IMPACTS:g} impacts",
                              self.rate_hz, "give fewer and heavier grains")
        rng = np.random.default_rng(integer("seed", self.seed, 0, 2**63))
        count = rng.poisson(self.rate_hz * self.duration_s)
        object.__setattr__(self, "times_s", np.sort(rng.uniform(0.0, self.duration_s, count)))
        object.__setattr__(self, "_places", np.stack([self.radius_m * np.sqrt(rng.uniform(size=count)),
                                                      rng.uniform(0.0, 2.0 * np.pi, count)], axis=1))

    def impulse(self, index: int, q_from_inertial: np.ndarray) -> np.ndarray:
        """The angular impulse (3,) [N m s] of one impact, in the frame."""
        return self.impulses(np.array([index]), q_from_inertial)[0]

    def impulses(self, indices: np.ndarray, q_from_inertial: np.ndarray) -> np.ndarray:
        """The angular impulses (N, 3) [N m s] of impacts (N,) on a body with one attitude, in the frame."""
        _, flow = _flow(self.trajectory, self.start, self.outflow_speed_m_s, self.times_s[indices])
        off, angle = self._places[indices].T
        across = np.cross(flow, np.eye(3)[np.argmin(np.abs(flow), axis=1)])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        other = np.cross(flow, across) / np.maximum(np.linalg.norm(flow, axis=1, keepdims=True), 1e-300)
        turn = Rotation.from_quat(q_from_inertial, scalar_first=True)
        on_disc = (off * np.cos(angle))[:, None] * across + (off * np.sin(angle))[:, None] * other
        return np.cross(self.centre_m + turn.apply(on_disc), turn.apply(self.grain_mass_kg * flow))


@dataclass(frozen=True, kw_only=True, eq=False)
class Thruster:
    """The torque of a thruster's pulses.

    Parameters
    ----------
    force_N : (3,) float [N]
        On the spacecraft, in the frame.
    place_m : (3,) float [m]
        From the centre of mass, in the frame.
    pulses_s : (K, 2) float [s]
        On and off, from the scenario's start; each later than the one before.

    Attributes
    ----------
    edges_s : (2 K,) float64 [s]
        Where the torque jumps.
    """

    force_N: np.ndarray
    place_m: np.ndarray
    pulses_s: np.ndarray

    if TYPE_CHECKING:  # made in __post_init__
        edges_s: np.ndarray = field(init=False)
        _torque: np.ndarray = field(init=False)

    def __post_init__(self):
        force = vector("force_N", self.force_N)
        if not (np.abs(force) <= _MAX_FORCE_N).all():
            raise ConfigError("force_N", f"must be within {_MAX_FORCE_N:g} N", force.tolist())
        object.__setattr__(self, "_torque", np.cross(vector("place_m", self.place_m), force))
        pulses = numbers("pulses_s", self.pulses_s)
        if pulses.ndim != 2 or pulses.shape[1:] != (2,) or not (np.diff(pulses.ravel()) > 0.0).all():
            raise ConfigError("pulses_s", "must be pairs of on and off, ascending", self.pulses_s)
        object.__setattr__(self, "edges_s", pulses.ravel())

    def __call__(self, t_s: float, q_from_inertial: np.ndarray, angular_velocity_rad_s: np.ndarray) -> np.ndarray:
        """The torque (3,) [N m] in the frame."""
        return self._torque if np.searchsorted(self.edges_s, t_s, side="right") % 2 else np.zeros(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Wheels:
    """The torque of reaction wheels whose momentum follows a table: on the body acts what theirs loses.

    Parameters
    ----------
    times_s : (N,) float [s]
        Ascending, from the scenario's start, N >= 2; before and after them the momentum stays.
    momentum_N_m_s : (N, 3) float [N m s]
        Momentum of all wheels, in the frame; linear between the times.

    Attributes
    ----------
    edges_s : (N,) float64 [s]
        Where the torque jumps.

    Source: Wertz (1978), equation 16-53: - h' - omega x h.
    """

    times_s: np.ndarray
    momentum_N_m_s: np.ndarray

    if TYPE_CHECKING:  # made in __post_init__
        edges_s: np.ndarray = field(init=False)
        _momentum: np.ndarray = field(init=False)
        _slopes: np.ndarray = field(init=False)

    def __post_init__(self):
        times, momentum = numbers("times_s", self.times_s), numbers("momentum_N_m_s", self.momentum_N_m_s)
        if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise ConfigError("times_s", "must be two times or more, ascending", self.times_s)
        if momentum.shape != (len(times), 3) or not (np.abs(momentum) <= _MAX_FORCE_N).all():
            raise ConfigError("momentum_N_m_s", f"must be {len(times)} rows of three numbers, one a time",
                              self.momentum_N_m_s)
        object.__setattr__(self, "edges_s", times)
        object.__setattr__(self, "_momentum", momentum)
        object.__setattr__(self, "_slopes", np.diff(momentum, axis=0) / np.diff(times)[:, None])

    def momentum(self, t_s: float) -> np.ndarray:
        """The wheels' momentum (3,) [N m s] in the frame."""
        return np.array([np.interp(t_s, self.edges_s, column) for column in self._momentum.T])

    def __call__(self, t_s: float, q_from_inertial: np.ndarray, angular_velocity_rad_s: np.ndarray) -> np.ndarray:
        """The torque (3,) [N m] in the frame."""
        row = int(np.searchsorted(self.edges_s, t_s, side="right")) - 1
        slope = self._slopes[row] if 0 <= row < len(self._slopes) else np.zeros(3)
        return -slope - cross(angular_velocity_rad_s, self.momentum(t_s))


def _flow(trajectory: Trajectory, start: Epoch | None, outflow: float | Callable[[np.ndarray], np.ndarray],
          t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) [m] from the comet, and velocities (N, 3) [m/s] of what flows out relative to the body there."""
    r, v = trajectory.at(start, t_s)
    if callable(outflow):
        away = np.array([vector("outflow_speed_m_s", outflow(place)) for place in r]).reshape(-1, 3)
    else:
        away = outflow * r / np.linalg.norm(r, axis=1, keepdims=True)
    return r, away - v
