"""The newest frames, for those who watch: references to replies that were sent; nothing is copied or decoded here."""

from __future__ import annotations

import hmac
import time
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from glrender import ProtocolError
from glrender_camera.validate import integer, known_keys

from . import codec, limits
from .envelope import ENVELOPE, echo

_KEYS = ("after", "of_client", "camera", "shared", "pass")


class _Frame(NamedTuple):
    """A reply to a `render` request, as it was sent, with the request's bytes."""

    number: int
    client: str
    cameras: tuple[str, ...]
    request: bytes
    reply: bytes
    pixels: Sequence[Any]
    place: Mapping[str, Any] | None

    @property
    def n_bytes(self) -> int:
        return len(self.request) + len(self.reply) + sum(map(len, self.pixels))


class Tap:
    """Keeps the newest frames, one for each client's camera, and answers `watch`.

    Parameters
    ----------
    password : str
        Who sends it as `pass` may watch; empty: everyone whom the server answers.
    """

    def __init__(self, password: str = ""):
        self._password, self._number = password, 0
        self._frames: OrderedDict[tuple[str, tuple[str, ...]], _Frame] = OrderedDict()
        self._allowance, self._counted = 0.0, -1e9

    def keep(self, client: str, cameras: Sequence[str], request: bytes, reply: Sequence[Any],
             place: Mapping[str, Any] | None) -> None:
        """Keep the reply to a `render` request in the place of the last one of this client and these cameras."""
        self._number += 1
        key = client, tuple(cameras)
        self._frames[key] = _Frame(self._number, *key, request, reply[0], reply[1:], place)
        self._frames.move_to_end(key)
        while len(self._frames) > 1 and (len(self._frames) > limits.MAX_WATCHED_FRAMES or sum(
                frame.n_bytes for frame in self._frames.values()) > limits.MAX_WATCHED_BYTES):
            self._frames.popitem(last=False)

    def drop(self) -> bool:
        """Keep the oldest frame no more; whether there was one."""
        return bool(self._frames) and bool(self._frames.popitem(last=False))

    def clear(self) -> None:
        """Keep no frame any more."""
        self._frames.clear()

    def may_watch(self, header: Mapping[str, Any]) -> bool:
        """Whether a request has the password."""
        given = header.get("pass", "")
        return isinstance(given, str) and hmac.compare_digest(given.encode(), self._password.encode())

    def answer(self, header: Mapping[str, Any], is_encrypted: bool, generation: int) -> list[Any] | None:
        """The reply to `watch`; None if so many bytes have gone over sockets that this one must wait.

        `generation` counts the scenes; all frames are of the newest.

        Raises
        ------
        ProtocolError, ConfigError
        """
        known_keys("", header, (*ENVELOPE, *_KEYS))
        for name, kind in (("of_client", str), ("camera", str), ("shared", bool)):
            if not isinstance(header.get(name, kind()), kind):
                raise ProtocolError(name, f"must be {'true or false' if kind is bool else 'a name'}", header[name])
        after = integer("after", header.get("after", 0), 0, 2**64 - 1)
        told = {**echo(header), "ok": True, "number": self._number, "generation": generation, "streams": [
            {"client": f.client, "cameras": list(f.cameras), "number": f.number} for f in self._frames.values()]}
        newest = next((frame for frame in reversed(self._frames.values())
                       if header.get("of_client", frame.client) == frame.client
                       and header.get("camera", "") in ("", *frame.cameras)), None)
        # A number that is ahead is of a server that was here before.
        if newest is None or newest.number <= after <= self._number:
            return codec.pack(told)
        told |= {"number": newest.number, "of_client": newest.client, "request": newest.request,
                 "reply": newest.reply}
        if header.get("shared") and newest.place is not None:
            return codec.pack({**told, "shared": newest.place})
        if not self._has_allowance(sum(map(len, newest.pixels)), is_encrypted):
            return None
        return [*codec.pack(told), *newest.pixels]

    def _has_allowance(self, n_bytes: int, is_encrypted: bool) -> bool:
        """Whether pixels may go over a socket now: what all watchers get so is bounded by the second."""
        now = time.monotonic()
        per_s = limits.WATCHED_BYTES_PER_S
        self._allowance = min(float(per_s), self._allowance + per_s * (now - self._counted))
        self._counted = now
        # A large one goes too, and the next waits for longer.
        if self._allowance <= 0.0:
            return False
        self._allowance -= n_bytes * (limits.CURVE_COST if is_encrypted else 1)
        return True
