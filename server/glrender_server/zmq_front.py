"""The ZeroMQ front end: a ROUTER that keeps what a slow client does not take, for a while."""

from __future__ import annotations

import ctypes
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import zmq
from glrender import ConfigError

from . import framing, ipc_path, keys, limits
from .front import LOOPBACK_BUFFER, Request
from .peers import Peer, Peers

log = logging.getLogger(__name__)

# From this size a part is handed to ZeroMQ without a copy; below, the bookkeeping costs more.
_ZERO_COPY_BYTES = 65536
# Made once: to join flags takes the time of a system call.
_SEND_MORE = zmq.NOBLOCK | zmq.SNDMORE
# Messages that ZeroMQ may hold for one client before it is asked to wait, either way.
_SEND_HIGH_WATER, _RECEIVE_HIGH_WATER = 32, 32
# Memory of a reply that waits here, besides its bytes.
_REPLY_BYTES = 600
# A Unix socket is quickest when it holds the whole of a 4 MiB frame.
_IPC_BUFFER = 1 << 22
# Who leaves fewer bytes than any buffer has where they are is owed too little to be hung up on.
_STALL_S, _STALL_BYTES = 30.0, 1 << 16
# Messages are taken in for so long, before other transports and workers have their turn [s].
_TURN_S = 0.005
# An envelope of one or two parts, and as many as TCP takes. A message with more is thrown away, and is worth a
# connection if to read it takes tens of milliseconds. A part has two bytes at least.
_MAX_PARTS, _THROWN_AWAY_AT_ONCE, _MANY_PARTS, _MIN_PART_BYTES = 2 + framing.MAX_PARTS, 1000, 1 << 15, 2
_LINGER_S = 3.0
# Longest wait for ZeroMQ's own end after that [s]: 4.3.5 may wait for ever where a client with replies on their way has
# just gone.
_END_S = 2.0
# A peer that has vanished without a word is noticed after about two minutes.
_KEEP_ALIVE_IDLE_S, _KEEP_ALIVE_INTERVAL_S, _KEEP_ALIVE_COUNT = 60, 20, 3
# Who has connected and not shaken hands by then is closed by ZeroMQ.
_HANDSHAKE_MS = 10_000
# Interval at which bytes that ZeroMQ has sent by itself are looked for.
_FLUSH_S = 0.1


@dataclass
class _Backlog:
    """Replies that a client has still to take: those that ZeroMQ did not take, and buffers that it still holds."""

    replies: deque[list[Any]] = field(default_factory=deque)
    waiting_bytes: int = 0
    on_their_way: deque[tuple[zmq.MessageTracker, int]] = field(default_factory=deque)
    since: float = field(default_factory=time.monotonic)
    peer: Peer | None = None
    n_bytes_at_most: int = 0

    def put(self, reply: list[Any]) -> None:
        self.replies.append(reply)
        self.waiting_bytes += _size(reply)
        self.n_bytes_at_most += _size(reply)

    def taken(self) -> None:
        """ZeroMQ has the first."""
        self.waiting_bytes -= _size(self.replies.popleft())

    @property
    def held_bytes(self) -> int:
        """Bytes that we keep for it."""
        self.forget_sent()
        return self.waiting_bytes + sum(n_bytes for _, n_bytes in self.on_their_way)

    @property
    def n_bytes(self) -> int:
        """Bytes that it has not taken, those that the system has for it too."""
        self.n_bytes_at_most = self.held_bytes + (0 if self.peer is None else self.peer.queued_bytes())
        return self.n_bytes_at_most

    def forget_sent(self) -> None:
        while self.on_their_way and self.on_their_way[0][0].done:
            self.on_their_way.popleft()
            self.since = time.monotonic()


