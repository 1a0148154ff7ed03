"""What the dispatcher and an engine hand each other, and the engine that renders in the loop's own thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import zmq

from .operations import Operations


class Done(NamedTuple):
    """A finished job: reply parts, error code (empty if it went well), and where the time went."""

    reply: list[Any]
    code: str
    timings_ms: dict[str, float]


class Job(NamedTuple):
    """A request that needs a renderer: its header, its bytes, and what to call with the reply."""

    header: dict[str, Any]
    message: bytes
    done: Callable[[Done], None]


class LocalEngine:
    """Renders in the thread that made it; a job is done when `start` returns.

    Parameters
    ----------
    operations : Operations
        Owned.
    """

    has_room, is_idle, outage = True, True, ""

    def __init__(self, operations: Operations):
        self._operations = operations
        self.described = operations.described

    def start(self, job: Job) -> None:
        """Render, and answer."""
        reply, code = self._operations.answer(job.header)
        if job.header["op"] == "load_scene" and not code:
            self.described = self._operations.described
        job.done(Done(reply, code, {} if code else self._operations.last_timings_ms))

    def watch(self, poller: zmq.Poller) -> None:
        """Nothing here wakes the loop."""

    def turn(self, ready: dict[Any, int]) -> None:
        """Nothing here is left to do."""

    def close(self) -> None:
        """Release the renderer."""
        self._operations.close()
