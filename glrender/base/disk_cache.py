"""Arrays that take long to make, kept on disk from run to run."""

from __future__ import annotations

import fcntl
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

_log = logging.getLogger(__name__)

MAX_CACHE_BYTES = 2 * 1024**3
"""Largest size of the cache [bytes]; the longest unused files go first. A shape of 327,000 facets has some 20 MB."""


def cache_folder() -> Path:
    """$GLRENDER_CACHE, or `glrender` in the user's cache folder; an empty variable counts as not set."""
    if os.environ.get("GLRENDER_CACHE"):
        return Path(os.environ["GLRENDER_CACHE"])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "glrender"


def cached_arrays(name: str, keys: list[str], make: Callable[[], dict[str, np.ndarray]], cache: Path | None = None,
                  is_right: Callable[[dict[str, np.ndarray]], bool] = lambda _: True) -> dict[str, np.ndarray]:
    """Arrays from the cache's file `name`, made and kept there when it lacks them or is spoilt.

    By one process at a time: others wait for it.
    """
    folder = cache_folder() if cache is None else cache
    file = folder / f"{name}.npz"
    kept = _kept(file, keys, is_right)
    if kept is not None:
        return kept
    with _alone(folder / f"{name}.lock"):
        kept = _kept(file, keys, is_right)
        return _made_and_kept(file, make) if kept is None else kept


def cached_bytes(name: str, size: tuple[int, ...], make: Callable[[], np.ndarray]) -> np.ndarray:
    """A table of uint8 of a size, kept as `cached_arrays` are: for loops that look at no bounds."""
    return cached_arrays(name, ["table"], lambda: {"table": make()}, is_right=lambda kept: (
        kept["table"].shape == size and kept["table"].dtype == np.uint8))["table"]


def _kept(file: Path, keys: list[str], is_right: Callable[[dict[str, np.ndarray]], bool]
          ) -> dict[str, np.ndarray] | None:
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in keys}
    except Exception:
        # A damaged file may raise anything.
        return None
    with suppress(OSError):
        os.utime(file)
    return arrays if is_right(arrays) else None


@contextmanager
def _alone(file: Path) -> Iterator[None]:
    """Keep other processes out for a while; not where nothing can be written, nor beyond the life of this one."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        lock = file.open("a")
    except OSError:
        yield
        return
    with lock:
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield
            # Who waits for it holds it open, and finds what was made.
            file.unlink(missing_ok=True)
        finally:
            # A child that was forked meanwhile has it open too, and would keep the lock.
            with suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_UN)


def _made_and_kept(file: Path, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    # Who reads it sees all of it or none; what a process left that was killed is written over.
    arrays, apart = make(), file.with_suffix(".part.npz")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(apart, **arrays)
        os.replace(apart, file)
        _trim(file.parent)
    except OSError as error:
        _log.warning("%s is not kept in %s: %s", file.stem, file.parent, error)
        with suppress(OSError):
            apart.unlink()
    return arrays


def _trim(folder: Path) -> None:
    """Remove the files unused for longest, beyond `MAX_CACHE_BYTES`."""
    kept = sorted(((file.stat(), file) for file in folder.glob("*.npz")), key=lambda entry: entry[0].st_mtime)
    surplus = sum(status.st_size for status, _ in kept) - MAX_CACHE_BYTES
    for status, file in kept[:-1]:
        if surplus <= 0:
            return
        file.unlink(missing_ok=True)
        surplus -= status.st_size
