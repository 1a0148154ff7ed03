"""What the server's loop and its front ends say to each other."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple, Protocol

import zmq

LOOPBACK_BUFFER = 1 << 18
"""What the system may hold of a reply on loopback [bytes]: 4 MiB that are read while they are still in the cache take
half as long. A network's round trips want the system's own choice."""
Answer = Callable[[Sequence[Any]], None]
"""Sends the one reply of one request; called once, in the loop's thread."""


class Request(NamedTuple):
    """A message that came, where from, and the way back."""

    sender: Hashable
    parts: list[bytes]
    answer: Answer


class Front(Protocol):
    """A transport: sockets that live in the loop's thread and never block it."""

    endpoint: str

    def start(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop."""

    def take_in(self, ready: dict[Any, int]) -> list[Request]:
        """Requests that have come, after `poller.poll` said what is ready; sends what is due."""

    @property
    def is_idle(self) -> bool:
        """Whether everything answered is on its way."""

    def close(self) -> None:
        """Close every socket."""


class FairQueue:
    """A bounded queue that serves its senders in turn.

    Parameters
    ----------
    length : int
        Items that may wait, of all senders together.
    """

    def __init__(self, length: int):
        self._length, self._size = length, 0
        self._waiting: OrderedDict[Hashable, deque[Any]] = OrderedDict()

    def __len__(self) -> int:
        return self._size

    def put(self, sender: Hashable, item: Any) -> Any | None:
        """Add an item; the one that found no place, if the queue was full.

        That is the newest of whoever has most waiting: nobody keeps the others out.
        """
        refused = None
        if self._size >= self._length:
            greediest = max(self._waiting.values(), key=len)
            if len(greediest) <= len(self._waiting.get(sender, ())) + 1:
                return item
            refused = greediest.pop()
            self._size -= 1
        self._waiting.setdefault(sender, deque()).append(item)
        self._size += 1
        return refused

    def get(self) -> Any:
        """The oldest item of the sender who has waited longest for a turn."""
        sender, items = self._waiting.popitem(last=False)
        item = items.popleft()
        if items:
            self._waiting[sender] = items
        self._size -= 1
        return item
