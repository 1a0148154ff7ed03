"""The page over HTTP, on loopback, read-only: each reader asks for the next frame when it has drawn the last."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
import math
import os
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from .frame import finite
from .source import Source

log = logging.getLogger(__name__)

MAX_VIEWERS, MAX_CONNECTIONS, MAX_MESSAGE_BYTES = 32, 64, 4096
"""Pages at once, connections at once, and bytes of one message from a page."""
HTTP_S = 10.0
"""The longest life of a connection that has not become a page's conversation."""
BYTES_PER_S = 1 << 27
"""Pixels that all pages get in a second; each waits for its share."""
_LOWEST_PRIORITY = 19
_KINDS = {".html": "text/html; charset=utf-8", ".css": "text/css; charset=utf-8",
          ".js": "text/javascript; charset=utf-8", ".svg": "image/svg+xml"}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
                               "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Resource-Policy": "same-origin"}
# What JSON holds may be too deep, too large for an integer, of another kind, or missing: looked for while a question is
# read, not while it is answered.
_SENSELESS = (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError)
_READ: dict[str, Callable[[dict[str, Any]], tuple[Any, ...]]] = {
    "frame": lambda question: (int(question["after"]),),
    "status": lambda question: (),
    "pixel": lambda question: tuple(int(question[name]) for name in ("number", "x", "y")),
    "free": lambda question: (str(question["camera"]), str(question["body"]), *(
        _number(question[name]) for name in ("azimuth_deg", "elevation_deg", "range_m")))}
_NO_TOKEN = "This page needs its token: open the full address that glrender printed.\n"  # noqa: S105


def serve(listening: socket.socket, token: str, endpoint: str, keys: Iterable[str | Path] | None, password: str,
          ended: threading.Event) -> None:
    """Show a server's frames until `ended` is set.

    Parameters
    ----------
    listening : socket
        Bound to loopback; owned.
    token : str
        Whoever has it in the page's address may look.
    endpoint, keys, password
        Of the server, as of `Source`.
    ended : Event
    """
    _step_back()
    source = Source(endpoint, keys, password)
    config = uvicorn.Config(application(source, token), http=_BriefConnection, log_level="error",
                            access_log=False, lifespan="on", server_header=False, date_header=False,
                            limit_concurrency=MAX_CONNECTIONS, ws_max_size=MAX_MESSAGE_BYTES,
                            ws_per_message_deflate=False, timeout_graceful_shutdown=1)
    server = uvicorn.Server(config)
    # Signals are the caller's: the server ends its view, and Ctrl-C sets `ended`.
    server.capture_signals = contextlib.nullcontext

    def stop() -> None:
        ended.wait()
        server.should_exit = True

    threading.Thread(target=stop, daemon=True).start()
    server.run(sockets=[listening])


def _step_back() -> None:
    """Let renderer and clients go first wherever a core is wanted by both: this process then gets 1.5 % of its time."""
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, _LOWEST_PRIORITY)
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def application(source: Source, token: str) -> Starlette:
    """The page of a source, for whoever has the token."""
    pages = {entry.name: entry.read_bytes() for entry in files(__package__).joinpath("page").iterdir()
             if Path(entry.name).suffix in _KINDS}
    viewers: set[_Viewer] = set()

    def is_admitted(given: str | None) -> bool:
        return hmac.compare_digest((given or "").encode(), token.encode())

    async def page(request: Request) -> Response:
        if not is_admitted(request.query_params.get("token")):
            return PlainTextResponse(_NO_TOKEN, 403, _HEADERS)
        return Response(pages["index.html"], headers=_HEADERS, media_type=_KINDS[".html"])

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in pages or name == "index.html":
            return PlainTextResponse("no such file\n", 404, _HEADERS)
        return Response(pages[name], headers=_HEADERS, media_type=_KINDS[Path(name).suffix])

    async def stream(peer: WebSocket) -> None:
        origin = peer.headers.get("origin")
        if not is_admitted(peer.query_params.get("token")) or (
                origin is not None and origin != f"http://{peer.headers.get('host')}"):
            await peer.close(1008)
            return
        await peer.accept()
        if len(viewers) >= MAX_VIEWERS:
            await peer.close(1013, f"{MAX_VIEWERS} pages are open; close one")
            return
        viewer = _Viewer(peer, source, viewers)
        viewers.add(viewer)
        try:
            await viewer.serve()
        finally:
            viewers.discard(viewer)
            viewer.tell_what_is_wanted()

    @contextlib.asynccontextmanager
    async def life(app: Starlette) -> AsyncIterator[None]:
        source.start(asyncio.get_running_loop())
        yield
        source.close()

    # By another name, that somebody lets point here, no page in a browser reaches this one.
    hosts = Middleware(TrustedHostMiddleware, allowed_hosts=["127.0.0.1", "localhost"], www_redirect=False)
    return Starlette(routes=[Route("/", page), Route("/{name}", asset), WebSocketRoute("/stream", stream)],
                     middleware=[hosts], lifespan=life)


