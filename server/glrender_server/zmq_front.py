"""The ZeroMQ front end: a ROUTER in the renderer's own thread."""

from __future__ import annotations

import logging
import signal
from collections import deque
from collections.abc import Callable

import zmq

from .codec import MAX_HEADER_BYTES
from .dispatcher import Dispatcher

log = logging.getLogger(__name__)

QUEUE_LENGTH = 32
"""Requests that may wait; the next is answered `busy`."""
# From this size a part is handed to ZeroMQ without a copy; below, the bookkeeping costs more.
_ZERO_COPY_BYTES = 65536
_POLL_MS = 100
_SEND_TIMEOUT_MS = 5000
_LINGER_MS = 3000


class ZmqServer:
    """Binds, serves until told to stop, answers what is waiting, and closes.

    Parameters
    ----------
    dispatcher : Dispatcher
    endpoint : str
        ``tcp://127.0.0.1:5555``, ``tcp://127.0.0.1:*`` or ``ipc:///path``.

    Raises
    ------
    OSError
        The endpoint cannot be bound.
    """

    def __init__(self, dispatcher: Dispatcher, endpoint: str):
        self._dispatcher = dispatcher
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.set(zmq.LINGER, _LINGER_MS)
        self._socket.set(zmq.MAXMSGSIZE, MAX_HEADER_BYTES + 1024)
        # A reply to nobody is an error to log, not a silent drop; a client that reconnects under
        # its name takes over.
        self._socket.set(zmq.ROUTER_MANDATORY, 1)
        self._socket.set(zmq.ROUTER_HANDOVER, 1)
        self._socket.set(zmq.SNDTIMEO, _SEND_TIMEOUT_MS)
        self._stopping = False
        try:
            self._socket.bind(endpoint)
        except zmq.ZMQError as error:
            self._socket.close()
            self._context.term()
            raise OSError(f"cannot listen on {endpoint}: {error.strerror}; choose another with --zmq, e.g. "
                          f"--zmq tcp://127.0.0.1:0, or stop the program that has it") from None
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def stop(self, *_) -> None:
        """Ask the loop to end; may be called from a signal handler."""
        self._stopping = True

    def serve(self, on_ready: Callable[[str], None] = lambda endpoint: None) -> None:
        """Answer requests until `stop`, SIGTERM or SIGINT."""
        before = {number: signal.signal(number, self.stop) for number in (signal.SIGTERM, signal.SIGINT)}
        waiting: deque[list[bytes]] = deque()
        try:
            on_ready(self.endpoint)
            while not self._stopping:
                if waiting or self._socket.poll(_POLL_MS):
                    self._take_in(waiting)
                if waiting:
                    self._answer(waiting.popleft(), self._dispatcher.handle)
            self._take_in(waiting)
            while waiting:
                self._answer(waiting.popleft(), self._dispatcher.handle)
            while self._socket.poll(0):
                self._answer(self._socket.recv_multipart(), self._dispatcher.closing)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            self._socket.close()
            self._context.term()

    def _take_in(self, waiting: deque[list[bytes]]) -> None:
        while self._socket.poll(0):
            message = self._socket.recv_multipart()
            if len(waiting) < QUEUE_LENGTH:
                waiting.append(message)
            else:
                self._answer(message, lambda parts: self._dispatcher.busy(parts, len(waiting)))

    def _answer(self, message: list[bytes], handle: Callable[[list[bytes]], list]) -> None:
        identity, *parts = message
        # A REQ socket puts an empty part between its identity and the message.
        envelope = [identity, b""] if parts and parts[0] == b"" else [identity]
        reply = handle(parts[len(envelope) - 1:])
        try:
            for part in envelope:
                self._socket.send(part, zmq.SNDMORE)
            for index, part in enumerate(reply):
                more = zmq.SNDMORE if index + 1 < len(reply) else 0
                self._socket.send(part, more, copy=len(part) < _ZERO_COPY_BYTES)
        except zmq.ZMQError as error:
            log.warning("reply to client %s was not sent: %s", identity.hex(), error.strerror)
