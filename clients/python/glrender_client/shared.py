"""Frames read in place, in the shared memory of a server on this machine."""

from __future__ import annotations

import contextlib
import mmap
import os
import re
import weakref
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

_FOLDER = Path("/dev/shm")  # noqa: S108 (POSIX shared memory; only names from the server are opened)
_NAME = "glrender-slot-[0-9a-z-]{1,64}"
_MAX_MAPPED = 16


class NotShared(Exception):
    """The frame is not there any more, or this server's memory cannot be read from here."""


class SharedFrames:
    """Maps the server's memory, read-only. While an array of a frame lives the server leaves that memory alone: a
    shared lock (flock) on it says so, which ends with the array, or with this process.
    """

    def __init__(self):
        self._mapped: OrderedDict[str, mmap.mmap] = OrderedDict()

    def parts(self, place: Mapping[str, Any]) -> list[np.ndarray]:
        """The pixels of a reply, each (n_bytes,) uint8, where its header's `shared` says.

        Raises
        ------
        NotShared
        """
        import fcntl

        name = place["name"]
        if not re.fullmatch(_NAME, name):
            raise NotShared(name)
        try:
            file = _opened(name)
        except OSError as error:
            raise NotShared(str(error)) from None
        with contextlib.ExitStack() as stack:
            stack.callback(os.close, file)
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                raise NotShared(f"{name} is taken") from None
            whole = np.frombuffer(self._mapping(name), np.uint8)
            if any(start + size > whole.size for start, size in zip(place["offsets"], place["sizes"], strict=True)):
                raise NotShared(f"{name} is smaller than its frame")
            if int(whole[:8].view("<u8")[0]) != place["number"]:
                raise NotShared(f"{name} holds another frame")
            weakref.finalize(whole, os.close, file)
            stack.pop_all()
        return [whole[start:start + size] for start, size in zip(place["offsets"], place["sizes"], strict=True)]

    def close(self) -> None:
        """Unmap the server's memory; arrays that live keep theirs."""
        self._mapped.clear()

    def _mapping(self, name: str) -> mmap.mmap:
        if name not in self._mapped:
            while len(self._mapped) >= _MAX_MAPPED:
                self._mapped.popitem(last=False)
            # The lock has a file of its own: a mapping keeps its file open, and so would keep the lock.
            file = _opened(name)
            try:
                self._mapped[name] = mmap.mmap(file, 0, access=mmap.ACCESS_READ)
            except (OSError, ValueError) as error:  # no plain file, or an empty one
                raise NotShared(str(error)) from None
            finally:
                os.close(file)
        self._mapped.move_to_end(name)
        return self._mapped[name]


def _opened(name: str) -> int:
    """A descriptor; whatever a server of another user names, nothing is waited for and no link is followed."""
    return os.open(_FOLDER / name, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW)
