"""Numba compiles loops when their file is imported, and keeps the code next to it or in the user's cache folder.

Numba decides by a file's text alone whether the code that it kept is old, so a loop calls no loop of another file.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import wraps
from typing import Any

from numba import njit, types
from numba.types import UniTuple, float64, intp

_log = logging.getLogger(__name__)

N_LOOPS = 32
"""Loops that are compiled at the start, of all files: for who waits for the first time."""
# Seconds between two words about it.
_PAUSE_S = 5.0

inlined = njit(inline="always", error_model="numpy")
"""Decorator: of what becomes a part of the loops that call it, and is compiled with them."""
called = njit(nogil=True, error_model="numpy")
"""Decorator: of what loops of its file call, and is compiled with the first."""


def compiled(signature: Any) -> Callable[[Callable], Callable]:
    """Decorator: a first frame does not wait for a compiler, and other threads run meanwhile.

    Where machine code cannot be kept, or what was kept cannot be read, every start costs the time to make it again.
    """
    def decorate(function: Callable) -> Callable:
        made = {"nogil": True, "error_model": "numpy"}
        begin = time.monotonic()
        try:
            loop = njit(signature, cache=True, **made)(function)
            if loop.stats.cache_misses:
                _first_time.tell(time.monotonic() - begin)
            return loop
        # No folder, a full disk, half a file, in which a pickle fails in any way: of what the loop is to blame for,
        # the second time tells.
        except Exception as error:
            _log.warning("machine code of %s is not kept: %s: %s", function.__name__, type(error).__name__, error)
            return njit(signature, **made)(function)

    return decorate


def compiled_when_called(signature: Any) -> Callable[[Callable], Callable]:
    """Decorator: for loops that few frames need, and no other loop calls; others start without them."""
    def decorate(function: Callable) -> Callable:
        loop, lock = None, threading.Lock()

        @wraps(function)
        def call(*arguments: Any) -> Any:
            nonlocal loop
            if loop is None:
                with lock:
                    loop = loop or compiled(signature)(function)
            return loop(*arguments)

        return call

    return decorate


class _FirstTime:
    """Logs how long loops that were never compiled here take, for those who wait."""

    def __init__(self):
        self._n_made, self._spent_s, self._told_s = 0, 0.0, -_PAUSE_S

    def tell(self, seconds: float) -> None:
        """A loop took some seconds to compile."""
        self._n_made += 1
        self._spent_s += seconds
        if time.monotonic() - self._told_s > _PAUSE_S and self._n_made < N_LOOPS:
            self._told_s = time.monotonic()
            left_s = (N_LOOPS - self._n_made) * self._spent_s / self._n_made
            _log.warning("compiling %d loops by Numba, once on a machine: %d done, some %.0f s left", N_LOOPS,
                         self._n_made, left_s)


_first_time = _FirstTime()


def read(dtype: types.Type, n_dimensions: int, layout: str = "C") -> types.Array:
    """An array that is only read, of a layout: `C`, or `A` for any."""
    return types.Array(dtype, n_dimensions, layout, readonly=True)


def write(dtype: types.Type, n_dimensions: int, layout: str = "C") -> types.Array:
    """An array that is written or returned."""
    return types.Array(dtype, n_dimensions, layout)


# Types that several files of loops take: vectors, points in columns, tables, lists and tables of numbers, a place or a
# direction.
VECTOR, POINTS = read(float64, 1, "A"), read(float64, 2, "A")
TABLE, NUMBERS, INDICES = read(float64, 2), read(intp, 1), read(intp, 2)
PLACE = UniTuple(float64, 3)
