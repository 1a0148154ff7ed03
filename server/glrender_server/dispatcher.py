"""Requests in, replies out: what the server does beside rendering, and nothing of sockets.

Every request gets one reply.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import glrender
import zmq
from glrender import GlrenderError
from glrender.engines.image import PRODUCTS
from glrender.engines.rays.laser_ranges import MAX_DIRECTIONS
from glrender_camera.validate import known_keys

from . import codec, operations
from .envelope import ENVELOPE, checked_envelope, echo, refusal
from .frame import MAX_ARRAYS, MAX_FRAME_BYTES, OUTPUTS
from .front import Answer, FairQueue, Request
from .job import Done, Job
from .metrics import Histogram, counter, escaped, gauge
from .warned import WarningLog

log = logging.getLogger(__name__)

OPERATIONS = ("hello", *operations.OPERATIONS, "status", "close")
QUEUE_LENGTH = 32
"""Requests that may wait for a renderer; the next is answered `busy`."""
# Replies kept for retries: the last of each client, together at most this large.
_MAX_KEPT_BYTES, _MAX_KEPT = 256 * 1024**2, 64


class Engine(Protocol):
    """Where requests are rendered: in this thread (`LocalEngine`) or in processes (`WorkerPool`)."""

    described: dict[str, Any]
    """Scene and OpenGL, as `hello` tells them."""
    outage: str
    """Why nothing can be rendered until further notice; empty if something can."""

    @property
    def has_room(self) -> bool:
        """Whether a job would be begun at once."""

    @property
    def is_idle(self) -> bool:
        """Whether no job is under way."""

    def start(self, job: Job) -> None:
        """Begin a job; `job.done` is called once, now or from a later `turn`."""

    def watch(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop, now and later."""

    def turn(self, ready: dict[Any, int]) -> None:
        """Take in what is finished; replace what has died or taken too long."""


