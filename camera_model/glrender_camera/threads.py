"""Threads that share the work of one image, and those that work in spare time."""

from __future__ import annotations

import math
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from . import forks

N_CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""That this process is allowed."""
N_THREADS = min(4, os.cpu_count() or 1)
"""Of the camera model, at most: more gain nothing on a megapixel."""
# Of all that run at a time; they are made when they are needed.
_MOST_THREADS = 64
# Of threads that work in spare time, and of no others: `is_over`, which tells them to give up.
_here = threading.local()


def run(task: Callable[[int], None], items: Iterable[int], n_threads: int = N_THREADS) -> None:
    """Do a task for each item, on so many threads at most; errors are raised here. Not from inside a task.

    The caller works as well: a thread that only waits has to be woken, and sends another to sleep.
    """
    left, is_over = deque(items), getattr(_here, "is_over", None)

    def work() -> None:
        while True:
            if is_over is not None and is_over.is_set():
                raise _GivenUp
            try:
                item = left.popleft()
            except IndexError:
                return
            task(item)

    helpers = [_pool(is_over is not None).submit(work) for _ in range(min(n_threads, len(left)) - 1)]
    try:
        work()
    finally:
        # All of them, also if one fails: what they work on may be released then. For none, waiting takes longer than
        # the work of few items.
        if helpers:
            wait(helpers)
    for helper in helpers:
        helper.result()


def run_in_parts(task: Callable[[slice], Any], n_items: int, at_once: int) -> list[Any]:
    """Do a task for each part of some items, on all cores; parts depend on the items' number alone.

    So many items at once are one part, more are an even number of parts. Returns what the tasks do, in order of parts.
    """
    n_parts = 1 if n_items <= at_once else 2 * math.ceil(n_items / (2 * at_once))
    done = [None] * n_parts

    def work(k: int) -> None:
        done[k] = task(slice(n_items * k // n_parts, n_items * (k + 1) // n_parts))

    run(work, range(n_parts), N_CORES)
    return done


@cache
def _pool(is_spare: bool) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_MOST_THREADS, "glrender", initializer=_step_back if is_spare else None)


# It has none of its parent's threads, and makes pools of its own.
forks.in_child(_pool.cache_clear)


def _step_back() -> None:
    """Give this thread the least priority; only on Linux threads have their own."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)


class SpareTime:
    """Does the last task that it was given, when nothing else came for a while, with what others leave of the cores.

    Parameters
    ----------
    pause_s : float [s]
        After which nothing else is expected to come soon.
    """

    def __init__(self, pause_s: float):
        self._pause_s, self._number, self._is_closed = pause_s, 0, threading.Event()
        self._lock = threading.Lock()
        # Of the task that is being done.
        self._is_over = threading.Event()
        self._thread = ThreadPoolExecutor(1, "glrender-spare", initializer=_step_back)

    def give(self, task: Callable[[], None]) -> None:
        """Instead of what waits; what is being done goes on. Its errors are nobody's."""
        with self._lock:
            if not self._is_closed.is_set():
                self._number += 1
                self._thread.submit(self._work, task, self._number)

    def stop(self) -> None:
        """Give up what waits, and what is being done: it ends between two items of `run`."""
        with self._lock:
            self._number += 1
            self._is_over.set()

    def close(self) -> None:
        """Stop, and wait for its end."""
        with self._lock:
            self._is_closed.set()
        self.stop()
        self._thread.shutdown()

    def _work(self, task: Callable[[], None], number: int) -> None:
        if number != self._number or self._is_closed.wait(self._pause_s):
            return
        self._is_over = _here.is_over = threading.Event()
        # It may have been stopped until here.
        if number == self._number:
            with suppress(_GivenUp):
                task()


class _GivenUp(Exception):
    """A task in spare time was told to end."""


class Scratch(threading.local):
    """Arrays that each thread keeps between calls: fresh memory costs as much as a pass over it."""

    def __init__(self):
        self._arrays: dict[tuple[str, object], np.ndarray] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: object = np.float32) -> np.ndarray:
        """An array that is not initialised; the next call by the same name may return the same memory."""
        size = int(np.prod(shape))
        found = self._arrays.get((name, dtype))
        if found is None or found.size < size:
            found = self._arrays[name, dtype] = np.empty(size, dtype)
        return found[:size].reshape(shape)
