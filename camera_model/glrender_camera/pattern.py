"""The sensor's own fixed pattern, and the streams of random numbers that keep it apart from a frame's noise."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import lru_cache
from typing import SupportsIndex

import numpy as np

# Spawn keys that keep the streams of a sensor, of a frame and of its faults apart when their seeds are equal.
SENSOR, FRAME, COSMIC, FAULT = 0, 1, 2, 3
# Kinds of keys from which seeds are derived: a number and a name with the same bytes differ.
_NUMBER, _NAME = 4, 5

# Bits of a derived seed: whole numbers up to 2**53 are exact in JSON as MATLAB and JavaScript read it.
_SEED_BITS = 53


def seed_of(seed: int, key: SupportsIndex | str) -> int:
    """A seed made of another and of what it is for: a frame by its number, a camera by its name.

    Seeds of other keys, and those of neighbouring seeds, have streams of random numbers that are independent.

    Parameters
    ----------
    seed : int, 0..2**64 - 1
    key : int, also NumPy's, >= 0, or str

    Returns
    -------
    int, 0..2**53 - 1

    Source: NumPy, `SeedSequence`, spawn keys.
    """
    spawn_key = (_NAME, *key.encode()) if isinstance(key, str) else (_NUMBER, operator.index(key))
    state = np.random.SeedSequence(seed, spawn_key=spawn_key).generate_state(1, np.uint64)
    return int(state[0]) >> (64 - _SEED_BITS)


def stream(seed: int, *key: int) -> np.random.Generator:
    """Random numbers of one seed and purpose."""
    # SFC64 is the fastest of NumPy's generators here: poisson 40 ms/Mpx against 65 of PCG64DXSM.
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=key)))


@dataclass(frozen=True, kw_only=True)
class PatternStatistics:
    """The fields of a `Detector` that its fixed pattern depends on, by the same names."""

    sensor_seed: int
    photo_response_nonuniformity: float
    dark_current_nonuniformity: float
    dark_signal_nonuniformity_electrons: float
    dead_pixel_fraction: float
    hot_pixel_fraction: float
    hot_pixel_electrons_per_s: float


@dataclass(frozen=True)
class FixedPattern:
    """Maps of a sensor, (H, W) float32, read-only; None where there is no such pattern.

    `response` [1] scales the signal, `dark` [1] the dark current, `offset_electrons` [e-] is added.
    `hot` is a pair: flat indices of the hot pixels, rising, and their extra dark currents [e-/s].
    """

    response: np.ndarray | None
    dark: np.ndarray | None
    offset_electrons: np.ndarray | None
    hot: tuple[np.ndarray, np.ndarray] | None
    width_px: int

    def rows(self, rows: slice) -> FixedPattern:
        """The maps of some rows."""
        maps = (None if m is None else m[rows] for m in (self.response, self.dark, self.offset_electrons))
        return FixedPattern(*maps, rows_of(self.hot, rows, self.width_px), self.width_px)


def rows_of(sparse: tuple[np.ndarray, np.ndarray] | None, rows: slice, width_px: int) -> tuple[np.ndarray, ...] | None:
    """Some rows of a sparse map: rising flat indices, counted from the first row, and values."""
    if sparse is None:
        return None
    part = slice(*np.searchsorted(sparse[0], (rows.start * width_px, rows.stop * width_px)))
    return sparse[0][part] - rows.start * width_px, sparse[1][part]


@lru_cache(maxsize=8)
def fixed_pattern(sensor: PatternStatistics, shape: tuple[int, int]) -> FixedPattern:
    """Maps of a sensor of so many rows and columns; made once for the last few sensors."""
    def pattern(index: int, mean: float, sigma: float, floor: float) -> np.ndarray | None:
        if sigma == 0.0:
            return None
        values = stream(sensor.sensor_seed, SENSOR, index).standard_normal(shape, dtype=np.float32)
        values *= np.float32(sigma)
        values += np.float32(mean)
        np.maximum(values, np.float32(floor), out=values)
        values.setflags(write=False)
        return values

    return FixedPattern(
        response=_with_dead(sensor, shape, pattern(0, 1.0, sensor.photo_response_nonuniformity, 0.0)),
        dark=pattern(1, 1.0, sensor.dark_current_nonuniformity, 0.0),
        offset_electrons=pattern(2, 0.0, sensor.dark_signal_nonuniformity_electrons, -np.inf),
        hot=_hot_pixels(sensor, shape[0] * shape[1]), width_px=shape[1])


def _with_dead(sensor: PatternStatistics, shape: tuple[int, int], response: np.ndarray | None) -> np.ndarray | None:
    n_dead = round(sensor.dead_pixel_fraction * shape[0] * shape[1])
    if n_dead == 0:
        return response
    response = np.ones(shape, np.float32) if response is None else response.copy()
    response.ravel()[stream(sensor.sensor_seed, SENSOR, 4).choice(response.size, n_dead, replace=False)] = 0.0
    response.setflags(write=False)
    return response


def _hot_pixels(sensor: PatternStatistics, n_pixels: int) -> tuple[np.ndarray, np.ndarray] | None:
    n_hot = round(sensor.hot_pixel_fraction * n_pixels)
    if n_hot == 0 or sensor.hot_pixel_electrons_per_s == 0.0:
        return None
    rng = stream(sensor.sensor_seed, SENSOR, 3)
    pixel = np.sort(rng.choice(n_pixels, n_hot, replace=False))
    return pixel, rng.exponential(sensor.hot_pixel_electrons_per_s, n_hot).astype(np.float32)
