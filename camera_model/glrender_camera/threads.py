"""The camera model's threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

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
