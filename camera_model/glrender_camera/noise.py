"""Noise of the detector: tables and keys of the compiled loops, and Poisson numbers for faults.

Random numbers are a hash of a key and of the pixel's place (`noise_loops`), so that threads share a frame as they like.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType

import numpy as np
from scipy.special import ndtri, pdtr

from .threads import run

# Pixels of a block: one thread's work at a time.
_BLOCK_PX = 2**16
# Share of each tail of the normal law that no cell holds, as `noise_loops.OUTER_DEVIATE` has it.
_TAIL = 2**-10


@cache
def loops() -> ModuleType:
    """The compiled loops: the first frame that is read imports Numba."""
    return import_module(".noise_loops", __package__)


def key_of(seed: int, *purpose: int) -> np.ndarray:
    """Key (2,) uint64 of the random numbers of a seed and purpose."""
    return np.random.SeedSequence(seed, spawn_key=purpose).generate_state(2, np.uint64)


def read_out(signal_electrons: np.ndarray, key: np.ndarray, *, dark_scale: float, most: float, well: float = np.inf,
             response: np.ndarray | None = None, dark: np.ndarray | None = None, extra: np.ndarray | None = None,
             offset: np.ndarray | None = None, read_noise: float = 0.0, gain: float = 0.0, offset_DN: float = 0.0,
             largest: int = 1, nonlinearity: np.ndarray | None = None
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Charge, drawn after Poisson's law, and what is read of it; shared by threads.

    Parameters
    ----------
    signal_electrons : (H, W) float32 [e-], >= 0
        Mean photo-electrons; no NaN.
    key : (2,) uint64
    dark_scale : float
        Factor of `dark`; without one, the mean dark charge of every pixel [e-].
    most : float [e-]
        The largest mean.
    well : float [e-]
    response, dark : (H, W) float32, optional
        Factor on the light [1], and the dark current.
    extra, offset : (H, W) float32 [e-], optional
        Charge that is added before and after the full well.
    read_noise : float [e-]
    gain, offset_DN : float [DN/e-], [DN]
    largest : int [DN], up to 65535
    nonlinearity : (N, 2) float64 [DN], optional

    Returns
    -------
    electrons : (H, W) float32 [e-]
    dn : (H, W) uint16 [DN]
    saturated : (H, W) bool
    """
    shape = signal_electrons.shape
    electrons, dn, saturated = np.empty(shape, np.float32), np.empty(shape, np.uint16), np.empty(shape, bool)
    none = np.empty(0, np.float32)
    images = [none if image is None else np.ascontiguousarray(image, np.float32).reshape(-1)
              for image in (signal_electrons, response, dark, extra, offset)]
    pairs = np.empty((0, 2)) if nonlinearity is None else nonlinearity
    outputs = [out.reshape(-1) for out in (electrons, dn, saturated)]
    read, known = loops().read_out, tables()

    def read_block(index: int) -> None:
        part = slice(index * _BLOCK_PX, (index + 1) * _BLOCK_PX)
        read(*(image[part] for image in images), dark_scale, most, well, read_noise, gain, offset_DN, largest, pairs,
             key, part.start, *known, *(out[part] for out in outputs))

    run(read_block, range(-(-signal_electrons.size // _BLOCK_PX)))
    return electrons, dn, saturated


def poisson(mean: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Poisson numbers (H, W) float32 [1] of means (H, W), one for each place and key; above 2**24 they are rounded."""
    return read_out(mean, key, dark_scale=0.0, most=np.inf)[0]


@cache
def tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The loops' tables, which the first frame would wait for.

    Of Poisson's law: the count of each cell of [0, 1) for each tabulated mean, one after the other, uint8, undecided
    where a step of the distribution cuts the cell; and cumulative probabilities (levels, counts). Of the normal law:
    four coefficients of each cell's cubic, one cell after the other, float32; NaN in the tails.
    """
    set_up = loops()
    means = np.arange(set_up.SMALL * set_up.LEVELS_PER_ELECTRON) / set_up.LEVELS_PER_ELECTRON
    cumulative = pdtr(np.arange(set_up.N_COUNTS), means[:, None])
    edges = np.arange(2**set_up.CELL_BITS + 1) / 2**set_up.CELL_BITS
    least = np.array([np.searchsorted(row, edges[:-1], side="right") for row in cumulative])
    most = np.array([np.searchsorted(row, edges[1:], side="left") for row in cumulative])
    counts = np.where(least == most, least, set_up.UNDECIDED).astype(np.uint8)
    n_cells = 2**set_up.DEVIATE_BITS
    nodes = np.cos(np.pi * (np.arange(4) + 0.5) / 4.0)
    values = ndtri((np.arange(n_cells)[:, None] + 0.5 + 0.5 * nodes) / n_cells)
    cubics = values @ np.linalg.inv(np.vander(nodes, increasing=True)).T
    n_tail = round(n_cells * _TAIL)
    cubics[:n_tail] = cubics[-n_tail:] = np.nan
    return counts.reshape(-1), cumulative, cubics.astype(np.float32).reshape(-1)
