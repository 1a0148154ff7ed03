"""The ZeroMQ front end: a ROUTER that keeps what a slow client does not take, for a while."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import zmq
from glrender import ConfigError

from . import keys
from .codec import MAX_HEADER_BYTES
from .front import LOOPBACK_BUFFER, Request

log = logging.getLogger(__name__)

# From this size a part is handed to ZeroMQ without a copy; below, the bookkeeping costs more.
_ZERO_COPY_BYTES = 65536
# Replies that ZeroMQ may hold for one client, and that wait here when it holds so many.
_HIGH_WATER, _MAX_BACKLOG = 32, 256
# A Unix socket is quickest when it holds the whole of a 4 MiB frame.
_IPC_BUFFER = 1 << 22
_STALL_S = 10.0
_LINGER_MS = 3000


@dataclass
class _Backlog:
    replies: deque[list[Any]] = field(default_factory=deque)
    since: float = field(default_factory=time.monotonic)


class ZmqFront:
    """Binds a ROUTER.

    Parameters
    ----------
    endpoint : str
        ``tcp://127.0.0.1:5555``, ``tcp://127.0.0.1:*`` or ``ipc:///path``.
    key_folder : path, optional
        Encrypt, and admit the clients of this folder alone (`keys`).

    Raises
    ------
    OSError
        The endpoint cannot be bound.
    ConfigError
        The folder has no keys.
    """

    def __init__(self, endpoint: str, key_folder: Path | None = None):
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.set(zmq.LINGER, _LINGER_MS)
        self._socket.set(zmq.MAXMSGSIZE, MAX_HEADER_BYTES + 1024)
        # A reply to nobody or to a full pipe is an error to handle, not a silent drop; a client
        # that reconnects under its name takes over.
        self._socket.set(zmq.ROUTER_MANDATORY, 1)
        self._socket.set(zmq.ROUTER_HANDOVER, 1)
        self._socket.set(zmq.SNDHWM, _HIGH_WATER)
        self._socket.set(zmq.SNDBUF, _send_buffer(endpoint))
        self._backlogs: dict[bytes, _Backlog] = {}
        self._authenticator = None
        try:
            if key_folder is not None:
                self._authenticator = keys.protect(self._socket, key_folder)
            self._socket.bind(endpoint)
        except ConfigError:
            self.close()
            raise
        except zmq.ZMQError as error:
            self.close()
            raise OSError(f"cannot listen on {endpoint}: {error.strerror}; choose another with --zmq, e.g. "
                          f"--zmq tcp://127.0.0.1:0, or stop the program that has it") from None
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def start(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop."""
        poller.register(self._socket, zmq.POLLIN)

    def take_in(self, ready: dict[Any, int]) -> list[Request]:
        """Requests that have come; tries again what a slow client has not taken."""
        for identity in list(self._backlogs):
            self._flush(identity)
        requests = []
        while self._socket.poll(0):
            identity, *parts = self._socket.recv_multipart()
            # A REQ socket puts an empty part between its identity and the message.
            envelope = [identity, b""] if parts and parts[0] == b"" else [identity]
            requests.append(Request(identity, parts[len(envelope) - 1:], partial(self._answer, envelope)))
        return requests

    @property
    def is_idle(self) -> bool:
        """Whether ZeroMQ has taken every reply."""
        return not self._backlogs

    def close(self) -> None:
        """Close the socket, after what it has taken is sent or three seconds are over."""
        self._socket.close()
        if self._authenticator is not None and self._authenticator.is_alive():
            self._authenticator.stop()
        self._context.term()

    def _answer(self, envelope: list[bytes], reply: Sequence[Any]) -> None:
        identity = envelope[0]
        backlog = self._backlogs.setdefault(identity, _Backlog())
        if len(backlog.replies) < _MAX_BACKLOG:
            backlog.replies.append([*envelope, *reply])
        else:
            log.warning("client %s takes nothing: a reply was dropped", identity.hex())
        self._flush(identity)

    def _flush(self, identity: bytes) -> None:
        backlog = self._backlogs[identity]
        try:
            while backlog.replies:
                self._send(backlog.replies[0])
                backlog.replies.popleft()
                backlog.since = time.monotonic()
        except zmq.Again:
            if time.monotonic() - backlog.since < _STALL_S:
                return
            log.warning("client %s took nothing for %g s: %d replies were dropped", identity.hex(), _STALL_S,
                        len(backlog.replies))
        except zmq.ZMQError as error:
            log.warning("%d replies to client %s were not sent: %s", len(backlog.replies), identity.hex(),
                        error.strerror)
        del self._backlogs[identity]

    def _send(self, message: list[Any]) -> None:
        for index, part in enumerate(message):
            more = zmq.SNDMORE if index + 1 < len(message) else 0
            self._socket.send(part, zmq.NOBLOCK | more, copy=len(part) < _ZERO_COPY_BYTES)


def _send_buffer(endpoint: str) -> int:
    if endpoint.startswith("ipc:"):
        return _IPC_BUFFER
    return LOOPBACK_BUFFER if endpoint.startswith(("tcp://127.", "tcp://[::1]")) else -1
