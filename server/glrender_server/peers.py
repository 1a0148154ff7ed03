"""ZeroMQ's connections, as the system counts them: who takes too much of what all share is hung up on.

ZeroMQ ends no connection for an application, bounds neither their number nor the parts of one message, and names none:
the descriptor that a message carries (ZMQ_SRCFD) may be another file's when it is read. So the descriptor of a message
serves to credit a peer alone, where an error costs nobody a connection. Whoever is hung up on is held by a duplicate,
is a connection to our port by its own word, and has taken what the system has counted of this very socket.
"""

from __future__ import annotations

import contextlib
import fcntl
import ipaddress
import logging
import os
import resource
import socket
import stat
import struct
import termios
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import zmq

from . import limits

log = logging.getLogger(__name__)

# A client sends some hundred megabytes a second on loopback; a look at a connection takes 5 us, at another file 2.
_PATROL_S, _PATROL_S_PER_DESCRIPTOR = 0.05, 6e-4
# Without a descriptor to list descriptors with, all numbers are tried, 1 us each.
_NEXT_LOOK_S = 0.5
# Bytes of ZMTP around one part, with CURVE, at most.
_PART_OVERHEAD_BYTES = 80
# Heartbeats of ZMTP bring no message: 30 bytes each, mostly one a second.
_HEARTBEAT_BYTES_PER_S = 1024
# Places of tcpi_bytes_acked and tcpi_bytes_received (u64) in struct tcp_info, since Linux 4.1 (linux/tcp.h).
_TCP_INFO_ACKED, _TCP_INFO_RECEIVED = 120, 128
_DESCRIPTORS = "/proc/self/fd"
# Process, user and group of whoever connected: unix(7), struct ucred.
_UCRED_BYTES = 12


@dataclass(eq=False)
class Peer:
    """A socket of ZeroMQ's, by its descriptor here; the inode identifies the socket if the descriptor is used anew."""

    descriptor: int
    inode: int
    count: Callable[[Peer], None]
    since: float = field(default_factory=time.monotonic)
    heard: float = field(default_factory=time.monotonic)
    has_asked: bool = False
    n_owed: int = 0
    n_read_bytes: int = 0
    n_received_bytes: int = 0
    n_marked_bytes: int = 0
    n_queued_bytes: int = 0
    n_acknowledged_bytes: int = 0
    account: Hashable = None
    """Whose it is, where the system says: another machine's address, or a process of this one over a Unix socket."""
    moved: float = field(default_factory=time.monotonic)

    @property
    def is_there(self) -> bool:
        """Whether the descriptor is this socket's."""
        try:
            return os.fstat(self.descriptor).st_ino == self.inode
        except OSError:
            return False

    @property
    def unfinished_bytes(self) -> int:
        """Bytes that ZeroMQ had read at the last look without a message for them; whole messages may wait."""
        # The overhead of parts is estimated high, and gives no credit.
        self.n_read_bytes = min(self.n_read_bytes, self.n_received_bytes)
        return self.n_received_bytes - self.n_read_bytes

    @property
    def settled_bytes(self) -> int:
        """Bytes of a message that it has not ended, where all that was whole at the mark has been read since."""
        return max(self.n_marked_bytes - self.n_read_bytes, 0)

    def queued_bytes(self) -> int:
        """Bytes of replies that the system has for it now, and that its own has not taken."""
        self.count(self)
        return self.n_queued_bytes

    def heard_of(self, n_parts: int, n_bytes: int) -> None:
        """Credit it with a message."""
        self.heard, self.has_asked = time.monotonic(), True
        self.n_read_bytes += n_bytes + _PART_OVERHEAD_BYTES * n_parts


