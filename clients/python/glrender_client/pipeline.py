"""Several requests in flight, replies in the order of the requests."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

from .errors import Busy
from .wire import Reply, read_reply

MAX_IN_FLIGHT = 16


def in_order(client: Any, packed: Iterator[tuple[int, bytes]], in_flight: int) -> Iterator[Reply]:
    """Replies to packed requests of a `Client`; see its `render_many`."""
    if not 1 <= in_flight <= MAX_IN_FLIGHT:
        raise ValueError(f"in_flight must be 1 to {MAX_IN_FLIGHT}, got {in_flight!r}")
    return _replies(client, packed, in_flight)


def _replies(client: Any, packed: Iterator[tuple[int, bytes]], in_flight: int) -> Iterator[Reply]:
    waiting: OrderedDict[int, bytes] = OrderedDict()
    come: dict[int, tuple[dict[str, Any], list[Any]]] = {}
    tries, n_busy, deadline, refusal = 0, 0, 0.0, None
    while True:
        while len(waiting) < in_flight and (request := next(packed, None)) is not None:
            waiting[request[0]] = request[1]
            client._send(request[1])
        if not waiting:
            return
        number, message = next(iter(waiting.items()))
        deadline = deadline or time.monotonic() + client._timeout_s
        if number in come:
            header, parts = come.pop(number)
            del waiting[number]
            client._keep(message, parts)
            tries, deadline = 0, 0.0
            yield read_reply(header, parts)
            continue
        found = client._receive(deadline)
        if found is None:
            tries, deadline = tries + 1, 0.0
            client._disconnect()
            if refusal is not None:
                read_reply(refusal, [])  # raises: it was busy for all of the time
            if tries > client._retries:
                raise client._timeout("render", client._timeout_s)
            for number, message in waiting.items():
                if number not in come:
                    client._send(message)
        elif found[0].get("id") in waiting:
            header = found[0]
            if not header.get("ok") and header["error"]["code"] == "busy":
                # Others fill the server's queue: the same request again, in a while.
                told_s = header["error"].get("retry_after_s", 0.05)
                pause_s = Busy("busy", "", "", told_s).pause_s(n_busy)
                time.sleep(min(pause_s, max(0.0, deadline - time.monotonic())))
                n_busy, refusal = n_busy + 1, header
                client._send(waiting[header["id"]])
            else:
                n_busy, refusal = 0, None
                come[header["id"]] = found
