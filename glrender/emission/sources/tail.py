"""A dust tail after Finson and Probstein: grains of all sizes leave the nucleus, each on an orbit of its own.

Radiation pressure takes a share beta of the Sun's gravity from a grain, the more the smaller it is. Grains of
one beta and all ages lie on a syndyne, of one age and all betas on a synchrone.

Frame `tail`: x away from the Sun, z along the orbit's pole, y so that x, y, z are right-handed: along the motion.

Source: Finson and Probstein (1968), ApJ 154, 327; Burns, Lamy and Soter (1979), Icarus 40, 1, for beta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import integer, positive, vector, within

from ...base.constants import AU_M
from ...base.errors import ConfigError
from ..fields import CartesianField
from .orbit import SUN_GM_M3_S2, comet_state, propagate
from .volume import Volume

SUN_LUMINOSITY_W = 3.828e26
"""Nominal solar luminosity [W]; IAU 2015 resolution B3."""
_SPEED_OF_LIGHT_M_S = 299_792_458.0
# Youngest grains over the oldest: equal numbers in each octave of age resolve the head as well as the end.
_YOUNGEST = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Tail:
    """Dust that has left the nucleus over a time.

    Parameters
    ----------
    weight_m : float [m], > 0
        Mean of K near the nucleus, of the present rate.
    perihelion_au : float [au], > 0
    eccentricity : float [1], 0..10
    true_anomaly_deg : float [deg], -180..180
        Anomaly of the comet when it is seen.
    pole_inertial : (3,) float [1]
        Pole of the orbit: the comet goes round it counter-clockwise.
    oldest_s : float [s], > 0
        Age of the oldest grains.
    length_m : float [m], > 0
        Grains farther from the nucleus are left out.
    smallest_m, largest_m : float [m], > 0
        Radii of grains.
    size_exponent : float [1], 1..6
        q of their numbers, a^-q da, as they leave.
    density_kg_m3, pressure_efficiency : float, > 0
        Density and efficiency of the grains: beta = 5.74e-4 Q / (density [kg/m3] a [m]).
    speed_m_s : float [m/s], > 0
        At which grains of beta 1 leave at 1 au, in all directions.
    speed_exponent : float [1], 0..1
        Power of beta in the speed, which falls with the root of the distance from the Sun.
    rate_exponent : float [1], 0..8
        The rate goes with that power of the inverse distance from the Sun.
    particles, cells, seed : int
        Of the sum over grains; cells along the box's longest side.
    """

    weight_m: float
    perihelion_au: float
    eccentricity: float
    true_anomaly_deg: float
    pole_inertial: np.ndarray
    oldest_s: float
    length_m: float
    smallest_m: float = 1e-6
    largest_m: float = 1e-3
    size_exponent: float = 3.5
    density_kg_m3: float = 800.0
    pressure_efficiency: float = 1.0
    speed_m_s: float = 400.0
    speed_exponent: float = 0.5
    rate_exponent: float = 2.0
    particles: int = 120_000
    cells: int = 96
    seed: int = 0

    def __post_init__(self):
        for name in ("weight_m", "perihelion_au", "oldest_s", "length_m", "smallest_m", "largest_m", "density_kg_m3",
                     "pressure_efficiency", "speed_m_s"):
            positive(name, getattr(self, name))
        for name, low, high in (("eccentricity", 0.0, 10.0), ("true_anomaly_deg", -180.0, 180.0),
                                ("size_exponent", 1.0, 6.0), ("speed_exponent", 0.0, 1.0), ("rate_exponent", 0.0, 8.0)):
            within(name, getattr(self, name), low, high)
        if not self.largest_m > self.smallest_m:
            raise ConfigError("largest_m", "must be above smallest_m", self.largest_m)
        for name, low, high in (("particles", 1000, 5_000_000), ("cells", 8, 160), ("seed", 0, 2**32 - 1)):
            integer(name, getattr(self, name), low, high)
        pole = vector("pole_inertial", self.pole_inertial)
        if not np.linalg.norm(pole) > 0.0:
            raise ConfigError("pole_inertial", "must not be zero", pole.tolist())
        object.__setattr__(self, "pole_inertial", pole / np.linalg.norm(pole))
        self._comet()

    def beta(self, radius_m: np.ndarray) -> np.ndarray:
        """Radiation pressure over gravity [1] of grains of a radius [m]."""
        return (3.0 * SUN_LUMINOSITY_W * self.pressure_efficiency
                / (16.0 * math.pi * SUN_GM_M3_S2 * _SPEED_OF_LIGHT_M_S * self.density_kg_m3 * radius_m))

    def grains(self, beta: np.ndarray, age_s: np.ndarray, speed_m_s: np.ndarray | None = None) -> np.ndarray:
        """Present places of grains: (N, 3) [m] from the nucleus, frame `tail`.

        Parameters
        ----------
        beta, age_s : (N,) float [1], [s]
            One age is a synchrone, one beta a syndyne.
        speed_m_s : (N, 3) float [m/s], optional
            Velocities at which they left, in the orbit's plane frame (x to the perihelion); at rest by default.
        """
        beta, age = (np.asarray(x, np.float64) for x in (beta, age_s))
        r, v = (np.broadcast_to(x, (len(age), 3)) for x in self._comet())
        r_left, v_left = propagate(r, v, np.full(len(age), SUN_GM_M3_S2), -age)
        if speed_m_s is not None:
            v_left = v_left + speed_m_s
        now, _ = propagate(r_left, v_left, (1.0 - beta) * SUN_GM_M3_S2, age)
        # Metres of round-off in 1e11: far below a cell.
        return (now - r) @ self._tail_axes().T

    def _comet(self) -> tuple[np.ndarray, np.ndarray]:
        return comet_state(self.perihelion_au * AU_M, self.eccentricity, math.radians(self.true_anomaly_deg))

    def _tail_axes(self) -> np.ndarray:
        x = self._comet()[0]
        x = x / np.linalg.norm(x)
        return np.stack([x, np.cross([0.0, 0.0, 1.0], x), [0.0, 0.0, 1.0]])

    def sample(self) -> tuple[np.ndarray, np.ndarray]:
        """Grains drawn by size, age and direction: positions (N, 3) [m], frame `tail`, and cross-sections (N,) [m2]."""
        rng = np.random.default_rng(self.seed)
        count = self.particles
        share = lambda: (np.arange(count) + rng.uniform(size=count))[rng.permutation(count)] / count  # noqa: E731
        size_span, age_span = math.log(self.largest_m / self.smallest_m), -math.log(_YOUNGEST)
        radius = self.smallest_m * np.exp(size_span * share())
        age = self.oldest_s * np.exp(-age_span * share())
        cos_polar, azimuth = 2.0 * share() - 1.0, 2.0 * np.pi * share()
        sin_polar = np.sqrt(1.0 - cos_polar**2)
        way = np.stack([sin_polar * np.cos(azimuth), sin_polar * np.sin(azimuth), cos_polar], axis=1)
        comet_r, comet_v = (np.broadcast_to(x, (count, 3)) for x in self._comet())
        left_au = np.linalg.norm(propagate(comet_r, comet_v, np.full(count, SUN_GM_M3_S2), -age)[0], axis=1) / AU_M
        speed = self._speed(radius, left_au)
        now_au = float(np.linalg.norm(comet_r[0])) / AU_M
        # Cross-section a year sends out in a size: W a^(2-q) da, the sum of which over 4 pi v is K of today.
        size_share = radius ** (3.0 - self.size_exponent) * size_span / count
        rate = self.weight_m * size_share / np.sum(size_share / (4.0 * np.pi * self._speed(radius, now_au)))
        section = rate * (left_au / now_au) ** -self.rate_exponent * age * age_span
        return self.grains(self.beta(radius), age, speed[:, None] * way), section

    def _speed(self, radius_m: np.ndarray, sun_distance_au: np.ndarray) -> np.ndarray:
        return self.speed_m_s * self.beta(radius_m) ** self.speed_exponent / np.sqrt(sun_distance_au)

    def field(self, least_m: float) -> CartesianField:
        """Weights of the grains in cells of a box around the nucleus."""
        r, section = self.sample()
        near = np.linalg.norm(r, axis=1) < self.length_m
        r, section = r[near], section[near]
        if len(r) < 100:
            raise ConfigError("length_m", "must hold more grains: all but a few are farther away", self.length_m)
        low, high = np.minimum(np.quantile(r, 0.002, axis=0), 0.0), np.maximum(np.quantile(r, 0.998, axis=0), 0.0)
        cell = float((high - low).max()) / (self.cells - 4)
        low, shape = low - 2.0 * cell, np.ceil((high - low) / cell).astype(int) + 4
        dust = deposit(r, section, low, cell, tuple(shape)) / cell**3
        return Volume(cross_section_per_m=dust, low_m=low, high_m=low + shape * cell).field(least_m)

    def field_from_body(self, body_from_inertial: np.ndarray, sun_direction_body: np.ndarray) -> np.ndarray:
        """(3, 3) float64 rotation into `tail`: it turns with the Sun."""
        x = -sun_direction_body
        pole = body_from_inertial @ self.pole_inertial
        y = np.cross(pole, x)
        if not np.linalg.norm(y) > 1e-6:
            raise ConfigError("pole_inertial", "must not point to the Sun: the orbit's plane holds it",
                              self.pole_inertial.tolist())
        y = y / np.linalg.norm(y)
        return np.stack([x, y, np.cross(x, y)])


def deposit(r_m: np.ndarray, amount: np.ndarray, low_m: np.ndarray, cell_m: float,
            shape: tuple[int, int, int]) -> np.ndarray:
    """Amounts (N,) at points (N, 3) [m], each shared by the eight cells around it (cloud in cell)."""
    place = (r_m - low_m) / cell_m - 0.5
    first = np.floor(place).astype(int)
    part = place - first
    total = np.zeros(int(np.prod(shape)))
    for corner in np.ndindex(2, 2, 2):
        index = first + corner
        inside = ((index >= 0) & (index < shape)).all(axis=1)
        weight = np.prod(np.where(corner, part, 1.0 - part), axis=1) * amount
        flat = np.ravel_multi_index(tuple(index[inside].T), shape)
        total += np.bincount(flat, weights=weight[inside], minlength=len(total))
    return total.reshape(shape)
