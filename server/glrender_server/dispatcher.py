"""Requests in, replies out: the server's work apart from rendering and sockets.

Every request gets one reply.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import glrender
import zmq
from glrender import GlrenderError
from glrender.base.names import MAX_DIRECTIONS, OUTPUTS, PRODUCTS
from glrender_camera.validate import known_keys

from . import codec, limits
from .background import Background
from .envelope import ENVELOPE, checked_envelope, echo, refusal
from .front import Answer, FairQueue, Front, Request
from .job import DRAWN, QUICK_S, Done, Job
from .kept import KeptReplies
from .metrics import Histogram, Recent, counter, escaped, gauge
from .tap import Tap
from .warned import WarningLog

log = logging.getLogger(__name__)

OPERATIONS = ("hello", *DRAWN, "status", "watch", "close")
# A client that gets `busy` asks again after the time that the waiting requests take, within these bounds [s].
_MIN_RETRY_S, _MAX_RETRY_S = 0.05, 5.0
_ALL_AT_WORK = "all connections are open and at work; close one"
_UNTAKEN = "this client has not taken its replies; read them first"
_WATCHED_S = 0.1
# The most senders whose speed is remembered: more than may be connected; those who went are forgotten first.
_MAX_SENDERS = 1024
# Who has had a slow frame is known to be quick again by a quick one that ends so long after it [s], or later.
_SLOW_FOR_S = 5.0
# After so many new senders in a row whose first request was quick, the next is believed to be.
_N_NEW = 8


class _UnderWay(NamedTuple):
    """A request that waits or is drawn, and the ways back to all who have asked it."""

    header: Mapping[str, Any]
    answers: list[Answer]


class Engine(Protocol):
    """Engines render requests: in this thread (`LocalEngine`) or in processes (`WorkerPool`)."""

    described: dict[str, Any]
    """Scene and OpenGL, as `hello` describes them."""
    draws_here: bool
    """Whether `start` draws in the loop's thread, and returns when it is done."""
    generation: int
    """Counts the scenes: a reply that shows an old one is no answer to a retry."""
    make_room: Callable[[], bool]
    """Lets go of something that is kept in shared memory; whether there was any."""
    outage: str
    """Why nothing can be rendered until further notice; empty if something can."""

    @property
    def is_full(self) -> bool:
        """Whether no job at all would be begun at once."""

    def has_room(self, job: Job) -> bool:
        """Whether a job would be begun at once."""

    @property
    def is_idle(self) -> bool:
        """Whether no job is under way."""

    def start(self, job: Job) -> None:
        """Begin a job; `job.done` is called once, now or from a later `turn`."""

    def watch(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop, now and later."""

    def turn(self, ready: dict[Any, int]) -> None:
        """Take in finished jobs; replace workers that have died or taken too long."""


class Dispatcher:
    """Answers what it can itself, and lets an engine render the rest, the senders in turn.

    Parameters
    ----------
    engine : Engine
    fronts : sequence of Front
        Whose untaken replies are bounded together.
    operators : collection of str, optional
        Names of the CURVE keys that may `load_scene`; without it everyone may, with an empty one nobody.
    tap : Tap, optional
        Keeps frames for those who may `watch`; without it nobody may.

    Attributes
    ----------
    is_ending : bool
        Whether the server is about to close, its shared memory with it.
    """

    def __init__(self, engine: Engine, fronts: Sequence[Front] = (), operators: Collection[str] | None = None,
                 tap: Tap | None = None):
        self._engine, self._fronts, self._operators, self._tap = engine, fronts, operators, tap
        self.is_ending = False
        self._queue = FairQueue(limits.MAX_WAITING, limits.MAX_WAITING_BYTES)
        self._started = time.monotonic()
        self.requests: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()
        self._kept = KeptReplies()
        self._under_way: dict[bytes, _UnderWay] = {}
        # When a quick frame counts for who has had a slow one, by the monotonic clock; zero for who is quick.
        self._slow_until: OrderedDict[Hashable, float] = OrderedDict()
        self._mean_seconds, self._n_new_and_quick = 0.0, 0
        self._last_timings_ms: dict[str, float] = {}
        self._own_operations = {"hello": self._hello, "status": self._status, "close": self._close}
        self._durations = Histogram("glrender_request_seconds", "op")
        self._stages = Histogram("glrender_stage_seconds", "stage")
        self._renders, self._background = Recent(), Background()
        self._warned = WarningLog()
        self._warned.scene(engine.described.get("warnings", ()))
        engine.make_room = self._make_room

    def close(self) -> None:
        """Keep no reply any more: the engine's memory is free then."""
        self._kept.clear()
        if self._tap is not None:
            self._tap.clear()

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
        return not self._queue and not self._background and self._engine.is_idle

    @property
    def can_work(self) -> bool:
        """Whether `work` would draw something in this thread at once."""
        return bool(self._queue) and self._engine.draws_here

    def submit(self, request: Request, is_closing: bool = False) -> None:
        """Take a request; it is answered now, or later from `work`. Raises nothing."""
        header: dict[str, Any] = {}
        try:
            try:
                # Lists and maps are decoded by the worker, in their sender's turn.
                header = codec.unpack_envelope(request.parts)
                client = checked_envelope(header, OPERATIONS)
                if self._has_not_taken(request):
                    self._busy(header, [request.answer], _UNTAKEN)
                elif request.is_spare and header["op"] not in limits.SPARE_OPERATIONS:
                    self._busy(header, [request.answer], _ALL_AT_WORK)
                else:
                    self._take(request, header, client, is_closing)
            except GlrenderError as error:
                self._refuse(request, header, error.code, getattr(error, "path", ""), str(error))
        except Exception:
            log.exception("request %s failed", header.get("op"))
            self._refuse(request, {}, "internal", "", "the server failed on this request; its log has the traceback")

    def _take(self, request: Request, header: dict[str, Any], client: str, is_closing: bool) -> None:
        digest = self._digest(request.parts[0])
        kept, under_way = self._kept.get(client), self._under_way.get(digest)
        if kept is not None and kept.digest == digest:
            request.answer(kept.reply)
        elif under_way is not None and len(under_way.answers) < limits.MAX_COPIES:
            # A retry of a request that is being drawn: both get the one reply.
            under_way.answers.append(request.answer)
        elif is_closing:
            self._refuse(request, header, "closing", "", "the server is shutting down")
        elif header["op"] == "watch":
            self._watch(request, header)
        elif header["op"] not in DRAWN:
            self.requests[header["op"]] += 1
            request.answer(self._own_operations[header["op"]](header))
        elif header["op"] == "load_scene" and self._operators is not None and request.user not in self._operators:
            self._refuse(request, header, "forbidden", "op", "this server's scene is replaced by its operators alone"
                         if self._operators else "this server's scene is not replaced (--no-load-scene)")
        elif under_way is not None:
            self._busy(header, [request.answer], f"{limits.MAX_COPIES} copies of this request are under way")
        else:
            self._enqueue(header, digest, request)

    def _digest(self, message: bytes) -> bytes:
        return hashlib.sha256(b"%d:" % self._engine.generation + message).digest()

    def _has_not_taken(self, request: Request) -> bool:
        return limits.is_too_much(request.untaken_bytes(), lambda: sum(front.untaken_bytes for front in self._fronts))

    def _enqueue(self, header: dict[str, Any], digest: bytes, request: Request) -> None:
        header = {**{name: header[name] for name in ENVELOPE}, "is_slow": "backend" in header,
                  "shared": header.get("shared") is True, "background": header.get("background") is True}
        self._under_way[digest] = _UnderWay(header, [request.answer])
        self.requests[header["op"]] += 1
        finish = partial(self._finish, request, header, digest, time.monotonic())
        account = _account(request)
        job = Job(header, request.parts[0], finish, request.sender, account, self._is_quick(account))
        if header["background"]:
            why = "a newer one, or another client's, waits in the background"
            refusals = self._background.put(request.sender, (job, digest, request))
        else:
            self._background.others_ask(time.monotonic())
            refusals = self._queue.put(request.sender, (job, digest, request), len(request.parts[0]))
            why = f"{len(self._queue)} requests are waiting"
        for refused, of_it, _ in refusals:
            self._busy(refused.header, self._under_way.pop(of_it).answers, why)

    def work(self) -> None:
        """Begin jobs while the engine has room for them."""
        if self._engine.outage:
            while found := self._queue.get():
                found[0].done(Done(refusal(found[0].header, "device", "", self._engine.outage), "device", {}))
            if found := self._background.drop():
                found[0].done(Done(refusal(found[0].header, "device", "", self._engine.outage), "device", {}))
            return
        # Where nothing is free, the senders who wait need not be asked one by one.
        while not self._engine.is_full and (
                found := self._queue.get(lambda item: self._engine.has_room(self._known_by_now(item[0])))):
            job, digest, request = found
            if not (job.is_load or request.is_there() or len(self._under_way[digest].answers) > 1):
                del self._under_way[digest]  # nobody waits for it any more
                continue
            if self._has_not_taken(request):
                self._busy(job.header, self._under_way.pop(digest).answers, _UNTAKEN)
                continue
            self._engine.start(self._known_by_now(job))
            if self._engine.draws_here:
                return  # others have their turn
        if self._background and not self._queue:
            if self.is_ending:
                job = self._background.drop()[0]
                job.done(Done(refusal(job.header, "closing", "", "the server is shutting down"), "closing", {}))
            elif found := self._background.get(time.monotonic(), lambda item: self._engine.has_room(item[0])):
                self._engine.start(found[0])

    def _finish(self, request: Request, header: Mapping[str, Any], digest: bytes, came: float, done: Done) -> None:
        now = time.monotonic()
        seconds = now - came
        self._durations.observe(header["op"], seconds)
        for stage, milliseconds in done.timings_ms.items():
            self._stages.observe(stage, 1e-3 * milliseconds)
        if log.isEnabledFor(logging.DEBUG):
            log.debug("request", extra={"op": header["op"], "client": header["client"], "id": header["id"],
                                        "code": done.code, "ms": 1e3 * seconds,
                                        "render_ms": done.timings_ms.get("total", 0.0)})
        self._mean_seconds += 0.1 * (seconds - self._mean_seconds)
        self._remember(_account(request), done, now)
        reply = done.reply
        if done.code:
            self.errors[done.code] += 1
        else:
            # Shared memory ends with the server: what a client would come for too late goes over the socket.
            if header["shared"] and done.place is not None and not self.is_ending:
                reply = [codec.with_field(reply[0], "shared", done.place)]
            of_reply = digest
            if header["op"] == "load_scene":
                self._kept.clear()
                if self._tap is not None:
                    self._tap.clear()
                self._warned.scene(self._engine.described.get("warnings", ()))
                of_reply = self._digest(request.parts[0])
            self._kept.keep(header["client"], of_reply, reply, done.reply[1:])
            if header["op"] == "render" and not header["background"]:
                self._renders.observe(now, seconds)
                self._warned.frames(header["client"], done.warnings, now)
                if self._tap is not None and (len(done.reply) > 1 or done.place is not None):
                    self._tap.keep(header["client"], [camera for camera, _ in done.warnings], request.parts[0],
                                   done.reply, done.place)
        if header["background"]:
            self._background.ended(now)
        elif done.timings_ms:
            self._last_timings_ms = done.timings_ms
        # None of a request that was given up.
        for answer in self._under_way.pop(digest, _UnderWay(header, [])).answers:
            answer(reply)

    def give_up(self) -> None:
        """Answer `closing` to all requests that still wait."""
        while self._queue.get() is not None:
            pass
        for header, answers in self._under_way.values():
            self.errors["closing"] += 1
            for answer in answers:
                answer(refusal(header, "closing", "", "the server is shutting down"))
        self._under_way.clear()

    def _is_quick(self, sender: Hashable) -> bool:
        """Whether a sender has had no slow frame lately; of a new one, whether the last new ones all were quick."""
        slow_until = self._slow_until.get(sender)
        return self._n_new_and_quick >= _N_NEW if slow_until is None else not slow_until

    def _known_by_now(self, job: Job) -> Job:
        """A job with what its sender is known for now: who was quick when it came may have had a slow one since."""
        is_quick = self._is_quick(job.account)
        return job if job.is_quick == is_quick else job._replace(is_quick=is_quick)

    def _remember(self, sender: Hashable, done: Done, now: float) -> None:
        """Keep whether the sender's request had a renderer for long."""
        if done.timings_ms or done.code == "poison":
            is_slow = not done.timings_ms or 1e-3 * done.timings_ms["total"] >= QUICK_S
            if is_slow or sender not in self._slow_until:
                self._n_new_and_quick = 0 if is_slow else self._n_new_and_quick + 1
            if is_slow or now >= self._slow_until.get(sender, 0.0):
                self._slow_until[sender] = now + _SLOW_FOR_S if is_slow else 0.0
            self._slow_until.move_to_end(sender)
            while len(self._slow_until) > _MAX_SENDERS:
                self._slow_until.popitem(last=False)

    def _busy(self, header: Mapping[str, Any], answers: Sequence[Answer], why: str, wait_s: float = 0.0) -> None:
        self.errors["busy"] += 1
        wait_s = wait_s or min(max(_MIN_RETRY_S, self._mean_seconds), _MAX_RETRY_S)
        reply = refusal(header, "busy", "", why, retry_after_s=wait_s)
        for answer in answers:
            answer(reply)

    def _refuse(self, request: Request, header: Mapping[str, Any], code: str, path: str, message: str) -> None:
        self.errors[code] += 1
        request.answer(refusal(header, code, path, message))

    def _make_room(self) -> bool:
        """Keep the oldest reply no more, or else the oldest frame of those who watch; whether there was one."""
        return self._kept.drop() or (self._tap is not None and self._tap.drop())

    def _watch(self, request: Request, header: Mapping[str, Any]) -> None:
        if self._tap is None or not self._tap.may_watch(header):
            self._refuse(request, header, "forbidden", "op", "this server shows its frames to nobody; start it with "
                         "--watch" if self._tap is None else "this server shows its frames by its own --view alone; "
                         "start it with --watch")
            return
        reply = self._tap.answer(header, bool(request.user), self._engine.generation)
        if reply is None:
            self._busy(header, [request.answer], "this much is shown in a second; ask later", _WATCHED_S)
        else:
            self.requests["watch"] += 1
            request.answer(reply)

    # Operations that need no renderer.

    def _hello(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, ENVELOPE)
        return codec.pack({
            **echo(header), "ok": True, "protocol": [codec.VERSION],
            "protocol_minor": codec.MINOR_VERSION, "server": f"glrender {glrender.__version__}",
            "operations": list(OPERATIONS), "outputs": list(OUTPUTS), "products": list(PRODUCTS),
            **self._engine.described,
            "limits": {**limits.described(), "max_directions": MAX_DIRECTIONS}})

    def _status(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, ENVELOPE)
        return codec.pack({
            **echo(header), "ok": True, "uptime_s": time.monotonic() - self._started,
            "requests": dict(self.requests), "errors": dict(self.errors), "clients": len(self._kept),
            "waiting": len(self._queue), "last_timings_ms": self._last_timings_ms,
            "generation": self._engine.generation, "renders": self._renders.described(time.monotonic()),
            **self._engine.described})

    def _close(self, header: Mapping[str, Any]) -> list[Any]:
        """The client says goodbye: nothing is kept for it any more. The server runs on."""
        known_keys("", header, ENVELOPE)
        self._kept.forget(header["client"])
        return codec.pack({**echo(header), "ok": True})


def _account(request: Request) -> Hashable:
    """Who is known by the time of a request: all connections of a machine or a process, where these are known."""
    return request.sender if request.account is None else request.account
