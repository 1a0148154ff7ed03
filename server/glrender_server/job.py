"""Jobs between the dispatcher and an engine, and the engine that renders in the loop's own thread."""

from __future__ import annotations

import logging
from collections.abc import Callable, Hashable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import zmq
from glrender.base.plausible import Advice

from .slots import SlotStore, offsets, room

if TYPE_CHECKING:
    from .operations import Operations

log = logging.getLogger(__name__)

DRAWN = ("render", "range", "load_scene")
"""Operations that need a renderer; the dispatcher answers the others."""
QUICK_S = 0.5
"""A request that keeps a renderer for less [s] keeps nobody waiting."""


class Done(NamedTuple):
    """A finished job: reply parts, error code (empty if it went well), where the time went, where a client on
    this machine finds the parts behind the first (`SlotStore.lend`), and what its cameras' frames warn of."""

    reply: list[Any]
    code: str
    timings_ms: dict[str, float]
    place: dict[str, Any] | None = None
    warnings: Sequence[tuple[str, Sequence[Advice]]] = ()


class Job(NamedTuple):
    """A request that needs a renderer; its bytes wait, which are decoded where it is drawn."""

    header: dict[str, Any]
    """The envelope, `is_slow` and `shared`: two bytes of an empty map are 64 of an object."""
    message: bytes
    done: Callable[[Done], None]
    """Called once, with the reply."""
    sender: Hashable
    """Who takes turns, and waits for its own `load_scene`: the `Request`'s."""
    account: Hashable
    """All connections of one process or machine, where these are known; else the sender."""
    is_quick: bool
    """Whether the account's requests take less than `QUICK_S`: such an account may take every worker."""

    @property
    def is_load(self) -> bool:
        """Whether it replaces the scene."""
        return self.header["op"] == "load_scene"

    @property
    def is_slow(self) -> bool:
        """Whether it may take minutes."""
        return self.is_load or self.header["is_slow"]


class LocalEngine:
    """Renders in the thread that made it; a job is done when `start` returns.

    Parameters
    ----------
    operations : Operations
        Owned.
    """

    is_idle, is_full, draws_here, outage = True, False, True, ""

    def __init__(self, operations: Operations):
        self._operations, self._slots, self.generation = operations, SlotStore(), 0
        # A frame without shared memory goes over the socket: nothing is let go for it.
        self.make_room: Callable[[], bool] = lambda: False
        self.described = operations.described

    def has_room(self, job: Job) -> bool:
        """Always: a job is done when it is begun."""
        return True

    def start(self, job: Job) -> None:
        """Render, and answer."""
        slot, place = None, None

        def memory(sizes: list[int]) -> list[memoryview]:
            nonlocal slot
            try:
                slot = self._slots.take(offsets(sizes)[-1])
            except OSError as error:
                log.warning("a frame goes over the socket, there is no shared memory: %s", error)
                return [memoryview(bytearray(size)) for size in sizes]
            return room(slot, sizes)

        reply, code, timings_ms, warnings = self._operations.answer_message(
            job.message, memory if job.header["shared"] else None)
        if job.is_load and not code:
            self.generation += 1
            self.described = self._operations.described
        if slot is not None and code:
            self._slots.give_back(slot)
        elif slot is not None:
            reply[1:], place = self._slots.lend(slot, [len(part) for part in reply[1:]])
        job.done(Done(reply, code, timings_ms, place, warnings))

    def watch(self, poller: zmq.Poller) -> None:
        """Nothing here wakes the loop."""

    def turn(self, ready: dict[Any, int]) -> None:
        self._slots.trim()

    def close(self) -> None:
        """Release the renderer and the shared memory."""
        self._operations.close()
        self._slots.close()
