"""Shared memory that frames are written into, sent from without a copy, and read in by clients on this machine."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import secrets
import stat
import struct
import weakref
from collections.abc import Iterable, Sequence
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import numpy as np

MAX_SHARED_BYTES = 1 << 30
"""While as much is allocated, no further frame is left for a client to read in place."""
MAX_SHARED_SLOTS = 128
"""Likewise, while there are more slots: each takes three file descriptors."""
MIN_SHARED_BYTES = 1 << 16
"""Frames that are smaller come sooner over the socket."""
_STEP_BYTES = 1 << 16
_MAX_FREE, _MAX_FREE_WHEN_FULL = 8, 2
# Parts of a slot begin at multiples of so many bytes, as any pixel needs. The first holds the slot's number, and behind
# it whether a worker has begun with it.
_ALIGNMENT, _BEGUN = 64, 8
_FOLDER = Path("/dev/shm")
_CAN_LOCK = _FOLDER.is_dir()
_PREFIX = "glrender-slot-"


def offsets(sizes: Iterable[int]) -> list[int]:
    """Offsets [bytes] of parts of these sizes in a slot; the last is that of a part after them."""
    found = [_ALIGNMENT]
    for size in sizes:
        found.append(found[-1] + -(-size // _ALIGNMENT) * _ALIGNMENT)
    return found


def mark_begun(slot: SharedMemory, is_it: bool = True) -> None:
    """Write down that a worker has begun with the request which the slot came with, or that none has yet."""
    slot.buf[_BEGUN] = is_it


def has_begun(slot: SharedMemory) -> bool:
    """Whether it has: a message would wake the server for each frame once more."""
    return bool(slot.buf[_BEGUN])


def room(slot: SharedMemory, sizes: Sequence[int]) -> list[memoryview]:
    """Views of a slot for parts of these sizes [bytes]; release the views before the slot is closed."""
    return [slot.buf[start:start + size] for start, size in zip(offsets(sizes), sizes, strict=False)]


class SlotStore:
    """Owns the shared memory of all frames; a slot is free when its last view here is gone and no client reads it.

    A client that reads a slot holds a shared lock (flock) on its file, which the system takes away when the client
    dies. Each time that a slot is taken its number goes up, under the exclusive lock: a client that comes too late
    sees that, with its own lock in hand. A lock on a file of the store's own shows that it lives; slots of stores
    that were killed are removed by the next.
    """

    def __init__(self):
        self._free: list[SharedMemory] = []
        self._all: dict[str, SharedMemory] = {}
        self._locks: dict[str, int] = {}
        self.n_bytes = 0
        """All that is allocated."""
        self._name = _PREFIX + secrets.token_hex(6)
        self._owner, self._room_bytes = -1, MAX_SHARED_BYTES
        if _CAN_LOCK:
            _remove_what_the_dead_left()
            self._owner = os.open(_FOLDER / self._name, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._owner, fcntl.LOCK_EX | fcntl.LOCK_NB)
            system = os.statvfs(_FOLDER)
            # The other half is for frames on their way: a container may have no more than 64 MiB.
            self._room_bytes = system.f_frsize * system.f_blocks // 2

    @property
    def _is_full(self) -> bool:
        return self.n_bytes > min(MAX_SHARED_BYTES, self._room_bytes) or len(self._all) > MAX_SHARED_SLOTS

    def take(self, n_bytes: int) -> SharedMemory:
        """A slot with room for this much that nobody reads.

        Raises
        ------
        OSError
            The system has no memory or no file descriptor for one.
        """
        for slot in sorted(self._free, key=lambda free: free.size):
            if slot.size >= n_bytes and self._claim(slot):
                self._free.remove(slot)
                if self.is_there(slot):
                    return slot
                self._remove(slot)
        slot = SharedMemory(f"{self._name}-{secrets.token_hex(4)}", create=True,
                            size=max(1, -(-n_bytes // _STEP_BYTES)) * _STEP_BYTES)
        try:
            if _CAN_LOCK:
                self._locks[slot.name] = lock = os.open(_FOLDER / slot.name, os.O_RDWR | os.O_CLOEXEC)
                # Allocated now, lack of memory is an error; later it would kill (SIGBUS) the process that writes.
                os.posix_fallocate(lock, 0, slot.size)
        except OSError:
            self._release(slot)
            raise
        self._all[slot.name] = slot
        self.n_bytes += slot.size
        self._claim(slot)
        return slot

    def give_back(self, slot: SharedMemory) -> None:
        """Nobody here reads it any more; may be called from any thread."""
        self._free.append(slot)

    def lend(self, slot: SharedMemory, sizes: Sequence[int]) -> tuple[list[memoryview], dict[str, Any] | None]:
        """Views of the parts in a slot, which comes back when the last is gone; and where a client finds them.

        The place is {name, number, offsets, sizes}; None where nothing locks, while `MAX_SHARED_BYTES`, half of what
        the system has for this, or `MAX_SHARED_SLOTS` are in use, and for parts below `MIN_SHARED_BYTES`.
        """
        starts = offsets(sizes)
        whole = np.frombuffer(slot.buf, np.uint8, starts[-1] if sizes else 0)
        weakref.finalize(whole, self.give_back, slot).atexit = False
        views = [whole[start:start + size].data for start, size in zip(starts, sizes, strict=False)]
        if not _CAN_LOCK or self._is_full or sum(sizes) < MIN_SHARED_BYTES:
            return views, None
        return views, {"name": slot.name, "number": _number(slot), "offsets": starts[:-1], "sizes": list(sizes)}

    def trim(self, n_kept: int | None = None) -> None:
        """Release free slots beyond a few, or beyond so many, the largest first."""
        if n_kept is None:
            n_kept = _MAX_FREE_WHEN_FULL if self._is_full else _MAX_FREE
        for slot in sorted(self._free, key=lambda free: -free.size)[:max(0, len(self._free) - n_kept)]:
            if self._claim(slot):
                self._free.remove(slot)
                self._remove(slot)

    def close(self) -> None:
        """Release every slot; views that are being sent or read stay valid until they end."""
        for slot in self._all.values():
            self._release(slot)
        self._all.clear()
        self.n_bytes = 0
        self._free.clear()
        if self._owner >= 0:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(_FOLDER / self._name)
            os.close(self._owner)
            self._owner = -1

    def _claim(self, slot: SharedMemory) -> bool:
        """Whether no client reads a slot; then it has a new number."""
        if slot.name in self._locks:
            lock = self._locks[slot.name]
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
            struct.pack_into("<Q", slot.buf, 0, _number(slot) + 1)
            fcntl.flock(lock, fcntl.LOCK_UN)
        return True

    def is_there(self, slot: SharedMemory) -> bool:
        """Whether its file has still its name, by which a worker opens it: somebody may have tidied /dev/shm."""
        return slot.name not in self._locks or os.fstat(self._locks[slot.name]).st_nlink > 0

    def _remove(self, slot: SharedMemory) -> None:
        del self._all[slot.name]
        self.n_bytes -= slot.size
        self._release(slot)

    def _release(self, slot: SharedMemory) -> None:
        if slot.name in self._locks:
            os.close(self._locks.pop(slot.name))
        with contextlib.suppress(FileNotFoundError):
            slot.unlink()
        # A view that is still being sent keeps the mapping.
        with contextlib.suppress(BufferError):
            slot.close()


def _remove_what_the_dead_left() -> None:
    """Slots whose store's own file nobody locks: the server was killed, with all that would have tidied up.

    Every user of the machine may put files there, under any name: only our own regular files are opened.
    """
    for name in os.listdir(_FOLDER):
        if re.fullmatch(_PREFIX + "[0-9a-f]{12}", name) and _is_ownerless(_FOLDER / name):
            for other in os.listdir(_FOLDER):
                if other == name or re.fullmatch(name + "-[0-9a-f]{8}", other):
                    with contextlib.suppress(OSError):  # just gone, or another user's
                        os.unlink(_FOLDER / other)


def _is_ownerless(path: Path) -> bool:
    """Whether no living server locks a store's file; another user's, or no plain file, has an owner."""
    try:
        # A FIFO would be waited for, a link lead elsewhere.
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        status = os.fstat(file)
        if not stat.S_ISREG(status.st_mode) or status.st_uid != os.getuid():
            return False
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except OSError:
        return False
    finally:
        os.close(file)


def _number(slot: SharedMemory) -> int:
    return struct.unpack_from("<Q", slot.buf)[0]