class ZmqFront:
    """Binds a ROUTER.

    Parameters
    ----------
    endpoint : str
        ``tcp://127.0.0.1:5555``, ``tcp://127.0.0.1:*`` or ``ipc:///path``.
    key_folder : path, optional
        Encrypt, and admit the clients of this folder alone (`keys`).
    max_connections : int
        Beyond them the connection that has been silent longest, and is owed nothing, is closed for a new one.
    max_parts, max_part_bytes : int
        Of one message; one of more parts is passed over, for a larger one ZeroMQ closes the connection.

    Raises
    ------
    OSError
        The endpoint cannot be bound.
    ConfigError
        The folder has no keys.
    """

    def __init__(self, endpoint: str, key_folder: Path | None = None, max_connections: int = 512,
                 max_parts: int = _MAX_PARTS, max_part_bytes: int = limits.MAX_HEADER_BYTES + 1024):
        # ZeroMQ numbers its clients from rand() on, and ends the process where one has taken the next number as its
        # name: it must not be the same number in every process.
        ctypes.CDLL(None).srand(int.from_bytes(os.urandom(4), "little"))
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        for option, value in ((zmq.MAXMSGSIZE, max_part_bytes),
                              # A reply to nobody or to a full pipe is an error to handle, not a silent drop.
                              (zmq.ROUTER_MANDATORY, 1),
                              # Nobody takes over the name, and so the replies, of another who is connected.
                              (zmq.ROUTER_HANDOVER, 0),
                              (zmq.HANDSHAKE_IVL, _HANDSHAKE_MS),
                              (zmq.SNDHWM, _SEND_HIGH_WATER), (zmq.RCVHWM, _RECEIVE_HIGH_WATER),
                              (zmq.SNDBUF, _send_buffer(endpoint)), (zmq.TCP_KEEPALIVE, 1),
                              (zmq.TCP_KEEPALIVE_IDLE, _KEEP_ALIVE_IDLE_S), (zmq.TCP_KEEPALIVE_CNT, _KEEP_ALIVE_COUNT),
                              (zmq.TCP_KEEPALIVE_INTVL, _KEEP_ALIVE_INTERVAL_S)):
            self._socket.set(option, value)
        self._backlogs: dict[bytes, _Backlog] = {}
        self._n_parts, self._max_parts, self._flushed = 0, max_parts, 0.0
        self._admission, self._authenticator, self._claim, self._peers = None, None, None, None
        try:
            if key_folder is not None:
                self._admission = keys.Admission(key_folder)
                self._authenticator = self._admission.protect(self._socket)
            self._claim = ipc_path.claimed(endpoint)
            self._socket.bind(endpoint)
            if self._claim is not None:
                self._claim.restrict()
            self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
            self._peers = Peers(self.endpoint, max_connections, max_part_bytes, _RECEIVE_HIGH_WATER)
        except (ConfigError, OSError):
            self.close()
            raise
        except zmq.ZMQError as error:
            self.close()
            raise OSError(f"cannot listen on {endpoint}: {error.strerror}; choose another with --zmq, e.g. "
                          f"--zmq tcp://127.0.0.1:0, or stop the program that has it") from None

    @property
    def untaken_bytes(self) -> int:
        """Bytes of replies that all clients have not taken."""
        return sum(backlog.held_bytes for backlog in self._backlogs.values())

    def start(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop."""
        poller.register(self._socket, zmq.POLLIN)

    @property
    def has_more(self) -> bool:
        """ZeroMQ wakes the loop itself."""
        return False

    def take_in(self, ready: dict[Any, int]) -> Iterator[Request]:
        """Requests that have come, for a while; tries again what a slow client has not taken."""
        # Before a mark is set: of bytes that came after the poll it says nothing.
        if self._socket not in ready:
            self._peers.has_read_all()
        self._peers.patrol()
        now = time.monotonic()
        is_due = now - self._flushed > _FLUSH_S
        self._flushed = now if is_due else self._flushed
        for identity in [identity for identity, backlog in self._backlogs.items() if is_due or backlog.replies]:
            self._flush(identity, is_due)
        if self._socket not in ready:
            return
        end = time.monotonic() + _TURN_S
        while time.monotonic() < end and (frames := self._message()) is not None:
            try:
                request = self._request(frames) if frames else None
            except Exception:
                log.exception("a message was passed over")
                continue
            if request is not None:
                yield request

    def _message(self) -> list[zmq.Frame] | None:
        """The parts of the next message, of one with too many none; None if there is none now."""
        frames: list[zmq.Frame] = []
        for _ in range(_THROWN_AWAY_AT_ONCE):
            try:
                frame = self._socket.recv(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                self._peers.has_read_all()
                return None
            self._n_parts += 1
            if self._n_parts <= self._max_parts:
                frames.append(frame)
            elif self._n_parts == _MANY_PARTS and (peer := self._peers.of(frame)) is not None:
                self._peers.hang_up_if_sent(peer, _MANY_PARTS * _MIN_PART_BYTES)
            if not frame.more:
                self._peers.has_read_message()
                n_parts, self._n_parts = self._n_parts, 0
                return frames if n_parts <= self._max_parts else []
        return []

    def _request(self, frames: list[zmq.Frame]) -> Request | None:
        identity, *parts = frames
        name = identity.bytes
        peer = self._peers.of(parts[0] if parts else identity)
        if peer is not None:
            peer.heard_of(len(frames), sum(map(len, frames)))
        user = ""
        if self._admission is not None:
            user = self._admission.name_of(parts[0].get("User-Id") if parts else "")
            if not user:
                return None  # a key that has been taken away since: it hears nothing more
        # A REQ socket puts an empty part between its identity and the message.
        envelope = [name, b""] if parts and not len(parts[0]) else [name]
        if peer is not None:
            peer.n_owed += 1
        return Request(user or name, [part.bytes for part in parts[len(envelope) - 1:]],
                       partial(self._answer, envelope, peer), partial(self._untaken_by, name), user,
                       user or (None if peer is None else peer.account),
                       is_there=lambda: peer is None or peer.is_there)

    @property
    def is_idle(self) -> bool:
        """Whether ZeroMQ has taken every reply."""
        return not any(backlog.replies for backlog in self._backlogs.values())

    def reload_keys(self) -> None:
        """Look at once, and at every file, for the clients that are admitted."""
        if self._admission is not None:
            self._admission.reload()

    def stop_listening(self) -> None:
        """Do nothing: ZeroMQ's `unbind` ends the connections that came by it; who comes now is answered `closing`."""

    def close(self, linger_s: float = _LINGER_S) -> None:
        """Close the socket, after what it has taken is sent or the time is over; wait a while for the end of ZeroMQ."""
        self._socket.close(round(1e3 * linger_s))
        if self._authenticator is not None and self._authenticator.is_alive():
            self._authenticator.stop()
        ending = threading.Thread(target=self._context.term, name="zmq-end", daemon=True)
        ending.start()
        ending.join(linger_s + _END_S)
        if ending.is_alive():
            log.warning("ZeroMQ has not ended after %g s: its threads are left behind", linger_s + _END_S)
        if self._claim is not None:
            self._claim.release()
            self._claim = None
        if self._peers is not None:
            self._peers.close()

    def _untaken_by(self, identity: bytes) -> int:
        backlog = self._backlogs.get(identity)
        if backlog is None:
            return 0
        # An amount that cannot be too much need not be counted.
        most = backlog.n_bytes_at_most
        return most if most <= limits.FEW_UNTAKEN_BYTES else backlog.n_bytes

    def _answer(self, envelope: list[bytes], peer: Peer | None, reply: Sequence[Any]) -> None:
        if peer is not None:
            peer.n_owed -= 1
            if not peer.is_there:
                return  # whoever has its name now has not asked for this
        identity = envelope[0]
        backlog = self._backlogs.setdefault(identity, _Backlog())
        backlog.peer = peer
        # Large ones are frames, which were let in by this very rule before they were drawn.
        is_small = sum(map(len, reply)) < _ZERO_COPY_BYTES
        if is_small and limits.is_too_much(backlog.waiting_bytes, lambda: self.untaken_bytes):
            log.warning("a client takes nothing: replies were dropped")
        else:
            backlog.put([*envelope, *reply])
        self._flush(identity, False)

    def _flush(self, identity: bytes, is_due: bool) -> None:
        """Send what ZeroMQ takes; where it is due, look at what the client has taken."""
        backlog = self._backlogs[identity]
        try:
            while backlog.replies:
                self._send(backlog)
                backlog.since = time.monotonic()
        except zmq.Again:
            pass
        except zmq.ZMQError as error:
            log.warning("replies to a client were not sent: %s", error.strerror)
            del self._backlogs[identity]
            return
        if not is_due:
            return
        if not backlog.replies and not backlog.on_their_way and backlog.n_bytes_at_most <= _STALL_BYTES:
            del self._backlogs[identity]  # less than any buffer has
            return
        if not (n_bytes := backlog.n_bytes):
            del self._backlogs[identity]
        elif n_bytes > _STALL_BYTES and time.monotonic() - backlog.since > _STALL_S:
            peer = backlog.peer
            # A part that a slow network carries takes its time.
            if peer is not None and peer.moved > backlog.since:
                backlog.since = peer.moved
                return
            del self._backlogs[identity]
            # Another than the one that asked has nothing to take.
            if peer is not None and peer.n_queued_bytes:
                log.warning("a client took nothing for %g s: it is hung up on", _STALL_S)
                self._peers.hang_up(peer)

    def _send(self, backlog: _Backlog) -> None:
        message = backlog.replies[0]
        for index, part in enumerate(message):
            flags = _SEND_MORE if index + 1 < len(message) else zmq.NOBLOCK
            if len(part) < _ZERO_COPY_BYTES:
                self._socket.send(part, flags)
            else:
                tracker = self._socket.send(part, flags, copy=False, track=True)
                backlog.on_their_way.append((tracker, len(part)))
        backlog.taken()


def _size(reply: list[Any]) -> int:
    """Bytes of a reply that waits, and of the objects around it."""
    return _REPLY_BYTES + sum(map(len, reply))


def _send_buffer(endpoint: str) -> int:
    if endpoint.startswith("ipc:"):
        return _IPC_BUFFER
    return LOOPBACK_BUFFER if endpoint.startswith(("tcp://127.", "tcp://[::1]")) else -1
