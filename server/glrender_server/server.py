"""The server's loop: fronts take requests in, a fair bounded queue, one dispatcher answers."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Sequence

import zmq

from .dispatcher import Dispatcher
from .front import FairQueue, Front

log = logging.getLogger(__name__)

QUEUE_LENGTH = 32
"""Requests that may wait; the next is answered `busy`."""
_POLL_MS, _RETRY_MS = 100, 10
_DRAIN_S = 3.0


class Server:
    """Serves until told to stop, and answers what is waiting then.

    Parameters
    ----------
    dispatcher : Dispatcher
    fronts : sequence of Front
        Both are the caller's to close.
    """

    def __init__(self, dispatcher: Dispatcher, fronts: Sequence[Front]):
        self._dispatcher, self._fronts = dispatcher, list(fronts)
        self._queue = FairQueue(QUEUE_LENGTH)
        self._poller = zmq.Poller()
        self._stopping = False

    def stop(self, *_) -> None:
        """Ask the loop to end; may be called from a signal handler."""
        self._stopping = True

    def serve(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Answer requests until `stop`, SIGTERM or SIGINT."""
        before = {number: signal.signal(number, self.stop) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            for front in self._fronts:
                front.start(self._poller)
            on_ready()
            while not self._stopping:
                is_idle = all(front.is_idle for front in self._fronts)
                self._take_in(0 if self._queue else _POLL_MS if is_idle else _RETRY_MS)
                self._answer_next()
            self._take_in(0)
            while self._queue:
                self._answer_next()
            deadline = time.monotonic() + _DRAIN_S
            while self._take_in(10, is_closing=True) or not all(front.is_idle for front in self._fronts):
                if time.monotonic() > deadline:
                    log.warning("replies were left that clients did not take within %g s", _DRAIN_S)
                    break
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _take_in(self, timeout_ms: int, is_closing: bool = False) -> int:
        """Queue what has come, or answer it at once; how much has come."""
        ready = dict(self._poller.poll(timeout_ms))
        requests = [request for front in self._fronts for request in front.take_in(ready)]
        for request in requests:
            if is_closing:
                request.answer(self._dispatcher.closing(request.parts))
            elif not self._queue.put(request):
                request.answer(self._dispatcher.busy(request.parts, len(self._queue)))
        return len(requests)

    def _answer_next(self) -> None:
        if self._queue:
            request = self._queue.get()
            request.answer(self._dispatcher.handle(request.parts))
