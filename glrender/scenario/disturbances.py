"""Disturbances of an attitude: an offset, and jitter of a given spectrum."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from glrender_camera.validate import integer, unit_quaternion, vector
from scipy.spatial.transform import Rotation

from ..base.errors import ConfigError
from .attitude import IDENTITY, Attitude, Geometry
from .checks import numbers
from .epochs import Epoch

_MAX_FREQUENCY_HZ = 1e6
_NONE: Any = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbed:
    """An attitude with a constant offset, and with jitter.

    Parameters
    ----------
    attitude : Attitude
        Attitude of the spacecraft.
    offset_rad : (3,) float [rad]
        Turns of the camera about its X, Y and Z, as a rotation vector: +X lifts the view, +Y moves it right.
    jitter : Jitter, optional
    q_camera_from_spacecraft : (4,) float
        The camera's mounting; both disturbances are about the camera's axes.
    """

    attitude: Attitude
    offset_rad: np.ndarray = field(default=_NONE)
    jitter: Jitter | None = None
    q_camera_from_spacecraft: np.ndarray = field(default=IDENTITY)

    def __post_init__(self):
        object.__setattr__(self, "offset_rad", vector("offset_rad", self.offset_rad))
        if not (np.abs(self.offset_rad) <= 2.0 * np.pi).all():
            raise ConfigError("offset_rad", "must be within a turn", self.offset_rad.tolist())
        object.__setattr__(self, "q_camera_from_spacecraft",
                           unit_quaternion("q_camera_from_spacecraft", self.q_camera_from_spacecraft))

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray | None]:
        """Attitudes and rates, as `Attitude` has them; of jitter to first order in its angles."""
        q, rates = self.attitude.at(geometry, owner)
        camera = Rotation.from_quat(self.q_camera_from_spacecraft, scalar_first=True)
        angles, angle_rates = np.zeros((len(q), 3)), np.zeros((len(q), 3))
        if self.jitter is not None:
            angles, angle_rates = self.jitter.angles(geometry.t_s)
        turn = camera.inv() * Rotation.from_rotvec(-angles) * Rotation.from_rotvec(-self.offset_rad) * camera
        return ((turn * Rotation.from_quat(q, scalar_first=True)).as_quat(scalar_first=True),
                None if rates is None else turn.apply(rates) + camera.inv().apply(angle_rates))

    def notes_at(self, start: Epoch | None, t_s: np.ndarray) -> list[str]:
        """Sentences of the attitude that is disturbed, where it has some."""
        return self.attitude.notes_at(start, t_s) if hasattr(self.attitude, "notes_at") else []


@dataclass(frozen=True, kw_only=True, eq=False)
class Jitter:
    """Small turns of a camera with a given spectrum: a sum of sines of random phases, the same for the same seed.

    All lines of an axis have the same power; each is at a random place in its share of the spectrum. Evenly spaced
    lines would repeat after the inverse of their distance, and leave decades of a wide spectrum without one.

    Parameters
    ----------
    frequency_hz : (K,) float [Hz], ascending, > 0, K >= 2
    density_rad2_hz : (K,) or (K, 3) float [rad2/Hz], 0..1
        One-sided power spectral density about X, Y and Z; linear between the frequencies.
    seed : int
    lines : int
        Sines about each axis.

    Source: Shinozuka and Deodatis (1991), spectral representation: amplitudes sqrt(2 S df).
    Source: Shinozuka and Jan (1972): frequencies moved at random against the period of the sum.
    """

    frequency_hz: np.ndarray
    density_rad2_hz: np.ndarray
    seed: int
    lines: int = 200

    if TYPE_CHECKING:  # made in __post_init__
        _omega: np.ndarray = field(init=False)
        _amplitude: np.ndarray = field(init=False)
        _phase: np.ndarray = field(init=False)

    def __post_init__(self):
        frequency = numbers("frequency_hz", self.frequency_hz)
        if (frequency.ndim != 1 or len(frequency) < 2 or not (np.diff(frequency) > 0.0).all()
                or not (frequency[0] > 0.0 and frequency[-1] <= _MAX_FREQUENCY_HZ)):
            raise ConfigError("frequency_hz", "must be at least two ascending frequencies > 0, up to "
                              f"{_MAX_FREQUENCY_HZ:g} Hz", self.frequency_hz)
        density = numbers("density_rad2_hz", self.density_rad2_hz)
        density = np.repeat(density[:, None], 3, axis=1) if density.ndim == 1 else density
        if density.shape != (len(frequency), 3) or not ((density >= 0.0) & (density <= 1.0)).all():
            raise ConfigError("density_rad2_hz", "must be 0..1, one number or three for each frequency",
                              self.density_rad2_hz)
        integer("lines", self.lines, 1, 100_000)
        integer("seed", self.seed, 0, 2**63)
        rng, shape = np.random.default_rng(self.seed), (int(self.lines), 3)
        phase, place = rng.uniform(0.0, 2.0 * np.pi, shape), rng.uniform(0.0, 1.0, shape)
        share = (np.arange(self.lines)[:, None] + place) / self.lines
        lines, power = zip(*(_line_places(frequency, *pair) for pair in zip(density.T, share.T, strict=True)),
                           strict=True)
        object.__setattr__(self, "_omega", 2.0 * np.pi * np.stack(lines, axis=1))
        object.__setattr__(self, "_amplitude", np.sqrt(2.0 * np.array(power) / self.lines))
        object.__setattr__(self, "_phase", phase)

    def angles(self, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles (N, 3) [rad] about X, Y and Z, and their rates (N, 3) [rad/s], at times (N,) [s]."""
        angles, rates = np.empty((len(t_s), 3)), np.empty((len(t_s), 3))
        # A frame at a time: all at once would need lines x frames of memory.
        for index, t in enumerate(t_s):
            argument = self._omega * t + self._phase
            angles[index] = self._amplitude * np.sin(argument).sum(axis=0)
            rates[index] = self._amplitude * (self._omega * np.cos(argument)).sum(axis=0)
        return angles, rates


def _line_places(frequency: np.ndarray, density: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, float]:
    """Frequencies (L,) [Hz] below which a spectrum has the shares (L,) of its power, and that power [rad2]."""
    power = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(frequency))])
    wanted = share * power[-1]
    k = np.clip(np.searchsorted(power, wanted, side="right") - 1, 0, len(frequency) - 2)
    # The density is linear between two points: d x + slope x^2 / 2 = rest, in the form that holds at slope 0.
    rest, d = wanted - power[k], density[k]
    slope = (np.diff(density) / np.diff(frequency))[k]
    root = d + np.sqrt(np.maximum(d * d + 2.0 * slope * rest, 0.0))
    x = np.divide(2.0 * rest, root, out=np.zeros_like(rest), where=root > 0.0)
    return np.minimum(frequency[k] + x, frequency[k + 1]), float(power[-1])
