"""Tables that take seconds to make are kept on disk from run to run."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

_log = logging.getLogger(__name__)

MAX_CACHE_BYTES = 2 * 1024**3
"""Largest size of the cache [bytes]; the longest unused files go first. A shape of 150,000 facets has 2.4 MB."""


def cache_folder() -> Path:
    """$GLRENDER_CACHE, or `glrender` in the user's cache folder; an empty variable counts as not set."""
    if os.environ.get("GLRENDER_CACHE"):
        return Path(os.environ["GLRENDER_CACHE"])
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "glrender"


def cached_bytes(name: str, size: tuple[int, ...], make: Callable[[], np.ndarray]) -> np.ndarray:
    """A table of uint8 of a size, made and kept in the cache's file `name` when it lacks it or is spoilt.

    Loops take it that look at no bounds. Where nothing can be kept it is made each time.
    """
    file = cache_folder() / f"{name}.npy"
    # A damaged file may raise anything.
    with suppress(Exception):
        kept = np.load(file, allow_pickle=False)
        if kept.shape == size and kept.dtype == np.uint8:
            os.utime(file)
            return kept
    # A reader sees the whole file or none; each process writes its own.
    made, apart = make(), file.with_suffix(f".{os.getpid()}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with apart.open("wb") as stream:
            np.save(stream, made)
        os.replace(apart, file)
        _trim(file.parent)
    except OSError as error:
        _log.warning("%s is not kept in %s: %s", file.stem, file.parent, error)
        with suppress(OSError):
            apart.unlink()
    return made


def _trim(folder: Path) -> None:
    """Remove the files unused for longest, beyond `MAX_CACHE_BYTES`; also what killed processes left."""
    kept = sorted(((file.stat(), file) for file in folder.glob("*.np[yz]")), key=lambda entry: entry[0].st_mtime)
    kept = [*((file.stat(), file) for file in folder.glob("*.part")), *kept]
    surplus = sum(status.st_size for status, _ in kept) - MAX_CACHE_BYTES
    for status, file in kept[:-1]:
        if surplus <= 0:
            return
        file.unlink(missing_ok=True)
        surplus -= status.st_size
