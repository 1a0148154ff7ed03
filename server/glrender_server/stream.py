"""Byte streams that are read and written without waiting: what a socket has not taken yet, and channels to workers."""

from __future__ import annotations

import pickle
import socket
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from .framing import Decoder, framed

_PARTS_AT_ONCE = 64
_RECEIVE_BYTES = 1 << 18
# Pickles between server and worker: a scene of some million facets.
_MAX_PICKLE_BYTES = (1 << 32) - 1


class Outbox:
    """Bytes that a socket has still to take."""

    def __init__(self):
        self._views: deque[memoryview] = deque()
        self.n_bytes = 0

    def __bool__(self) -> bool:
        return bool(self._views)

    def put(self, parts: Sequence[Any]) -> None:
        """Add one message, framed."""
        views = framed(parts)
        self._views += views
        self.n_bytes += sum(map(len, views))

    def clear(self) -> None:
        """Forget everything."""
        self._views.clear()
        self.n_bytes = 0

    def write(self, peer: socket.socket) -> int:
        """Send what the system takes; the bytes that it took.

        Raises
        ------
        OSError
            The connection is lost.
        """
        total = 0
        try:
            while self._views:
                sent = peer.sendmsg([view for view, _ in zip(self._views, range(_PARTS_AT_ONCE), strict=False)])
                total += sent
                while self._views and sent >= len(self._views[0]):
                    sent -= len(self._views.popleft())
                if sent:
                    self._views[0] = self._views[0][sent:]
        except BlockingIOError:
            pass
        self.n_bytes -= total
        return total


class Channel:
    """Python objects between the server and a worker, over a stream socket.

    Whoever has the blocking end waits; the other never does: what the peer does not take stays in `outbox`.

    Parameters
    ----------
    peer : socket
        Owned.
    is_blocking : bool
    """

    def __init__(self, peer: socket.socket, is_blocking: bool = False):
        peer.setblocking(is_blocking)
        self._is_blocking = is_blocking
        self._peer, self._decoder, self.outbox = peer, Decoder(_MAX_PICKLE_BYTES), Outbox()

    def fileno(self) -> int:
        """The socket's descriptor, for a poller."""
        return self._peer.fileno()

    def send(self, *said: Any) -> None:
        """Send one tuple.

        Raises
        ------
        OSError
            The peer is gone.
        """
        self.outbox.put([pickle.dumps(said, pickle.HIGHEST_PROTOCOL)])
        self.flush()

    def flush(self) -> None:
        """Send on what the peer takes now.

        Raises
        ------
        OSError
        """
        self.outbox.write(self._peer)

    def receive(self) -> tuple:
        """Wait for the next tuple (blocking end).

        Raises
        ------
        EOFError, OSError
            The peer is gone.
        """
        return next(self.messages())

    def messages(self) -> Iterator[tuple]:
        """The tuples that have come, until there are no more now.

        Raises
        ------
        EOFError, OSError
            The peer is gone.
        """
        has_more = True
        while True:
            for (data,) in self._decoder.messages():
                yield pickle.loads(data)
            if not has_more:
                return
            try:
                data = self._peer.recv(_RECEIVE_BYTES)
            except BlockingIOError:
                return
            if not data:
                raise EOFError
            self._decoder.feed(data)
            # A poller reports bytes that come later.
            has_more = self._is_blocking or len(data) == _RECEIVE_BYTES

    def close(self) -> None:
        """Close the socket."""
        self._peer.close()
