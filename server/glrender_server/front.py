"""Terms between the server's loop and its front ends, and the queue in which requests wait."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import zmq

LOOPBACK_BUFFER = 1 << 18
"""What the system may hold of a reply on loopback [bytes]: 4 MiB that are read while they are still in the cache take
half as long. A network's round trips want the system's own choice."""
Answer = Callable[[Sequence[Any]], None]
"""Sends the one reply of one request; called once, in the loop's thread."""


class Request(NamedTuple):
    """A message that came, from whom, and the way back."""

    sender: Hashable
    """Who takes turns: the client's CURVE key, another machine's address, or the connection."""
    parts: list[bytes]
    answer: Answer
    untaken_bytes: Callable[[], int] = lambda: 0
    """Bytes of replies that the connection has not taken."""
    user: str = ""
    """Name of the client's key file, without CURVE empty."""
    account: Hashable = None
    """Who is known by the time of their frames, where that is more than the sender: all of a machine, or a process."""
    is_spare: bool = False
    """Whether all places are taken, and it came by one that is kept for operators."""
    is_there: Callable[[], bool] = lambda: True
    """Whether the connection is still there, as far as the transport knows."""


class Front(Protocol):
    """A transport: sockets that live in the loop's thread and never block it."""

    endpoint: str

    @property
    def untaken_bytes(self) -> int:
        """Bytes of replies that all connections have not taken."""

    def start(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop."""

    @property
    def has_more(self) -> bool:
        """Whether `take_in` would give a request at once."""

    def take_in(self, ready: dict[Any, int]) -> Iterable[Request]:
        """Requests that have come, after `poller.poll` named the ready sockets; sends the replies that are due."""

    @property
    def is_idle(self) -> bool:
        """Whether everything answered is on its way."""

    def stop_listening(self) -> None:
        """Let no further connection come, where the transport can; those that are there are served on."""

    def close(self, linger_s: float = 0.0) -> None:
        """Close every socket, waiting at most `linger_s` for messages on their way; may be called again."""


class FairQueue:
    """A bounded queue that serves its senders in turn.

    Parameters
    ----------
    length : int
        Items that may wait, of all senders together.
    n_bytes : int
        Their bytes together.
    """

    def __init__(self, length: int, n_bytes: int):
        self._length, self._max_bytes = length, n_bytes
        self._size = self.n_bytes = 0
        self._waiting: OrderedDict[Hashable, deque[tuple[Any, int]]] = OrderedDict()

    def __len__(self) -> int:
        return self._size

    def put(self, sender: Hashable, item: Any, n_bytes: int = 0) -> list[Any]:
        """Add an item; those that found no place, if the queue was full.

        They are the newest of whoever has most waiting: nobody keeps the others out.
        """
        refused = []
        while self._size >= self._length or self.n_bytes + n_bytes > self._max_bytes:
            # By that of which there is too much.
            amount, more = (len, 1) if self._size >= self._length else (_bytes_of, n_bytes)
            greediest = max(self._waiting.values(), key=amount, default=())
            if amount(greediest) <= amount(self._waiting.get(sender, ())) + more:
                return [*refused, item]
            refused.append(self._removed(greediest.pop()))
        self._waiting.setdefault(sender, deque()).append((item, n_bytes))
        self._size += 1
        self.n_bytes += n_bytes
        return refused

    def get(self, is_free: Callable[[Any], bool] = lambda item: True) -> Any | None:
        """The oldest item of the sender who has waited longest for a turn, among those whose oldest `is_free`."""
        sender = next((sender for sender, items in self._waiting.items() if is_free(items[0][0])), None)
        if sender is None:
            return None
        items = self._waiting.pop(sender)
        item = self._removed(items.popleft())
        if items:
            self._waiting[sender] = items
        return item

    def _removed(self, entry: tuple[Any, int]) -> Any:
        item, n_bytes = entry
        self._size -= 1
        self.n_bytes -= n_bytes
        return item


def _bytes_of(items: Iterable[tuple[Any, int]]) -> int:
    return sum(n_bytes for _, n_bytes in items)