class Dispatcher:
    """Answers what it can itself, and lets an engine render the rest, the senders in turn.

    Parameters
    ----------
    engine : Engine

    Attributes
    ----------
    is_ending : bool
        Whether the server is about to close, its shared memory with it.
    """

    def __init__(self, engine: Engine):
        self._engine = engine
        self.is_ending = False
        self._queue = FairQueue(QUEUE_LENGTH)
        self._started = time.monotonic()
        self.requests: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()
        self._kept: OrderedDict[str, tuple[bytes, list, list]] = OrderedDict()
        self._under_way: dict[bytes, list[Answer]] = {}
        self._last_timings_ms: dict[str, float] = {}
        self._durations = Histogram("glrender_request_seconds", "op")
        self._stages = Histogram("glrender_stage_seconds", "stage")
        self._warned = WarningLog()
        self._warned.scene(engine.described.get("warnings", ()))

    def close(self) -> None:
        """Keep no reply any more: the engine's memory is free then."""
        self._kept.clear()

    def metrics(self) -> Iterable[str]:
        """Lines for a Prometheus; may be called from another thread."""
        described = self._engine.described
        yield from counter("glrender_requests_total", "op", dict(self.requests))
        yield from counter("glrender_errors_total", "code", dict(self.errors))
        yield from gauge("glrender_uptime_seconds", time.monotonic() - self._started)
        yield from gauge("glrender_waiting_requests", len(self._queue))
        if "workers" in described:
            yield from gauge("glrender_workers_ready", described["workers"]["ready"])
            yield from gauge("glrender_worker_restarts_total", described["workers"]["restarts"], "counter")
        yield f'glrender_info{{gl_renderer="{escaped(described["gl_renderer"])}"}} 1'
        yield from self._durations.lines()
        yield from self._stages.lines()

    @property
    def is_idle(self) -> bool:
        """Whether every request has been answered."""
        return not self._queue and self._engine.is_idle

    @property
    def can_work(self) -> bool:
        """Whether `work` would begin something at once."""
        return bool(self._queue) and (self._engine.has_room or bool(self._engine.outage))

    def submit(self, request: Request, is_closing: bool = False) -> None:
        """Take a request; it is answered now, or later from `work`. Raises nothing."""
        header: dict[str, Any] = {}
        try:
            header = codec.unpack_request(request.parts)
            client = checked_envelope(header, OPERATIONS)
            digest = hashlib.sha256(request.parts[0]).digest()
            kept = self._kept.get(client)
            if kept is not None and kept[0] == digest:
                request.answer(kept[1])
            elif digest in self._under_way:
                # A retry of what is being drawn: both get the one reply.
                self._under_way[digest].append(request.answer)
            elif is_closing:
                self._refuse(request, header, "closing", "", "the server is shutting down")
            elif header["op"] not in operations.OPERATIONS:
                self.requests[header["op"]] += 1
                request.answer(getattr(self, f"_{header['op']}")(header))
            else:
                self._enqueue(header, digest, request)
        except GlrenderError as error:
            self._refuse(request, header, error.code, getattr(error, "path", ""), str(error))
        except Exception:
            log.exception("request %s failed", header.get("op"))
            self._refuse(request, header, "internal", "", "the server failed on this request; its log has the "
                                                          "traceback")

    def _enqueue(self, header: dict[str, Any], digest: bytes, request: Request) -> None:
        self._under_way[digest] = [request.answer]
        refused = self._queue.put(request.sender, (header, digest, request, time.monotonic()))
        if refused is None or refused[1] != digest:
            self.requests[header["op"]] += 1
        if refused is not None:
            header, digest, _, _ = refused
            self.errors["busy"] += 1
            reply = refusal(header, "busy", "", f"{len(self._queue)} requests are waiting; try again")
            for answer in self._under_way.pop(digest):
                answer(reply)

    def work(self) -> None:
        """Begin the next job, if the engine has room for it."""
        if not self._queue:
            return
        if not (self._engine.has_room or self._engine.outage):
            return
        header, digest, request, came = self._queue.get()
        finish = partial(self._finish, header, digest, came)
        if self._engine.has_room:
            self._engine.start(Job(header, request.parts[0], finish))
        else:
            finish(Done(refusal(header, "device", "", self._engine.outage), "device", {}))

    def _finish(self, header: Mapping[str, Any], digest: bytes, began: float, done: Done) -> None:
        seconds = time.monotonic() - began
        self._durations.observe(header["op"], seconds)
        for stage, milliseconds in done.timings_ms.items():
            self._stages.observe(stage, 1e-3 * milliseconds)
        log.debug("request", extra={"op": header["op"], "client": header["client"], "id": header["id"],
                                    "code": done.code, "ms": 1e3 * seconds,
                                    "render_ms": done.timings_ms.get("total", 0.0)})
        reply = done.reply
        if done.code:
            self.errors[done.code] += 1
        else:
            # Shared memory ends with the server: what a client would come for too late goes over the socket.
            if header.get("shared") and done.place is not None and not self.is_ending:
                reply = [codec.with_field(reply[0], "shared", done.place)]
            self._keep(header["client"], digest, reply, done.reply[1:])
            self._warned.frames(header["client"], done.warnings, time.monotonic())
            if header["op"] == "load_scene":
                self._warned.scene(self._engine.described.get("warnings", ()))
        self._last_timings_ms = done.timings_ms or self._last_timings_ms
        for answer in self._under_way.pop(digest):
            answer(reply)

    def _refuse(self, request: Request, header: Mapping[str, Any], code: str, path: str, message: str) -> None:
        self.errors[code] += 1
        request.answer(refusal(header, code, path, message))

    def _keep(self, client: str, digest: bytes, reply: Sequence[Any], pixels: Sequence[Any]) -> None:
        """Keep a reply for retries; its pixels' memory is not used again while it is kept."""
        self._kept[client] = (digest, list(reply), list(pixels))
        self._kept.move_to_end(client)
        size = lambda: sum(len(part) for _, _, pixels in self._kept.values() for part in pixels)  # noqa: E731
        while len(self._kept) > 1 and (len(self._kept) > _MAX_KEPT or size() > _MAX_KEPT_BYTES):
            self._kept.popitem(last=False)

    # Operations that need no renderer.

    def _hello(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, ENVELOPE)
        return codec.pack({
            **echo(header), "ok": True, "protocol": [codec.VERSION], "server": f"glrender {glrender.__version__}",
            "operations": list(OPERATIONS), "outputs": list(OUTPUTS), "products": list(PRODUCTS),
            **self._engine.described,
            "limits": {"max_header_bytes": codec.MAX_HEADER_BYTES, "max_image_pixels": operations.MAX_IMAGE_PIXELS,
                       "max_frame_bytes": MAX_FRAME_BYTES, "max_arrays": MAX_ARRAYS,
                       "max_directions": MAX_DIRECTIONS}})

    def _status(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, ENVELOPE)
        return codec.pack({
            **echo(header), "ok": True, "uptime_s": time.monotonic() - self._started,
            "requests": dict(self.requests), "errors": dict(self.errors), "clients": len(self._kept),
            "waiting": len(self._queue), "last_timings_ms": self._last_timings_ms, **self._engine.described})

    def _close(self, header: Mapping[str, Any]) -> list[Any]:
        """The client says goodbye: nothing is kept for it any more. The server runs on."""
        known_keys("", header, ENVELOPE)
        self._kept.pop(header["client"], None)
        return codec.pack({**echo(header), "ok": True})
