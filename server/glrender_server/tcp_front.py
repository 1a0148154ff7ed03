"""The TCP front end, for clients without ZeroMQ: the same messages, framed by `framing`."""

from __future__ import annotations

import contextlib
import ipaddress
import logging
import socket
import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import zmq
from glrender import ProtocolError

from . import limits
from .envelope import refusal
from .framing import Decoder
from .front import LOOPBACK_BUFFER, Request
from .stream import Outbox

log = logging.getLogger(__name__)

MAX_OWED = 16
"""Requests of one connection that may wait for their answer, before its further requests stay where they are."""
SPARE_CONNECTIONS, SPARE_S = 2, 1.0
"""Where all connections are at work, so many more are let in for so long [s], to ask for `limits.SPARE_OPERATIONS`."""
STALL_S = 30.0
"""A message begun and not finished, or a reply not taken, for this long ends its connection."""
_RECEIVE_BYTES = 1 << 18
_HANG_UP_S = 2.0
# Where the system has no descriptor for a new connection, the next is tried after a while.
_PAUSE_S = 1.0
# A peer that has vanished without a word is noticed after about two minutes.
_KEEP_ALIVE = (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 20), ("TCP_KEEPCNT", 3))


class TcpFront:
    """Listens on a TCP port; never blocks.

    Parameters
    ----------
    address : str
        ``127.0.0.1:5556``; port 0 takes a free one.
    max_connections : int
        Beyond them the connection that has been silent longest, and is owed nothing, is closed for a new one.

    Raises
    ------
    OSError
        The address cannot be bound.
    """

    def __init__(self, address: str, max_connections: int = 128):
        host, _, port = address.rpartition(":")
        host = host.strip("[]")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._listener = socket.create_server((host, int(port)), family=family, backlog=max_connections)
        except OSError as error:
            raise OSError(f"cannot listen on {address}: {error.strerror}; choose another with --tcp, e.g. "
                          f"--tcp 127.0.0.1:0, or stop the program that has it") from None
        self._listener.setblocking(False)
        bound, port = self._listener.getsockname()[:2]
        self.endpoint = f"{f'[{bound}]' if ':' in bound else bound}:{port}"
        self._max_connections, self._accepts_at = max_connections, 0.0
        self._connections: dict[int, _Connection] = {}

    @property
    def untaken_bytes(self) -> int:
        """Bytes of replies that all connections have not taken."""
        return sum(connection.untaken_bytes for connection in self._connections.values())

    def start(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop."""
        self._poller = poller
        poller.register(self._listener.fileno(), zmq.POLLIN)

    def take_in(self, ready: dict[Any, int]) -> list[Request]:
        """Requests that have come; sends on what slow readers have room for."""
        requests = []
        for number, connection in list(self._connections.items()):
            try:
                requests += connection.turn(ready.get(number, 0))
                if connection.is_done:
                    self._forget(connection)
                else:
                    self._watch(connection)
            except Exception:  # the others' requests are here, and would be lost
                log.exception("a connection's turn failed: closed")
                self._forget(connection)
        self._promote()
        # After those that are here: who has asked in a spare place is not closed for the next.
        if self._accepts_at and time.monotonic() >= self._accepts_at:
            self._accepts_at = 0.0
            self._poller.register(self._listener.fileno(), zmq.POLLIN)
        elif self._listener.fileno() in ready:
            self._accept()
        return requests

    @property
    def has_more(self) -> bool:
        """Whether a whole request is here that could be taken in at once."""
        return any(connection.has_request for connection in self._connections.values())

    @property
    def is_idle(self) -> bool:
        """Whether every reply has been handed to the system."""
        return not any(connection.has_output for connection in self._connections.values())

    def stop_listening(self) -> None:
        """Let no further connection come."""
        if self._listener.fileno() in self._poller:
            self._poller.unregister(self._listener.fileno())
        self._accepts_at = 0.0
        self._listener.close()

    def close(self, linger_s: float = 0.0) -> None:
        """Close every connection: the system sends what it has taken."""
        for connection in self._connections.values():
            connection.close()
        self._connections.clear()
        self._listener.close()

    def _accept(self) -> None:
        for _ in range(limits.MAX_TURN):
            try:
                peer, address = self._listener.accept()
            except BlockingIOError:
                return
            except OSError as error:
                log.warning("a connection was not accepted: %s", error.strerror)
                self._poller.unregister(self._listener.fileno())
                self._accepts_at = time.monotonic() + _PAUSE_S
                return
            is_spare = not self._make_room(is_spare=False)
            if is_spare and not self._make_room(is_spare=True):
                log.warning("%s: refused, %d connections are open and at work", address, len(self._connections))
                _refuse(peer, len(self._connections))
                continue
            try:
                connection = _Connection(peer, address[0], self._watch, lambda: self.untaken_bytes, is_spare)
            except OSError:  # it has gone by now
                peer.close()
                continue
            self._connections[peer.fileno()] = connection
            self._watch(connection)

    def _make_room(self, is_spare: bool) -> bool:
        """Whether there is a place, or has been made by closing one that is owed nothing, the longest silent."""
        if not is_spare:
            self._promote()
        there = [connection for connection in self._connections.values() if connection.is_spare == is_spare]
        if len(there) < (SPARE_CONNECTIONS if is_spare else self._max_connections):
            return True
        silent = [connection for connection in there if connection.is_silent]
        if not silent:
            return False
        log.warning("%d connections are open: the one that was silent longest is closed", len(self._connections))
        self._forget(min(silent, key=lambda connection: (connection.has_asked and not is_spare, connection.moved)))
        return True

    def _promote(self) -> None:
        """Give those in spare places a place that has become free."""
        spare = [connection for connection in self._connections.values() if connection.is_spare]
        n_free = self._max_connections - (len(self._connections) - len(spare))
        for connection in spare[:max(0, n_free)]:
            connection.is_spare = False

    def _watch(self, connection: _Connection) -> None:
        """Let the loop wake for what a connection waits for now."""
        self._poller.register(connection.number, (zmq.POLLIN if connection.wants_input else 0)
                              | (zmq.POLLOUT if connection.has_output else 0))

    def _forget(self, connection: _Connection) -> None:
        if connection.number in self._poller:
            self._poller.unregister(connection.number)
        connection.close()
        del self._connections[connection.number]


class _Connection:
    """One client: bytes that came, requests it is owed replies to, and bytes that it has to take."""

    def __init__(self, peer: socket.socket, host: str,
                 on_answer: Callable[[_Connection], None] = lambda connection: None,
                 in_all: Callable[[], int] = lambda: 0, is_spare: bool = False):
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if peer.getsockname()[0] in ("127.0.0.1", "::1"):
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LOOPBACK_BUFFER)
        for name, value in _KEEP_ALIVE:
            if hasattr(socket, name):
                peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._peer, self._decoder, self._on_answer, self._in_all = peer, Decoder(), on_answer, in_all
        self.is_spare, self._came = is_spare, time.monotonic()
        self.number = peer.fileno()
        # Another machine's connections take one turn together.
        self._sender: Hashable = id(self) if ipaddress.ip_address(host).is_loopback else host
        self._output, self.has_asked = Outbox(), False
        self._owed, self._is_open, self._has_ended, self._is_lost = 0, True, False, False
        self.moved, self._hang_up_at, self._error = time.monotonic(), None, None

    @property
    def has_output(self) -> bool:
        return bool(self._output)

    @property
    def untaken_bytes(self) -> int:
        return self._output.n_bytes

    @property
    def is_silent(self) -> bool:
        """Whether nothing is owed, nor half sent."""
        return not (self._owed or self._output or self._hang_up_at or self._error)

    @property
    def wants_input(self) -> bool:
        return (self._is_open and not self._has_ended and self._has_room) or self._hang_up_at is not None

    @property
    def _has_room(self) -> bool:
        return self._owed < MAX_OWED and not limits.is_too_much(self._output.n_bytes, self._in_all)

    @property
    def has_request(self) -> bool:
        return self._is_open and self._has_room and self._decoder.has_message

    @property
    def is_done(self) -> bool:
        """Lost, or closed by the client and answered in full."""
        return self._is_lost or not (self._is_open or self._owed or self._output or self._hang_up_at or self._error)

    def close(self) -> None:
        self._is_lost = True
        self._output.clear()
        self._peer.close()

    def turn(self, events: int) -> list[Request]:
        """Read and write what can be without waiting; the requests that are now complete."""
        if self._output:
            self._write()
        if events & ~zmq.POLLOUT and self.wants_input:
            self._read()
        requests = self._decoded()
        is_stuck = self._output or (self._is_open and not self._decoder.is_between_messages and not self._owed)
        if self._hang_up_at is not None and time.monotonic() > self._hang_up_at:
            self._is_lost = True
        elif self.is_spare and self.is_silent and time.monotonic() - self._came > SPARE_S:
            self._is_lost = True
        elif is_stuck and time.monotonic() - self.moved > STALL_S:
            log.warning("a client on TCP stood still for %g s within a message: closed", STALL_S)
            self._is_lost = True
        elif events & zmq.POLLERR:
            self._is_lost = True
        return requests

    def answer(self, reply: Sequence[Any]) -> None:
        """Queue one reply and send what the system takes at once."""
        if self._is_lost:
            return
        self._owed -= 1
        if not self._output:
            self.moved = time.monotonic()
        self._output.put(reply)
        self._write()
        self._break_off()
        # Bytes that the system did not take must not wait for the loop's next turn.
        self._on_answer(self)

    def _read(self) -> None:
        try:
            data = self._peer.recv(_RECEIVE_BYTES)
        except BlockingIOError:
            return
        except OSError:
            self._is_lost = True
            return
        if self._hang_up_at is not None:
            self._is_lost = not data and not self._output
        elif data:
            self._decoder.feed(data)
            self.moved = time.monotonic()
        else:
            # The client may have closed its side alone, and still wait for replies.
            self._has_ended = True

    def _decoded(self) -> list[Request]:
        requests = []
        try:
            messages = self._decoder.messages()
            while self._is_open and self._has_room and (parts := next(messages, None)) is not None:
                self._owed += 1
                self.has_asked = True
                requests.append(Request(self._sender, parts, self.answer, lambda: self._output.n_bytes,
                                        is_spare=self.is_spare, is_there=lambda: not self._is_lost))
        except ProtocolError as error:
            self._is_open, self._error = False, error
            self._break_off()
        # A stream that has ended may leave half a message, or one that waits for room.
        if self._has_ended and self._has_room:
            self._is_open = False
        return requests

    def _break_off(self) -> None:
        """Answer a stream that lost its framing, once all that came before is answered, and hang up."""
        if self._owed or self._error is None:
            return
        # Bytes on their way are read and thrown away: to close on unread bytes would reset the
        # connection, and the client would lose the answer.
        self._hang_up_at = time.monotonic() + _HANG_UP_S
        self._output.put(refusal({}, self._error.code, "", str(self._error)))
        self._error = None
        self._write()

    def _write(self) -> None:
        try:
            if self._output.write(self._peer):
                self.moved = time.monotonic()
            if self._hang_up_at is not None and not self._output:
                self._peer.shutdown(socket.SHUT_WR)
        except OSError:
            self._is_lost = True


def _refuse(peer: socket.socket, n_open: int) -> None:
    """Say `busy` to a connection too many, as far as it fits at once, and close it."""
    outbox = Outbox()
    outbox.put(refusal({}, "busy", "", f"{n_open} connections are open; close one", retry_after_s=_PAUSE_S))
    with peer, contextlib.suppress(OSError):
        peer.setblocking(False)
        outbox.write(peer)
