"""Shared memory that workers write frames into and that is sent from without a copy."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Sequence
from multiprocessing.shared_memory import SharedMemory

import numpy as np

_SMALLEST_BYTES = 1 << 16
_MAX_FREE = 8


class SlotStore:
    """Owns the shared memory of all frames; a slot comes back when the last view of it is gone."""

    def __init__(self):
        self._free: list[SharedMemory] = []
        self._all: dict[str, SharedMemory] = {}

    @property
    def n_bytes(self) -> int:
        """All that is allocated."""
        return sum(slot.size for slot in self._all.values())

    def take(self, n_bytes: int) -> SharedMemory:
        """A slot of at least this size that nobody reads."""
        fitting = [slot for slot in self._free if slot.size >= n_bytes]
        if fitting:
            slot = min(fitting, key=lambda s: s.size)
            self._free.remove(slot)
            return slot
        size = _SMALLEST_BYTES
        while size < n_bytes:
            size *= 2
        slot = SharedMemory(create=True, size=size)
        self._all[slot.name] = slot
        return slot

    def give_back(self, slot: SharedMemory) -> None:
        """Nobody reads it any more; may be called from any thread."""
        self._free.append(slot)

    def lend(self, slot: SharedMemory, sizes: Sequence[int]) -> list[memoryview]:
        """Views of what stands in a slot, one behind the other; it comes back when the last is gone."""
        whole = np.frombuffer(slot.buf, np.uint8, sum(sizes))
        weakref.finalize(whole, self.give_back, slot).atexit = False
        ends = np.cumsum(sizes)
        return [whole[end - size:end].data for size, end in zip(sizes, ends, strict=True)]

    def trim(self) -> None:
        """Release free slots beyond a few, the largest first."""
        while len(self._free) > _MAX_FREE:
            slot = max(self._free, key=lambda s: s.size)
            self._free.remove(slot)
            del self._all[slot.name]
            _release(slot)

    def close(self) -> None:
        """Release every slot; what is still being sent stays readable until then."""
        for slot in self._all.values():
            _release(slot)
        self._all.clear()
        self._free.clear()


def _release(slot: SharedMemory) -> None:
    slot.unlink()
    # A view that is still being sent keeps the mapping.
    with contextlib.suppress(BufferError):
        slot.close()
