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
    dark_current_electrons_per_s: float
    dark_current_nonuniformity: float
    dark_signal_nonuniformity_electrons: float
    dead_pixel_fraction: float
    hot_pixel_fraction: float
    hot_pixel_electrons_per_s: float


@dataclass(frozen=True)
class FixedPattern:
    """Maps of a sensor, (H, W) float32, read-only; None where there is no such pattern.

    `response` [1] scales the signal, `dark_electrons_per_s` [e-/s] is the dark current at its reference temperature,
    `offset_electrons` [e-] is added.
    """

    response: np.ndarray | None
    dark_electrons_per_s: np.ndarray | None
    offset_electrons: np.ndarray | None


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
        dark_electrons_per_s=_with_hot(sensor, shape, pattern(1, 1.0, sensor.dark_current_nonuniformity, 0.0)),
        offset_electrons=pattern(2, 0.0, sensor.dark_signal_nonuniformity_electrons, -np.inf))


def _with_dead(sensor: PatternStatistics, shape: tuple[int, int], response: np.ndarray | None) -> np.ndarray | None:
    n_dead = round(sensor.dead_pixel_fraction * shape[0] * shape[1])
    if n_dead == 0:
        return response
    response = np.ones(shape, np.float32) if response is None else response.copy()
    response.ravel()[stream(sensor.sensor_seed, SENSOR, 4).choice(response.size, n_dead, replace=False)] = 0.0
    response.setflags(write=False)
    return response


def _with_hot(sensor: PatternStatistics, shape: tuple[int, int], relative: np.ndarray | None) -> np.ndarray | None:
    n_hot = round(sensor.hot_pixel_fraction * shape[0] * shape[1])
    if relative is None and (n_hot == 0 or sensor.hot_pixel_electrons_per_s == 0.0):
        return None
    relative = np.ones(shape, np.float32) if relative is None else relative
    current = relative * np.float32(sensor.dark_current_electrons_per_s)
    rng = stream(sensor.sensor_seed, SENSOR, 3)
    # In the order of the pixels: a sensor of this seed has had its hot ones so ever since.
    pixel = np.sort(rng.choice(current.size, n_hot, replace=False))
    current.ravel()[pixel] += rng.exponential(sensor.hot_pixel_electrons_per_s, n_hot).astype(np.float32)
    current.setflags(write=False)
    return current
