"""Requests and replies in one file, and their reproduction, byte for byte.

The file, of gzip, holds messages framed as on TCP (docs/protocol.md); the flags are 0 for a request and 1 for its
reply, which follows it.

    python -m glrender_client FILE [ENDPOINT]       sends the requests again and compares the replies
"""

from __future__ import annotations

import gzip
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import zmq

from .connection import MAX_POLL_MS, connected
from .curve import curve_keys
from .errors import GlrenderClientError, RequestTimeout
from .presence import told_presence

_PREFIX = struct.Struct("<4sHH")
_REQUEST, _REPLY = 0, 1
# Fastest of gzip's levels, in a thread of its own, and exchanges that may wait for it.
_LEVEL, _MOST_WAITING = 1, 8
# Fields that may differ between two drawings of one frame.
_OF_THE_MOMENT = ("timings_ms", "uptime_s", "requests", "errors", "clients", "waiting", "last_timings_ms", "workers",
                  "generation")


class Exchange(NamedTuple):
    """A request and its reply, as they went over the wire."""

    request: bytes
    reply: list[bytes]


class Difference(NamedTuple):
    """A reply that differs from the recorded one: the exchange's number from 0, the request's id, and what differs."""

    index: int  # type: ignore[assignment]
    id: int
    what: str


class Recorder:
    """Writes exchanges to a new file, in a thread of its own.

    Raises
    ------
    FileExistsError
    OSError
        Its folder is missing, or may not be written to.
    """

    def __init__(self, path: Path):
        try:
            self._file = gzip.open(path, "xb", compresslevel=_LEVEL)
        except FileExistsError:
            raise FileExistsError(f"record: {path} is there already, and no recording is written over; give the name "
                                  "of a new file, or move that one away") from None
        except OSError as error:
            raise type(error)(error.errno, f"record: {path} cannot be made: {error.strerror}; give a file in a folder "
                              "that is there and may be written to") from None
        self._thread, self._waiting = ThreadPoolExecutor(1), deque[Future]()

    def keep(self, request: bytes, reply: Sequence[Any]) -> None:
        """Append one exchange: soon, or once few others wait.

        Raises
        ------
        OSError
            An earlier one could not be written.
        """
        self._waiting.append(self._thread.submit(self._append, request, reply))
        while len(self._waiting) > _MOST_WAITING or self._waiting and self._waiting[0].done():
            self._waiting.popleft().result()

    def _append(self, request: bytes, reply: Sequence[Any]) -> None:
        _write(self._file, [request], _REQUEST)
        _write(self._file, reply, _REPLY)
        self._file.flush()  # who is killed leaves all but those that wait

    def close(self) -> None:
        """Write what waits, and end the file.

        Raises
        ------
        OSError
        """
        try:
            while self._waiting:
                self._waiting.popleft().result()
        finally:
            self._thread.shutdown()
            self._file.close()


def read_recording(path: Path) -> Iterator[Exchange]:
    """The exchanges of a file, one by one.

    Raises
    ------
    GlrenderClientError
        It is no recording, or ends within a message; what came before was yielded.
    """
    with gzip.open(path, "rb") as file:
        try:
            while (request := _read(file, _REQUEST, path)) is not None:
                reply = _read(file, _REPLY, path)
                if reply is None:
                    raise GlrenderClientError(f"{path} ends within a message")
                yield Exchange(request[0], reply)
        except (gzip.BadGzipFile, zlib.error):
            raise GlrenderClientError(f"{path} is no recording of requests and replies") from None
        except EOFError:
            raise GlrenderClientError(f"{path} has no end: who recorded it was killed, or still records") from None


def replay(path: Path, endpoint: str = "tcp://127.0.0.1:5555", *, timeout_s: float = 60.0,
           key: Path | None = None, server_key: Path | None = None) -> Iterator[Difference | None]:
    """Send the requests of a recording again, byte for byte, and compare the replies.

    Pixels must be the same bytes; headers the same but for timings, counts, and whether a shadow map was at hand.

    Yields
    ------
    Difference or None
        For each exchange.

    Raises
    ------
    RequestTimeout
    GlrenderClientError
        The recording cannot be read, or holds no exchange.
    """
    keys, context = curve_keys(key, server_key), zmq.Context()
    socket = connected(context, endpoint, keys)

    def ask(message: bytes) -> list[bytes]:
        socket.send(message)
        if not socket.poll(int(min(1e3 * timeout_s, MAX_POLL_MS))):
            raise RequestTimeout.after(endpoint, msgpack.unpackb(message)["op"], timeout_s, 1,
                                       told_presence(endpoint, keys))
        return socket.recv_multipart()

    index = -1
    try:
        for index, (request, recorded) in enumerate(read_recording(path)):
            try:
                header = msgpack.unpackb(request)
                sender, number = header["client"], header["id"]
            except (ValueError, KeyError, TypeError):
                raise GlrenderClientError(f"{path}, exchange {index}: holds no request of a client") from None
            # The server must draw anew, not answer from what it keeps of this client.
            ask(msgpack.packb({"v": 1, "op": "close", "id": 0, "client": sender}))
            what = _difference(recorded, ask(request))
            yield Difference(index, number, what) if what else None
        if index < 0:
            raise GlrenderClientError(f"{path} holds no exchange: nothing was recorded, and nothing can be compared")
    finally:
        socket.close()
        context.term()


def _difference(recorded: list[bytes], again: list[bytes]) -> str:
    before, after = _lasting(msgpack.unpackb(recorded[0])), _lasting(msgpack.unpackb(again[0]))
    if "shared" in before:
        return f"pixels of {before['arrays'][0]['name']} were left in shared memory, and not recorded"
    for name in {**before, **after}:
        if before.get(name) != after.get(name):
            return f"{name}: {before.get(name)!r}, now {after.get(name)!r}"
    for entry in before["arrays"]:
        if recorded[entry["part"]] != again[entry["part"]]:
            return f"pixels of {entry['name']}"
    return ""


def _lasting(header: dict[str, Any]) -> dict[str, Any]:
    kept = {name: value for name, value in header.items() if name not in _OF_THE_MOMENT}
    if "frames" in kept:
        kept["frames"] = [_lasting(frame) for frame in kept["frames"]]
    plan = kept.get("plan", {})
    plan.pop("milliseconds", None)
    for body in plan.get("bodies", []):
        body.pop("shadow_map_reused", None)
    return kept


def _write(file: gzip.GzipFile, parts: Sequence[Any], flags: int) -> None:
    sizes = [memoryview(part).nbytes for part in parts]
    file.write(_PREFIX.pack(b"GLR1", len(parts), flags) + struct.pack(f"<{len(parts)}I", *sizes))
    for part in parts:
        file.write(part)


def _read(file: gzip.GzipFile, flags: int, path: Path) -> list[bytes] | None:
    """The parts of the next message, or None at the end of the file."""
    prefix = file.read(_PREFIX.size)
    if not prefix:
        return None
    if len(prefix) < _PREFIX.size:
        raise GlrenderClientError(f"{path} ends within a message")
    magic, n_parts, found = _PREFIX.unpack(prefix)
    if magic != b"GLR1" or found != flags or not n_parts:
        raise GlrenderClientError(f"{path} is no recording of requests and replies")
    table = file.read(4 * n_parts)
    sizes = struct.unpack(f"<{len(table) // 4}I", table[:len(table) // 4 * 4])
    parts = [file.read(size) for size in sizes]
    if len(sizes) != n_parts or any(len(part) != size for part, size in zip(parts, sizes, strict=True)):
        raise GlrenderClientError(f"{path} ends within a message")
    return parts
