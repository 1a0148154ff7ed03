"""The ZeroMQ front end: a ROUTER that keeps what a slow client does not take, for a while."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import socket
import stat
import struct
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import zmq
from glrender import ConfigError
from zmq.utils.monitor import recv_monitor_message

from . import ipc_path, keys, limits
from .front import LOOPBACK_BUFFER, Request

log = logging.getLogger(__name__)

# From this size a part is handed to ZeroMQ without a copy; below, the bookkeeping costs more.
_ZERO_COPY_BYTES = 65536
# Messages that ZeroMQ may hold for one client before it is asked to wait, either way, and replies that wait here then.
_SEND_HIGH_WATER, _RECEIVE_HIGH_WATER, _MAX_BACKLOG = 32, 32, 256
# A Unix socket is quickest when it holds the whole of a 4 MiB frame.
_IPC_BUFFER = 1 << 22
_STALL_S = 30.0
# Messages are taken in for so long, before other transports and workers have their turn [s].
_TURN_S = 0.005
# A request has one part behind its envelope of one or two; of a message with more, the rest is thrown away.
_MAX_PARTS, _THROWN_AWAY_AT_ONCE = 4, 1000
_LINGER_MS = 3000
# A peer that has vanished without a word is noticed after about two minutes.
_KEEP_ALIVE_IDLE_S, _KEEP_ALIVE_INTERVAL_S, _KEEP_ALIVE_COUNT = 60, 20, 3
# A client sends some hundred megabytes a second on loopback; a look takes 5 us.
_PATROL_S, _PATROL_S_PER_CONNECTION = 0.05, 2e-4
# Bytes of ZMTP around one part, with CURVE, at most.
_PART_OVERHEAD_BYTES = 80
# Places of tcpi_bytes_acked and tcpi_bytes_received (u64) in struct tcp_info, since Linux 4.1 (linux/tcp.h).
_TCP_INFO_ACKED, _TCP_INFO_RECEIVED = 120, 128


@dataclass(eq=False)
class _Connection:
    """A socket of ZeroMQ's, by its descriptor here; its inode tells whether the descriptor is still this socket's."""

    descriptor: int
    inode: int
    heard: float = field(default_factory=time.monotonic)
    has_asked: bool = False
    n_owed: int = 0
    n_read_bytes: int = 0
    n_sent_bytes: int = 0
    n_acknowledged_bytes: int = 0

    @property
    def is_there(self) -> bool:
        try:
            return os.fstat(self.descriptor).st_ino == self.inode
        except OSError:
            return False

    def unfinished_bytes(self) -> int:
        """Bytes that the system has received on it and that no message has brought us."""
        received = self._counted(_TCP_INFO_RECEIVED)
        # What surrounds parts is reckoned high: no credit comes of it.
        self.n_read_bytes = min(self.n_read_bytes, received)
        return received - self.n_read_bytes

    def unacknowledged_bytes(self) -> int:
        """Bytes of replies that its peer's system has not taken; 0 of a Unix socket."""
        taken = self._counted(_TCP_INFO_ACKED)
        self.n_sent_bytes = max(self.n_sent_bytes, taken)
        return self.n_sent_bytes - taken if taken else 0

    def has_moved(self) -> bool:
        """Whether its peer has taken bytes since this was asked last."""
        before, self.n_acknowledged_bytes = self.n_acknowledged_bytes, self._counted(_TCP_INFO_ACKED)
        return self.n_acknowledged_bytes > before

    def _counted(self, place: int) -> int:
        """A count of the system's of a TCP connection; 0 of a Unix socket, which only our own user reaches."""
        try:
            with socket.socket(fileno=os.dup(self.descriptor)) as twin:
                told = twin.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, place + 8)
        except OSError:
            return 0
        return struct.unpack_from("Q", told, place)[0] if len(told) >= place + 8 else 0

    def hang_up(self) -> None:
        """End it: ZeroMQ forgets all that it holds of it."""
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(self.descriptor)) as twin:
            # The descriptor may be another socket's by now; the twin's will not change.
            if os.fstat(twin.fileno()).st_ino == self.inode:
                # A peer that writes into a full window would not hear of the end for a minute: ZeroMQ's close resets.
                twin.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                twin.shutdown(socket.SHUT_RDWR)


