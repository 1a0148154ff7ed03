"""The last reply to each client, kept for those that ask again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any, NamedTuple

from . import limits


class Kept(NamedTuple):
    """A reply, by its request's digest; the memory of its pixels is not used again while it is kept."""

    digest: bytes
    reply: list[Any]
    pixels: list[Any]
    n_bytes: int


class KeptReplies:
    """Keeps the newest, up to `limits.MAX_KEPT_REPLIES` and `limits.MAX_KEPT_BYTES`."""

    def __init__(self):
        self._kept: OrderedDict[str, Kept] = OrderedDict()
        self._n_bytes = 0

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, client: str) -> Kept | None:
        """The last reply to a client."""
        return self._kept.get(client)

    def keep(self, client: str, digest: bytes, reply: Sequence[Any], pixels: Sequence[Any]) -> None:
        """Keep a reply in the place of the client's last; `pixels` are its parts in shared memory, or sent."""
        self.forget(client)
        n_bytes = len(reply[0]) + sum(map(len, pixels))
        self._kept[client] = Kept(digest, list(reply), list(pixels), n_bytes)
        self._n_bytes += n_bytes
        while len(self) > 1 and (len(self) > limits.MAX_KEPT_REPLIES or self._n_bytes > limits.MAX_KEPT_BYTES):
            self.drop()

    def forget(self, client: str) -> None:
        """Keep nothing for a client any more."""
        if (kept := self._kept.pop(client, None)) is not None:
            self._n_bytes -= kept.n_bytes

    def drop(self) -> bool:
        """Keep the oldest no more; whether there was one."""
        if self._kept:
            self.forget(next(iter(self._kept)))
            return True
        return False

    def clear(self) -> None:
        """Keep nothing any more."""
        self._kept.clear()
        self._n_bytes = 0
