"""The server's loop: fronts take requests in, one dispatcher answers them, an engine renders."""

from __future__ import annotations

import contextlib
import logging
import signal
import time
from collections.abc import Callable, Iterator, Sequence

import zmq

from .dispatcher import Dispatcher, Engine
from .front import Front
from .systemd import Systemd

log = logging.getLogger(__name__)

_POLL_MS, _RETRY_MS = 100, 10
# For what waits and is under way when the end is asked for, and then for clients to take it.
_FINISH_S, _DRAIN_S, _LEAST_LINGER_S = 40.0, 3.0, 0.2
# Failed turns in a row from which the server ends, so that a service manager starts it anew.
_MAX_FAILED_TURNS = 100


class Server:
    """Serves until it is stopped, and then answers the requests that wait.

    Parameters
    ----------
    dispatcher : Dispatcher
    engine : Engine
        The dispatcher's.
    fronts : sequence of Front
        Closed when all is answered; engine and dispatcher are the caller's to close.
    on_reload : callable
        Called in the loop after SIGHUP.
    """

    def __init__(self, dispatcher: Dispatcher, engine: Engine, fronts: Sequence[Front],
                 on_reload: Callable[[], None] = lambda: None):
        self._dispatcher, self._engine, self._fronts = dispatcher, engine, list(fronts)
        self._poller = zmq.Poller()
        self._systemd = Systemd()
        self._stopping, self._reloading, self._on_reload = False, False, on_reload
        self._has_failed, self._n_failed_turns = False, 0

    def stop(self, *_) -> None:
        """Ask the loop to end; may be called from a signal handler."""
        self._stopping = self._dispatcher.is_ending = True

    def reload(self, *_) -> None:
        """Ask the loop to call `on_reload`; may be called from a signal handler."""
        self._reloading = True

    def serve(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Answer requests until `stop`, SIGTERM or SIGINT."""
        heard = {signal.SIGTERM: self.stop, signal.SIGINT: self.stop, signal.SIGHUP: self.reload}
        before = {number: signal.signal(number, handler) for number, handler in heard.items()}
        try:
            for front in self._fronts:
                front.start(self._poller)
            self._engine.watch(self._poller)
            on_ready()
            self._systemd.say_ready()
            while not self._stopping:
                self._turn()
            self._systemd.say_stopping()
            for front in self._fronts:
                with self._survived():
                    front.stop_listening()
            self._turn(is_last=True)
            deadline = time.monotonic() + _FINISH_S
            while not self._dispatcher.is_idle:
                self._turn(is_closing=True)
                if time.monotonic() > deadline:
                    log.warning("not all requests were answered within %g s: the rest get `closing`", _FINISH_S)
                    self._dispatcher.give_up()
                    break
            deadline = time.monotonic() + _DRAIN_S
            while self._turn(is_closing=True) or not all(front.is_idle for front in self._fronts):
                if time.monotonic() > deadline:
                    log.warning("replies were left that clients did not take within %g s", _DRAIN_S)
                    break
            # Before workers and pages, whose end takes time: nobody is kept at a port behind which nobody is.
            for front in self._fronts:
                front.close(max(deadline - time.monotonic(), _LEAST_LINGER_S))
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _turn(self, is_last: bool = False, is_closing: bool = False) -> int:
        """Take in what has come, send what can be sent, begin what can be begun; how many requests came."""
        if self._dispatcher.can_work or is_last or any(front.has_more for front in self._fronts):
            timeout_ms = 0
        else:
            timeout_ms = _POLL_MS if all(front.is_idle for front in self._fronts) and not is_closing else _RETRY_MS
        ready = dict(self._poller.poll(timeout_ms))
        if self._reloading:
            self._reloading = False
            with self._survived():
                self._on_reload()
        with self._survived():
            self._engine.turn(ready)
        n_requests = 0
        for front in self._fronts:
            with self._survived():
                for request in front.take_in(ready):
                    self._dispatcher.submit(request, is_closing)
                    n_requests += 1
        with self._survived():
            self._dispatcher.work()
        self._systemd.say_alive()
        self._n_failed_turns, self._has_failed = self._n_failed_turns + 1 if self._has_failed else 0, False
        return n_requests

    @contextlib.contextmanager
    def _survived(self) -> Iterator[None]:
        """Log an error of one part of a turn, which does not keep the others from theirs."""
        try:
            yield
        except Exception:
            self._has_failed = True
            if self._n_failed_turns >= _MAX_FAILED_TURNS:
                raise
            log.exception("a part of the loop's turn failed")