@dataclass
class _Backlog:
    """Replies that a client has still to take: those that ZeroMQ did not take, and buffers that it still holds."""

    replies: deque[list[Any]] = field(default_factory=deque)
    on_their_way: deque[tuple[zmq.MessageTracker, int]] = field(default_factory=deque)
    since: float = field(default_factory=time.monotonic)
    connection: _Connection | None = None

    @property
    def n_bytes(self) -> int:
        self.forget_sent()
        handed_over = sum(n_bytes for _, n_bytes in self.on_their_way)
        if self.connection is not None:
            handed_over = max(handed_over, self.connection.unacknowledged_bytes())
        return handed_over + sum(len(part) for reply in self.replies for part in reply)

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
        Of one message; beyond them its connection is closed.

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
        for option, value in ((zmq.LINGER, _LINGER_MS), (zmq.MAXMSGSIZE, max_part_bytes),
                              # A reply to nobody or to a full pipe is an error to handle, not a silent drop.
                              (zmq.ROUTER_MANDATORY, 1),
                              # Nobody takes over the name, and so the replies, of another who is connected.
                              (zmq.ROUTER_HANDOVER, 0),
                              (zmq.SNDHWM, _SEND_HIGH_WATER), (zmq.RCVHWM, _RECEIVE_HIGH_WATER),
                              (zmq.SNDBUF, _send_buffer(endpoint)), (zmq.TCP_KEEPALIVE, 1),
                              (zmq.TCP_KEEPALIVE_IDLE, _KEEP_ALIVE_IDLE_S), (zmq.TCP_KEEPALIVE_CNT, _KEEP_ALIVE_COUNT),
                              (zmq.TCP_KEEPALIVE_INTVL, _KEEP_ALIVE_INTERVAL_S)):
            self._socket.set(option, value)
        self._monitor: zmq.Socket | None = None
        self._connections: dict[int, _Connection] = {}
        self._backlogs: dict[bytes, _Backlog] = {}
        self._is_throwing_away, self._max_parts = False, max_parts
        self._max_connections, self._patrolled = max_connections, 0.0
        self._admission, self._authenticator, self._claim = None, None, None
        try:
            if key_folder is not None:
                self._admission = keys.Admission(key_folder)
                self._authenticator = self._admission.protect(self._socket)
            self._claim = ipc_path.claimed(endpoint)
            self._socket.bind(endpoint)
            if self._claim is not None:
                self._claim.restrict()
        except (ConfigError, OSError):
            self.close()
            raise
        except zmq.ZMQError as error:
            self.close()
            raise OSError(f"cannot listen on {endpoint}: {error.strerror}; choose another with --zmq, e.g. "
                          f"--zmq tcp://127.0.0.1:0, or stop the program that has it") from None
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    @property
    def untaken_bytes(self) -> int:
        """Bytes of replies that all clients have not taken."""
        return sum(backlog.n_bytes for backlog in self._backlogs.values())

    def start(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop."""
        self._monitor = self._socket.get_monitor_socket(zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED)
        self._adopt_connections()
        poller.register(self._socket, zmq.POLLIN)
        poller.register(self._monitor, zmq.POLLIN)

    @property
    def has_more(self) -> bool:
        """ZeroMQ wakes the loop itself."""
        return False

    def take_in(self, ready: dict[Any, int]) -> Iterator[Request]:
        """Requests that have come, for a while; tries again what a slow client has not taken."""
        self._follow_connections()
        for identity in [identity for identity, backlog in self._backlogs.items() if backlog.replies]:
            self._flush(identity)
        self._patrol()
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
                return None
            if not self._is_throwing_away:
                frames.append(frame)
                if len(frames) > self._max_parts and frame.more:
                    self._is_throwing_away = True
                    if (connection := self._connection_of(frame)) is not None:
                        log.warning("a client sent a message of many parts: closed")
                        connection.hang_up()
            if not frame.more:
                frames = [] if self._is_throwing_away else frames
                self._is_throwing_away = False
                return frames
        return []

    def _request(self, frames: list[zmq.Frame]) -> Request | None:
        identity, *parts = frames
        name = identity.bytes
        connection = self._connection_of(parts[0] if parts else identity)
        if connection is not None:
            connection.heard = time.monotonic()
            connection.n_read_bytes += sum(len(part) + _PART_OVERHEAD_BYTES for part in frames)
        user = ""
        if self._admission is not None:
            user = self._admission.name_of(parts[0].get("User-Id") if parts else "")
            if not user:
                # A key that has been taken away since.
                if connection is not None:
                    connection.hang_up()
                return None
        # A REQ socket puts an empty part between its identity and the message.
        envelope = [name, b""] if parts and not len(parts[0]) else [name]
        if connection is not None:
            connection.has_asked = True
            connection.n_owed += 1
        return Request(user or name, [part.bytes for part in parts[len(envelope) - 1:]],
                       partial(self._answer, envelope, connection), partial(self._untaken_by, name), user)

    def _connection_of(self, frame: zmq.Frame) -> _Connection | None:
        """The connection that a message came over."""
        try:
            descriptor = frame.get(zmq.SRCFD)
        except zmq.ZMQError:
            return None
        known = self._connections.get(descriptor)
        if known is None or not known.is_there:
            # The monitor tells later than the message that another has the descriptor now.
            self._follow_connections()
            if known is self._connections.get(descriptor):
                self._connections.pop(descriptor, None)
            self._adopt(descriptor)
        return self._connections.get(descriptor)

    def _adopt_connections(self) -> None:
        """Take account of the connections that were accepted before the monitor was there."""
        for name in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else ():
            with contextlib.suppress(OSError):
                if stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                    with socket.socket(fileno=os.dup(int(name))) as twin:
                        ours, theirs = twin.getsockname(), twin.getpeername()
                    if theirs and isinstance(ours, tuple) and self.endpoint.endswith(f":{ours[1]}"):
                        self._adopt(int(name))

    def _adopt(self, descriptor: int) -> None:
        with contextlib.suppress(OSError):
            self._connections.setdefault(descriptor, _Connection(descriptor, os.fstat(descriptor).st_ino))

    @property
    def is_idle(self) -> bool:
        """Whether ZeroMQ has taken every reply."""
        return not any(backlog.replies for backlog in self._backlogs.values())

    def close(self) -> None:
        """Close the socket, after what it has taken is sent or three seconds are over."""
        if self._monitor is not None:
            self._socket.disable_monitor()
            self._monitor.close(0)
        self._socket.close()
        if self._authenticator is not None and self._authenticator.is_alive():
            self._authenticator.stop()
        self._context.term()
        if self._claim is not None:
            self._claim.release()

    def _follow_connections(self) -> None:
        """Keep account of ZeroMQ's connections, and of their number."""
        while self._monitor is not None and self._monitor.poll(0):
            event = recv_monitor_message(self._monitor, zmq.NOBLOCK)
            descriptor = event["value"]
            self._connections.pop(descriptor, None)
            if event["event"] == zmq.EVENT_ACCEPTED:
                self._adopt(descriptor)  # it may have gone already
                if len(self._connections) > self._max_connections:
                    self._make_room(descriptor)

    def _make_room(self, newest: int) -> None:
        silent = [c for c in self._connections.values() if not c.n_owed and c.descriptor != newest]
        victim = min(silent, key=lambda each: (each.has_asked, each.heard), default=self._connections.get(newest))
        if victim is not None:
            log.warning("%d connections are open: the one that was silent longest is closed", len(self._connections))
            victim.hang_up()
            del self._connections[victim.descriptor]

    def _patrol(self) -> None:
        """Forget what has been taken, and hang up on who takes nothing, or does not end messages of many parts.

        ZeroMQ bounds the size of one part alone.
        """
        now = time.monotonic()
        if now - self._patrolled < _PATROL_S + _PATROL_S_PER_CONNECTION * len(self._connections):
            return
        self._patrolled = now
        for identity in list(self._backlogs):
            self._flush(identity)
        unfinished = sorted(((connection.unfinished_bytes(), connection) for connection in self._connections.values()),
                            key=lambda entry: -entry[0])
        total = sum(n_bytes for n_bytes, _ in unfinished)
        for n_bytes, connection in unfinished:
            if n_bytes <= limits.MAX_UNFINISHED_BYTES and total <= limits.MAX_UNFINISHED_BYTES_IN_ALL:
                return
            log.warning("a client sent %d bytes of messages that it did not end: closed", n_bytes)
            connection.hang_up()
            total -= n_bytes

    def _untaken_by(self, identity: bytes) -> int:
        backlog = self._backlogs.get(identity)
        return 0 if backlog is None else backlog.n_bytes

    def _answer(self, envelope: list[bytes], connection: _Connection | None, reply: Sequence[Any]) -> None:
        if connection is not None:
            connection.n_owed -= 1
            if not connection.is_there:
                return  # whoever has its name now has not asked for this
        identity = envelope[0]
        backlog = self._backlogs.setdefault(identity, _Backlog())
        if connection is not None and backlog.connection is not connection:
            backlog.connection = connection
            connection.has_moved()  # counts from now on
        if len(backlog.replies) < _MAX_BACKLOG:
            backlog.replies.append([*envelope, *reply])
        else:
            log.warning("a client takes nothing: replies were dropped")
        self._flush(identity)

    def _flush(self, identity: bytes) -> None:
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
        if not backlog.n_bytes:
            del self._backlogs[identity]
        elif time.monotonic() - backlog.since > _STALL_S:
            # A part that a slow network carries takes its time.
            if backlog.connection is not None and backlog.connection.has_moved():
                backlog.since = time.monotonic()
                return
            log.warning("a client took nothing for %g s: it is hung up on", _STALL_S)
            del self._backlogs[identity]
            if backlog.connection is not None:
                backlog.connection.hang_up()

    def _send(self, backlog: _Backlog) -> None:
        message = backlog.replies[0]
        for index, part in enumerate(message):
            more = zmq.SNDMORE if index + 1 < len(message) else 0
            if len(part) < _ZERO_COPY_BYTES:
                self._socket.send(part, zmq.NOBLOCK | more)
            else:
                tracker = self._socket.send(part, zmq.NOBLOCK | more, copy=False, track=True)
                backlog.on_their_way.append((tracker, len(part)))
        backlog.replies.popleft()
        if backlog.connection is not None:
            backlog.connection.n_sent_bytes += sum(map(len, message))


def _send_buffer(endpoint: str) -> int:
    if endpoint.startswith("ipc:"):
        return _IPC_BUFFER
    return LOOPBACK_BUFFER if endpoint.startswith(("tcp://127.", "tcp://[::1]")) else -1
