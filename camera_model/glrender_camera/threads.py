"""The camera model's threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

N_THREADS = min(4, os.cpu_count() or 1)
"""At most: more gain nothing on a megapixel."""


def run(task: Callable[[int], None], items: Iterable[int]) -> None:
    """Do a task for each item, beside each other; errors are raised here. Not from inside a task."""
    items = list(items)
    if len(items) == 1:
        task(items[0])
    else:
        list(_pool().map(task, items))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(N_THREADS, thread_name_prefix="glrender-camera")


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