class Peers:
    """The connections of one ROUTER.

    Parameters
    ----------
    endpoint : str
        That the ROUTER is bound to.
    max_connections : int
        Beyond them those that have been silent longest, and are owed nothing, are closed.
    max_part_bytes, n_waiting : int
        ZeroMQ's bounds for the parts of a message, and for the whole messages of a connection that wait to be read.
    """

    def __init__(self, endpoint: str, max_connections: int, max_part_bytes: int, n_waiting: int):
        self._address = endpoint.partition("://")[2]
        self._port = int(endpoint.rpartition(":")[2]) if endpoint.startswith("tcp:") else None
        # With the family given, Python need not ask the system for it each time.
        self._family = (socket.AF_UNIX if self._port is None else socket.AF_INET6 if "[" in self._address
                        else socket.AF_INET)
        self._max_connections, self._looked, self._n_found = max_connections, time.monotonic(), 0
        # Bounds for whole messages that wait, one that comes and one that is passed on.
        self._max_part_bytes, self._n_waiting = max_part_bytes, n_waiting + 2
        self._n_messages, self._n_to_settle = 0, 0
        # By descriptor, with the inode; None for a descriptor that is no connection of the ROUTER.
        self._seen: dict[int, tuple[int, Peer | None]] = {}
        # Every duplicate has this one's descriptor, and gives way to the next: none is left open, and none wants a free
        # descriptor.
        self._twin, self._null = socket.socket(self._family), os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)

    def __len__(self) -> int:
        """Connections at the last patrol."""
        return self._n_found

    def of(self, frame: zmq.Frame) -> Peer | None:
        """The connection that has the descriptor of a message's frame now: mostly, its sender's."""
        try:
            return self._peer(frame.get(zmq.SRCFD))
        except zmq.ZMQError:
            return None

    def has_read_message(self) -> None:
        """Count a message: ZeroMQ gives each connection's in turn."""
        self._n_messages += 1

    def has_read_all(self) -> None:
        """Note that no whole message waits."""
        self._n_messages = max(self._n_messages, self._n_to_settle)

    def patrol(self) -> None:
        """Look at all connections, every so often, and hang up on those that take too much."""
        now = time.monotonic()
        if now - self._looked < _PATROL_S + _PATROL_S_PER_DESCRIPTOR * len(self._seen):
            return
        n_heartbeat_bytes, self._looked = int(_HEARTBEAT_BYTES_PER_S * (now - self._looked)), now
        peers = self._all()
        for peer in peers:
            self._count(peer)
            peer.n_read_bytes += n_heartbeat_bytes
        self._let_go()
        self._end_unfinished(peers)
        if (n_too_many := len(peers) - self._max_connections) > 0:
            silent = sorted((peer for peer in peers if not peer.n_owed), key=lambda peer: (peer.has_asked, peer.heard))
            # Where all are at work the newest go: they have had the time to ask how the server does.
            newest = sorted(peers, key=lambda peer: -peer.since)
            for peer in (silent or newest)[:n_too_many]:
                log.warning("%d connections are open: the one that was silent longest is closed", len(peers))
                self.hang_up(peer)

    def _end_unfinished(self, peers: list[Peer]) -> None:
        """Hang up on those of whose bytes ZeroMQ holds more than whole messages can be.

        Bytes held at the mark are no whole message once none was left to read, or each connection had its turns.
        """
        unfinished = {peer: peer.unfinished_bytes for peer in peers}
        if has_settled := self._n_messages >= self._n_to_settle:
            settled = {peer: peer.settled_bytes for peer in peers}
            for peer in peers:
                peer.n_marked_bytes = peer.n_received_bytes
            self._n_to_settle = self._n_messages + self._n_waiting * (len(peers) + 1)
        else:
            settled = dict.fromkeys(peers, 0)
        total = sum(settled.values())
        for peer in sorted(peers, key=settled.get, reverse=True):
            # One part of a message that comes is nobody's fault.
            is_too_much = has_settled and settled[peer] > 2 * self._max_part_bytes and (
                settled[peer] > limits.MAX_UNFINISHED_BYTES or total > limits.MAX_UNFINISHED_BYTES_IN_ALL)
            if is_too_much or unfinished[peer] > self._n_waiting * self._max_part_bytes:
                log.warning("a client sent %d bytes of messages that it did not end: closed", unfinished[peer])
                self.hang_up(peer)
                total -= settled[peer]

    def hang_up_if_sent(self, peer: Peer, n_bytes: int) -> None:
        """End a connection that has sent so many bytes of which no message has come: who has its name now has not."""
        self._count_now(peer)
        if peer.unfinished_bytes >= n_bytes:
            log.warning("a client sent a message of many parts: closed")
            self.hang_up(peer)

    def hang_up(self, peer: Peer) -> None:
        """End a connection, if it is still there: ZeroMQ forgets all its bytes."""
        with contextlib.suppress(OSError):
            twin = self._held(peer)
            # A peer that writes into a full window would not hear of the end for a minute: ZeroMQ's close resets.
            twin.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            twin.shutdown(socket.SHUT_RDWR)
        self._let_go()
        self._seen.pop(peer.descriptor, None)

    def close(self) -> None:
        """Close what this keeps open."""
        self._twin.close()
        if self._null >= 0:
            os.close(self._null)
        self._null = -1

    def _all(self) -> list[Peer]:
        """The connections that are there now."""
        try:
            descriptors = list(map(int, os.listdir(_DESCRIPTORS)))
        except OSError:  # the list itself takes a descriptor
            self._looked += _NEXT_LOOK_S
            descriptors = range(resource.getrlimit(resource.RLIMIT_NOFILE)[0]) if os.path.isdir(_DESCRIPTORS) else []
        peers = [peer for peer in map(self._peer, descriptors) if peer is not None]
        self._n_found = len(peers)
        self._seen = {each: self._seen[each] for each in descriptors if each in self._seen}
        return peers

    def _peer(self, descriptor: int) -> Peer | None:
        """The connection of the ROUTER that a descriptor is now."""
        try:
            status = os.fstat(descriptor)
        except OSError:
            self._seen.pop(descriptor, None)
            return None
        inode, peer = self._seen.get(descriptor, (-1, None))
        if inode != status.st_ino:
            peer = Peer(descriptor, status.st_ino, self._count_now) if stat.S_ISSOCK(status.st_mode) else None
            if peer is not None and not self._is_ours(peer):
                peer = None
            self._seen[descriptor] = status.st_ino, peer
        return peer

    def _is_ours(self, peer: Peer) -> bool:
        """Whether a socket is a connection to the ROUTER's port."""
        try:
            twin = self._held(peer)
            ours = twin.getsockname()
            theirs = twin.getpeername()  # a listener has none
            if not isinstance(ours, tuple):
                if ours == self._address and hasattr(socket, "SO_PEERCRED"):
                    credentials = twin.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED_BYTES)
                    # A process that this one's namespace does not show has the number 0, as all such have.
                    peer.account = credentials if struct.unpack_from("i", credentials)[0] else None
                return ours == self._address
            # Other families say numbers, or addresses that are none of a network.
            if ours[1] != self._port or not isinstance(theirs[0], str):
                return False
            if not ipaddress.ip_address(theirs[0].partition("%")[0]).is_loopback:
                peer.account = theirs[0]
            return True
        except (OSError, ValueError):
            return False
        finally:
            self._let_go()

    def _count(self, peer: Peer) -> None:
        """Take the system's counts; of a Unix socket, to which only our own user comes, it has fewer."""
        peer.n_queued_bytes, before = 0, (peer.n_queued_bytes, peer.n_acknowledged_bytes)
        with contextlib.suppress(OSError):
            twin = self._held(peer)
            if self._port is not None:
                told = twin.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_RECEIVED + 8)
                if len(told) == _TCP_INFO_RECEIVED + 8:
                    peer.n_acknowledged_bytes, received = struct.unpack_from("QQ", told, _TCP_INFO_ACKED)
                    # Bytes that the system still holds may be whole messages; the system bounds them.
                    peer.n_received_bytes = received - _n_bytes(twin, termios.FIONREAD)
            peer.n_queued_bytes = _n_bytes(twin, termios.TIOCOUTQ)
            if before != (peer.n_queued_bytes, peer.n_acknowledged_bytes):
                peer.moved = time.monotonic()

    def _count_now(self, peer: Peer) -> None:
        self._count(peer)
        self._let_go()

    def _held(self, peer: Peer) -> socket.socket:
        """A peer's very socket, whatever becomes of its descriptor, until another is held or `_let_go`.

        Raises
        ------
        OSError
            The descriptor is another file's by now, or nobody's.
        """
        os.dup2(peer.descriptor, self._twin.fileno(), inheritable=False)
        if os.fstat(self._twin.fileno()).st_ino != peer.inode:
            raise ConnectionResetError("the connection has gone")
        return self._twin

    def _let_go(self) -> None:
        os.dup2(self._null, self._twin.fileno(), inheritable=False)


def _n_bytes(connection: socket.socket, which: int) -> int:
    """Bytes that the system holds of a connection, one way."""
    return struct.unpack("i", fcntl.ioctl(connection.fileno(), which, bytes(4)))[0]
