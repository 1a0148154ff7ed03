"""An asyncio client of the glrender service: any number of requests in flight over one connection."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import zmq
import zmq.asyncio

from .connection import connected, positive_s
from .curve import curve_keys
from .errors import Busy, GlrenderClientError, Patience, RequestTimeout
from .owner import Owner
from .presence import told_presence
from .wire import HasDict, Packer, Reply, frames_fields, range_fields, read_header, read_reply, render_fields


class AsyncClient:
    """A `Client` for one event loop, in its thread and process. ::

        async with AsyncClient("tcp://127.0.0.1:5555") as client:
            replies = await asyncio.gather(*(client.render(state, "navcam", seed=k, output="dn") for k in range(8)))

    Parameters
    ----------
    endpoint, timeout_s, retries, key, server_key
        As of `Client`; a retry sends the same bytes again over the same connection, which ZeroMQ makes anew.
    """

    def __init__(self, endpoint: str = "tcp://127.0.0.1:5555", *, timeout_s: float = 10.0, retries: int = 2,
                 key: Path | None = None, server_key: Path | None = None):
        if retries < 0:
            raise ValueError(f"retries must be >= 0, got {retries!r}")
        self._endpoint, self._timeout_s, self._retries = endpoint, positive_s(timeout_s), retries
        self._keys, self._pack = curve_keys(key, server_key), Packer()
        self._owner = Owner()
        self._context: zmq.asyncio.Context | None = None
        self._waiting: dict[int, asyncio.Future[Reply]] = {}

    async def __aenter__(self) -> AsyncClient:
        self._owner.check()
        context = zmq.asyncio.Context()
        self._socket = connected(context, self._endpoint, self._keys)
        self._context = context
        self._reader = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *exception) -> None:
        if not self._owner.is_here:
            return
        self._reader.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._reader
        for future in self._waiting.values():
            future.cancel()
        await self._socket.send(self._pack("close", {})[1])
        self._socket.close(linger=200)
        self._context.term()
        self._context = None

    async def hello(self) -> dict[str, Any]:
        """Description of the server, as of `Client.hello`."""
        return (await self._ask("hello", {})).header

    async def status(self) -> dict[str, Any]:
        """Counters of the server, as of `Client.status`."""
        return (await self._ask("status", {})).header

    async def load_scene(self, scene: Mapping[str, Any], *, timeout_s: float | None = None) -> dict[str, Any]:
        """Replace the server's scene, for every client; as `Client.load_scene`."""
        loaded = (await self._ask("load_scene", {"scene": dict(scene)}, timeout_s)).header
        self._pack.scene = loaded.get("scene")
        return loaded

    async def render(self, state: Mapping[str, Any] | HasDict, camera: str | None = None, **options: Any) -> Reply:
        """Ask for one frame; arguments and errors are those of `Client.render`."""
        return await self._ask("render", render_fields(state, camera, **options))

    async def render_frames(self, state: Mapping[str, Any] | HasDict, frames: Iterable[Mapping[str, Any]], *,
                            order: str = "C", backend: str | None = None) -> tuple[Reply, ...]:
        """Several frames of one state; as `Client.render_frames`."""
        return (await self._ask("render", frames_fields(state, frames, order, backend))).frames

    async def range(self, state: Mapping[str, Any] | HasDict, directions_camera: Any, camera: str | None = None, *,
                    noise: Mapping[str, Any] | None = None) -> Reply:
        """Laser ranges; as `Client.range`."""
        return await self._ask("range", range_fields(state, directions_camera, camera, noise))

    async def _ask(self, op: str, fields: Mapping[str, Any], timeout_s: float | None = None) -> Reply:
        timeout_s = self._timeout_s if timeout_s is None else positive_s(timeout_s)
        if self._context is None:
            raise GlrenderClientError("use this client inside `async with`")
        self._owner.check()
        number, message = self._pack(op, fields)
        for _ in range(self._retries + 1):
            found = await self._try_while_busy(message, number, timeout_s)
            if found is not None:
                return found
        presence = await asyncio.to_thread(told_presence, self._endpoint, self._keys)
        raise RequestTimeout.after(self._endpoint, op, timeout_s, self._retries + 1, presence)

    async def _try_while_busy(self, message: bytes, number: int, timeout_s: float) -> Reply | None:
        """Try a request once; a busy server is asked again later, until the time is over."""
        patience = Patience(timeout_s)
        while True:
            try:
                found = await self._try_once(message, number, patience.left_s)
            except Busy as error:
                await asyncio.sleep(patience.pause_s(error))
            else:
                if found is None:
                    patience.check()
                return found

    async def _try_once(self, message: bytes, number: int, timeout_s: float) -> Reply | None:
        future: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._waiting[number] = future
        try:
            await self._socket.send(message)
            done, _ = await asyncio.wait([future], timeout=max(0.0, timeout_s))
            return future.result() if done else None
        finally:
            del self._waiting[number]
            if not future.cancel() and not future.cancelled():
                future.exception()  # of a request given up when its answer was there: nobody else asks

    async def _read(self) -> None:
        while True:
            parts = [frame.buffer for frame in await self._socket.recv_multipart(copy=False)]
            header = read_header(parts[0])
            future = self._waiting.get(header.get("id"))
            if future is None or future.done():
                continue  # the late reply to a request given up, or the second to one sent twice
            try:
                future.set_result(read_reply(header, parts))
            except GlrenderClientError as error:
                future.set_exception(error)
