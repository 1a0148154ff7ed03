"""One octave of a body's surface detail on a lattice of cubes: noise, craters or boulders. In float64."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .config import Detail

NOISE, CRATER, BOULDER = range(3)
# Radii of rims that a crater's ejecta reach; height of a rim over the crater's radius, of its depth.
_REACH, _RIM = 1.6, 0.2
# Radius of the largest sphere of influence over a cube's side [1]; the centres of smaller ones move.
_SPHERE = {CRATER: 0.5, BOULDER: 0.4}
# Mean cube of sizes that are even between a half and one: of features over that of the largest.
_MEAN_CUBE = 0.46875
_X, _Y, _Z = (np.uint32(prime) for prime in (0x8DA6B343, 0xD8163841, 0xCB1AB31F))


def hashed(value: np.ndarray) -> np.ndarray:
    """A bijection of uint32 whose bits depend on all bits (Wellons' lowbias32)."""
    value = np.array(value, np.uint32, ndmin=1)
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        value ^= value >> np.uint32(shift)
        value *= np.uint32(factor)
    value ^= value >> np.uint32(16)
    return value


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """One octave of one kind; float32 values, as the shader has them.

    Attributes
    ----------
    kind : int
        NOISE, CRATER or BOULDER.
    lattice_from_body : (3, 3) float64 [1/m]
        Into cubes of side 1.
    seed : int
        Below 2^24, exact in float32.
    scale_m : float [m]
        Wavelength, or least diameter: what a pixel must resolve.
    size : float
        Amplitude of noise [m]; of a crater its depth, of a boulder its height, over its radius.
    share : float [1]
        Share of the cubes that have a feature.
    radius : float [1]
        Radius of the largest feature, over the cube's side.
    """

    kind: int
    lattice_from_body: np.ndarray
    seed: int
    scale_m: float
    size: float
    share: float = 0.0
    radius: float = 0.0

    @property
    def bound_m(self) -> float:
        """Largest rise or fall of the layer [m]."""
        return self.size * (1.0 if self.kind == NOISE else self.radius * self.cell_m)

    @property
    def cell_m(self) -> float:
        """Side of a cube."""
        return 1.0 / float(np.linalg.norm(self.lattice_from_body[0]))

    @property
    def slope_rms(self) -> float:
        """Slope along a surface: two thirds of the gradient's square, over some cubes."""
        place = np.random.default_rng(0).uniform(0.0, 64.0, (3, 2048))
        _, slope = self._at(place)
        return self.size * float(np.sqrt(2.0 / 3.0 * np.mean(sum(part * part for part in slope))))

    def __call__(self, r: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Height [m] and its gradient, three (N,) [1], over `size`, at three (N,) body coordinates [m]."""
        return self._at(product(self.lattice_from_body, r))

    def _at(self, place: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        cell = [np.floor(p) for p in place]
        place = [p - c for p, c in zip(place, cell, strict=True)]
        x, y, z = (c.astype(np.int64).astype(np.uint32) for c in cell)
        key = np.uint32(self.seed) + x * _X + y * _Y + z * _Z
        value, slope = self._noise(key, place) if self.kind == NOISE else self._feature(key, place)
        return value, product(self.lattice_from_body.T, slope)

    def _noise(self, key: np.ndarray, place: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Noise within -1..1 and its gradient along the lattice."""
        u, v, w = (p * p * p * (p * (p * 6.0 - 15.0) + 10.0) for p in place)
        rate = [30.0 * (p * (p - 1.0)) ** 2 for p in place]
        a, b, c, d, e, f, g, h = ((hashed(key + z + y + x) >> np.uint32(8)).astype(np.float64) * 2.0**-23 - 1.0
                                  for z in (np.uint32(0), _Z) for y in (np.uint32(0), _Y) for x in (np.uint32(0), _X))
        along_x = _mix(_mix(b - a, d - c, v), _mix(f - e, h - g, v), w)
        along_y = _mix(_mix(c - a, d - b, u), _mix(g - e, h - f, u), w)
        along_z = _mix(_mix(e - a, f - b, u), _mix(g - c, h - d, u), v)
        value = _mix(_mix(a, c, v), _mix(e, g, v), w) + u * along_x
        return value, [rate[0] * along_x, rate[1] * along_y, rate[2] * along_z]

    def _feature(self, key: np.ndarray, place: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """A crater's or boulder's height and, along the lattice, gradient."""
        value, slope = np.zeros(len(key)), [np.zeros(len(key)) for _ in range(3)]
        key = hashed(key)
        here = np.flatnonzero((key >> np.uint32(8)).astype(np.float64) * 2.0**-24 < self.share)
        own = hashed(key[here] + np.uint32(1))
        byte = [((own >> np.uint32(8 * k)) & np.uint32(255)).astype(np.float64) / 255.0 for k in range(4)]
        radius = self.radius * (0.5 + 0.5 * byte[3])
        reach = radius * (_REACH if self.kind == CRATER else 1.0)
        aside = [(p[here] - 0.5 - (2.0 * b - 1.0) * (0.5 - reach)) / radius
                 for p, b in zip(place, byte[:3], strict=True)]
        t = aside[0] * aside[0] + aside[1] * aside[1] + aside[2] * aside[2]
        form, rate = (_crater if self.kind == CRATER else _boulder)(t)
        value[here] = form * radius * self.cell_m
        for part, along in zip(slope, aside, strict=True):
            part[here] = 2.0 * rate * along * self.cell_m
        return value, slope


def layers_of(detail: Detail) -> tuple[Layer, ...]:
    """The layers of a detail, each kind from its largest scale to its smallest."""
    made: list[Layer] = []

    def add(kind: int, cell_m: float, **values: float) -> None:
        seed = int(hashed((detail.seed * 0x9E3779B1 + len(made) * 0x85EBCA6B) & 0xFFFFFFFF)[0])
        rotation = _rotation(seed)
        values = {name: float(np.float32(value)) for name, value in values.items()}
        made.append(Layer(kind=kind, seed=seed >> 8, lattice_from_body=(rotation / cell_m).astype(np.float32)
                          .astype(np.float64), **values))

    if (noise := detail.noise) is not None:
        for scale in _octaves(noise.longest_m, noise.shortest_m):
            # A wave is a corner up and a corner down.
            add(NOISE, 0.5 * scale, scale_m=scale, size=noise.amplitude_m * (scale / noise.longest_m) ** noise.exponent)
    for kind, asked, reach in ((CRATER, detail.craters, _REACH), (BOULDER, detail.boulders, 1.0)):
        if asked is None or not asked.coverage:
            continue
        size = 2.0 * (asked.depth if kind == CRATER else asked.height)
        radius = _SPHERE[kind] / reach
        # A plane cuts of spheres an area equal to their share of the volume.
        most = 4.0 / 3.0 * np.pi * radius**3 * _MEAN_CUBE
        n_lattices = int(np.ceil(asked.coverage / most))
        for diameter in _octaves(asked.largest_m, asked.smallest_m):
            for _ in range(n_lattices):
                add(kind, 0.5 * diameter / radius, scale_m=0.5 * diameter, size=size,
                    share=asked.coverage / (n_lattices * most), radius=radius)
    return tuple(made)


def _octaves(large: float, small: float) -> list[float]:
    return [large * 0.5**k for k in range(int(np.floor(np.log2(large / small) + 1e-9)) + 1)]


def _rotation(seed: int) -> np.ndarray:
    """A rotation (3, 3) of its own for each seed; of sums, products and roots alone, which are the same everywhere."""
    q = hashed(np.uint32(seed) + np.arange(1, 5, dtype=np.uint32)).astype(np.float64) * 2.0**-31 - 1.0
    w, x, y, z = q / np.sqrt((q * q).sum())
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def product(matrix: np.ndarray, r: list[np.ndarray]) -> list[np.ndarray]:
    """matrix @ r of three (N,), in one order of sums on all machines."""
    x, y, z = r
    return [row[0] * x + row[1] * y + row[2] * z for row in matrix]


def _mix(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    return a + (b - a) * share


def _crater(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height over the radius, and its rate, by the square of the distance from the middle over the radius."""
    u = np.minimum(t, 1.0)
    v = np.clip((t - 1.0) / (_REACH**2 - 1.0), 0.0, 1.0)
    value = np.where(t < 1.0, (1.0 + _RIM) * u * u * (3.0 - 2.0 * u) - 1.0, _RIM * (1.0 - v * v * (3.0 - 2.0 * v)))
    rate = np.where(t < 1.0, (1.0 + _RIM) * 6.0 * u * (1.0 - u), -_RIM * 6.0 * v * (1.0 - v) / (_REACH**2 - 1.0))
    return value, rate


def _boulder(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A boulder, with the arguments and results of `_crater`."""
    u = np.maximum(1.0 - t, 0.0)
    return u * u, -2.0 * u
