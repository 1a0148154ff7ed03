"""A fork, as multiprocessing and PyTorch's DataLoader make on Linux: nothing that another thread held waits for ever.

A forked child has the one thread that forked. What any other thread of its parent held is held for good in the child:
the lock of a module that was being imported, and up to Python 3.11 that of a `functools.cached_property`.
"""

from __future__ import annotations

import functools
import importlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import ModuleType


def in_child(renew: Callable[[], object]) -> None:
    """Call this in every forked child, before anything else in the child."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=renew)


def _ours() -> Iterator[tuple[str, ModuleType]]:
    return ((name, module) for name, module in list(sys.modules.items()) if name.startswith("glrender"))


def _wait_for_imports() -> None:
    """Let other threads end the imports of our modules: loops are compiled in them."""
    for name, _ in _ours():
        # A module that fails reports that to its importer.
        with suppress(Exception):
            importlib.import_module(name)


def _renew_locks() -> None:
    for _, module in _ours():
        for kind in [value for value in vars(module).values() if isinstance(value, type)]:
            for member in vars(kind).values():
                if isinstance(member, functools.cached_property):
                    member.lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_wait_for_imports)
if sys.version_info < (3, 12):
    in_child(_renew_locks)