class _BriefConnection(H11Protocol):
    """An HTTP connection lasts some seconds, less where there are too many: no silent one keeps others out."""

    def connection_made(self, transport: asyncio.Transport) -> None:
        super().connection_made(transport)
        self._end = self.loop.call_later(HTTP_S, transport.abort)
        if len(self.connections) >= MAX_CONNECTIONS:
            brief = [each for each in self.connections if isinstance(each, _BriefConnection)]
            oldest = min(brief, key=lambda each: each._end.when())
            # At once: many connections may begin before the system reports the end of this one.
            self.connections.discard(oldest)
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._end.cancel()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        self._end.cancel()
        super().handle_websocket_upgrade(event)


def _number(value: Any) -> float:
    """A finite number of a question."""
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"must be finite, got {number}")
    return number


class _Viewer:
    """One page: of each kind of question the newest waits, and is answered when the page has room for the answer."""

    def __init__(self, peer: WebSocket, source: Source, viewers: set[_Viewer]):
        self._peer, self._source, self._viewers = peer, source, viewers
        self.stream: tuple[str, str] | None = None
        self._is_waiting = False
        self._questions: dict[str, dict[str, Any]] = {}
        self._asked = {kind: asyncio.Event() for kind in _READ}
        self._answers = {"frame": self._frame, "status": self._status, "pixel": self._pixel, "free": self._free}
        self._sending = asyncio.Lock()

    async def serve(self) -> None:
        """Answer until the page is closed, or breaks the rules of this conversation."""
        self.tell_what_is_wanted()
        answering = [asyncio.create_task(self._answer(kind)) for kind in self._asked]
        try:
            while (asked := await self._question()) is not None:
                kind, question, stream = asked
                self._questions[kind] = question
                self._asked[kind].set()
                if kind == "frame":
                    self.stream, self._is_waiting = stream, True
                    self.tell_what_is_wanted()
                    self._source.tell_news()
        finally:
            for task in answering:
                task.cancel()
            await asyncio.gather(*answering, return_exceptions=True)

    async def _question(self) -> tuple[str, dict[str, Any], tuple[str, str] | None] | None:
        """The next question's kind, itself and its stream; None at the end of the conversation."""
        try:
            text = await self._peer.receive_text()
        except WebSocketDisconnect:
            return None
        except KeyError:
            text = ""  # bytes came instead
        try:
            question = json.loads(text)
            kind, chosen = question["ask"], question.get("stream")
            _READ[kind]
            return kind, question, None if chosen is None else (str(chosen[0]), str(chosen[1]))
        except _SENSELESS:
            with contextlib.suppress(RuntimeError):
                await self._peer.close(1003, "this is no question of the page")
            return None

    def tell_what_is_wanted(self) -> None:
        """Let the source know what all pages wait for: a stopped one waits for nothing."""
        self._source.want(bool(self._viewers), {viewer.stream for viewer in self._viewers if viewer._is_waiting})

    async def _answer(self, kind: str) -> None:
        while True:
            await self._asked[kind].wait()
            self._asked[kind].clear()
            answer = await self._answered(kind, self._questions.pop(kind))
            if answer is None:
                continue  # a newer question waits
            async with self._sending:
                if isinstance(answer, bytes):
                    await self._peer.send_bytes(answer)
                else:
                    await self._peer.send_text(json.dumps(finite({"kind": kind, **answer})))
            if isinstance(answer, bytes):
                await asyncio.sleep(len(answer) * len(self._viewers) / BYTES_PER_S)

    async def _answered(self, kind: str, question: dict[str, Any]) -> dict[str, Any] | bytes | None:
        try:
            asked = _READ[kind](question)
        except _SENSELESS:
            return {"trouble": "this is no question of the page"}
        try:
            return await self._answers[kind](*asked)
        except Exception:
            log.exception("a question of a page failed")
            return {"trouble": "the view failed on this; its log has the traceback"}

    async def _frame(self, after: int) -> bytes | None:
        while (frame := self._source.newest(self.stream, after)) is None:
            await self._source.news()
            if self._asked["frame"].is_set():
                return None
        self._is_waiting = False
        self.tell_what_is_wanted()
        return frame.message

    async def _status(self) -> dict[str, Any]:
        source = self._source
        told = {name: value for name, value in source.status.items() if name not in ("v", "op", "id", "client", "ok",
                                                                                     "arrays")}
        return {"trouble": source.trouble, "not_shown": source.not_shown, "endpoint": source.endpoint, "status": told,
                "streams": source.streams, "seen": source.seen, "viewers": len(self._viewers)}

    async def _pixel(self, number: int, x: int, y: int) -> dict[str, Any]:
        frame = self._source.numbered(number) or self._source.newest(self.stream)
        if frame is None or not (0 <= x < frame.camera["width_px"] and 0 <= y < frame.camera["height_px"]):
            return {"trouble": "this pixel's frame is gone"}
        return {"number": frame.number, "x": x, "y": y, **await self._source.pixel(frame, x, y)}

    async def _free(self, camera: str, body: str, azimuth_deg: float, elevation_deg: float,
                    range_m: float) -> dict[str, Any] | bytes:
        drawn = await self._source.free(camera, body, azimuth_deg, elevation_deg, range_m,
                                        self._source.newest(self.stream))
        return {"trouble": drawn} if isinstance(drawn, str) else drawn.message
