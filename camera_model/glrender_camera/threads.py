"""Threads that share the work of one image."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import Any

from . import forks

N_CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""Number of cores that this process may use."""
N_THREADS = min(4, os.cpu_count() or 1)
"""Most threads of the camera model: more gain nothing on a megapixel."""
# Most threads that run at a time; they are made when they are needed.
_MOST_THREADS = 64


def run(task: Callable[[int], None], items: Iterable[int], n_threads: int = N_THREADS) -> None:
    """Do a task for each item, on a limited number of threads; errors are raised here. Not from inside a task.

    The caller works as well: a thread that only waits has to be woken, and sends another to sleep.
    """
    left = deque(items)

    def work() -> None:
        while True:
            try:
                item = left.popleft()
            except IndexError:
                return
            task(item)

    helpers = [_pool().submit(work) for _ in range(min(n_threads, len(left)) - 1)]
    try:
        work()
    finally:
        # Wait for all, also if one fails: their memory may be released then. Without helpers, waiting takes longer than
        # the work of few items.
        if helpers:
            wait(helpers)
    for helper in helpers:
        helper.result()


def run_in_parts(task: Callable[[slice], Any], n_items: int, at_once: int) -> list[Any]:
    """Do a task for each part of some items, on all cores; parts depend on the items' number alone.

    Up to this number of items is one part, more are an even number of parts. Returns the tasks' values, in order.
    """
    n_parts = 1 if n_items <= at_once else 2 * math.ceil(n_items / (2 * at_once))
    done = [None] * n_parts

    def work(k: int) -> None:
        done[k] = task(slice(n_items * k // n_parts, n_items * (k + 1) // n_parts))

    run(work, range(n_parts), N_CORES)
    return done


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_MOST_THREADS, "glrender")


# It has none of its parent's threads, and makes pools of its own.
forks.in_child(_pool.cache_clear)
