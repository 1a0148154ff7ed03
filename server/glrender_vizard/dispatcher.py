"""Basilisk's side of Vizard's protocol: every message gets its answer, in the order that Basilisk waits for.

Basilisk waits for ever (its socket has no time limit), so nothing may go unanswered: a frame that cannot be made is an
image of no bytes, which Basilisk takes as an invalid one, and the log has the reason, once while it lasts.
"""

from __future__ import annotations

import logging
import re
import struct
import time
from collections import Counter, OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import partial

import msgpack
from glrender import GlrenderError
from glrender_camera.errors import shortened
from glrender_server import limits
from glrender_server.front import Answer, FairQueue, Request
from glrender_server.job import Done, Job
from glrender_server.metrics import Histogram, counter, gauge

from . import frames
from .bodies import BodyMap
from .engines import Engines
from .frames import FrameOrder
from .limits import MAX_CACHED_BYTES, MAX_MESSAGE_BYTES, MAX_NOTE_CHARACTERS, MAX_SIMULATIONS, MAX_UPDATE_BYTES
from .messages import CustomModel, Update, read_update

log = logging.getLogger(__name__)

# An empty body has two bytes, and some hundred when it is read.
_BYTES_PER_ENTRY = 400
_NO_IMAGE = (struct.pack(">i", 0), b"")
_IMAGE = re.compile(rb"REQUEST_IMAGE_(-?\d{1,19})", re.ASCII)
_HEADER = {"v": 1, "op": "render", "id": 0, "client": "vizard", "is_slow": False, "shared": False}


@dataclass(eq=False)
class Simulation:
    """Basilisk behind one connection: its last update, and the notes that the log has about it."""

    number: int
    update: Update | None = None
    models: tuple[CustomModel, ...] | None = None
    n_bytes: int = 0
    models_bytes: int = 0
    told: set[str] = field(default_factory=set)

    def take(self, data: bytes) -> Update:
        """Take in a `VizMessage`; settings of an earlier one hold on.

        Raises
        ------
        ProtocolError
        """
        update = read_update(data)
        n_bytes = len(data) + _BYTES_PER_ENTRY * (len(update.bodies) + len(update.spacecraft) + len(update.cameras)
                                                  + len(update.models or ()))
        if update.models is not None:
            self.models, self.models_bytes = update.models, n_bytes
        self.update, self.n_bytes = update, n_bytes + self.models_bytes
        return update


@dataclass(eq=False)
class _Wanted:
    """A frame under way, who waits for it, and since when [s]."""

    order: FrameOrder
    key: Hashable
    waiting: list[tuple[Simulation, Answer]]
    since: float


class VizardDispatcher:
    """Answers what Basilisk asks of Vizard; the interface is that of `glrender_server.dispatcher.Dispatcher`.

    Parameters
    ----------
    engines : Engines
    body_map : BodyMap

    Attributes
    ----------
    is_ending : bool
        Whether the adapter is about to close.
    """

    can_work = False

    def __init__(self, engines: Engines, body_map: BodyMap):
        self._engines, self._map, self.is_ending = engines, body_map, False
        self._simulations: OrderedDict[Hashable, Simulation] = OrderedDict()
        self._n_seen = self._update_bytes = self._cached_bytes = 0
        self._queue = FairQueue(limits.MAX_WAITING, limits.MAX_WAITING_BYTES)
        self._under_way: dict[Hashable, _Wanted] = {}
        self._pictures: OrderedDict[Hashable, memoryview] = OrderedDict()
        self.messages: Counter[str] = Counter()
        self._seconds = Histogram("glrender_vizard_seconds", "of")

    def metrics(self):
        """Lines for a Prometheus; may be called from another thread."""
        yield from counter("glrender_vizard_messages_total", "kind", dict(self.messages))
        yield from gauge("glrender_vizard_simulations", len(self._simulations))
        yield from self._seconds.lines()

    @property
    def is_idle(self) -> bool:
        """Whether every message has been answered."""
        return not self._queue and not self._under_way

    def submit(self, request: Request, is_closing: bool = False) -> None:
        """Take a message; it is answered now, or later from `work`. Raises nothing."""
        head = request.parts[0] if request.parts else b""
        try:
            simulation = self._simulation(request.sender)
            if head == b"PING":
                self.messages["ping"] += 1
                request.answer([b"PONG"])
            elif head == b"SIM_UPDATE":
                self.messages["update"] += 1
                request.answer([self._updated(request.sender, simulation, request.parts[-1])])
            elif head == b"REQUEST_INPUT":
                self.messages["input"] += 1
                request.answer([b"VIZARD_INPUT", b""])
            elif head.startswith(b"REQUEST_IMAGE_"):
                self.messages["image"] += 1
                self._image(request, simulation, head, is_closing)
            else:
                self.messages["unknown"] += 1
                self._tell(simulation, f"a message {head[:32]!r} is none of Basilisk's")
                request.answer([b"ERROR"])
        except Exception:
            log.exception("a message failed")
            request.answer(_NO_IMAGE if head.startswith(b"REQUEST_IMAGE_") else [b"ERROR"])

    def _simulation(self, sender: Hashable) -> Simulation:
        found = self._simulations.get(sender)
        if found is None:
            self._n_seen += 1
            found = self._simulations[sender] = Simulation(self._n_seen)
            while len(self._simulations) > MAX_SIMULATIONS:
                self._forget(next(iter(self._simulations)))
        self._simulations.move_to_end(sender)
        return found

    def _updated(self, sender: Hashable, simulation: Simulation, data: bytes) -> bytes:
        """The answer to an update: Basilisk ends its run with an error at any but OK."""
        before, simulation.update = simulation.n_bytes, None
        if len(data) > MAX_MESSAGE_BYTES:
            self._tell(simulation, f"an update has {len(data)} bytes, more than {MAX_MESSAGE_BYTES}")
            return b"ERROR"
        try:
            update = simulation.take(data)
        except GlrenderError as error:
            self._tell(simulation, f"an update cannot be read: {error}")
            return b"ERROR"
        self._update_bytes += simulation.n_bytes - before
        if simulation.models is None:
            self._tell(simulation, "its settings came before the adapter did: custom models are not known")
        if update.is_last:
            self._forget(sender)
        while self._update_bytes > MAX_UPDATE_BYTES and len(self._simulations) > 1:
            self._forget(next(iter(self._simulations)))
        return b"OK"

    def _forget(self, sender: Hashable) -> None:
        self._update_bytes -= self._simulations.pop(sender).n_bytes

    def _image(self, request: Request, simulation: Simulation, head: bytes, is_closing: bool) -> None:
        began, matched = time.monotonic(), _IMAGE.fullmatch(head)
        refused = ""
        if matched is None:
            refused = f"{head[:48]!r} names no camera by its number"
        elif simulation.update is None:
            refused = "an image is asked for before an update: the adapter may be new, or have forgotten the last one"
        elif is_closing:
            refused = "the adapter is shutting down"
        elif request.untaken_bytes() > limits.MAX_UNTAKEN_BYTES:
            refused = "the simulation has not taken its images"
        else:
            try:
                order = frames.ordered(simulation.update, simulation.models or (), int(matched[1]), self._map)
            except GlrenderError as error:
                refused = str(error)
        if refused:
            self._answer_none(simulation, request.answer, refused)
            return
        for note in order.notes:
            self._tell(simulation, note)
        key = order.scene, order.message
        if (kept := self._pictures.get(key)) is not None:
            self.messages["image_again"] += 1
            self._pictures.move_to_end(key)
            self._answer(request.answer, kept)
        elif (wanted := self._under_way.get(key)) is not None and len(wanted.waiting) < limits.MAX_COPIES:
            wanted.waiting.append((simulation, request.answer))
        elif wanted is not None:
            self._answer_none(simulation, request.answer, f"{limits.MAX_COPIES} copies of this image are under way")
        else:
            self._enqueue(request, _Wanted(order, key, [(simulation, request.answer)], began))

    def _enqueue(self, request: Request, wanted: _Wanted) -> None:
        message = wanted.key[1]
        self._under_way[wanted.key] = wanted
        job = Job(_HEADER, message, partial(self._drawn, wanted), request.sender, request.sender, True)
        for _, of_it in self._queue.put(request.sender, (job, wanted), len(message)):
            self._end(of_it, None, f"{len(self._queue)} images are waiting")

    def work(self) -> None:
        """Begin what the engines have room for."""
        while found := self._queue.get(lambda item: self._engines.has_room(item[1].order.scene, item[0])):
            job, wanted = found
            if refused := self._engines.start(wanted.order.scene, job):
                self._end(wanted, None, refused)

    def _drawn(self, wanted: _Wanted, done: Done) -> None:
        try:
            if done.code:
                self._end(wanted, None, msgpack.unpackb(done.reply[0])["error"]["message"])
                return
            # Shared memory is for frames on their way; the picture is kept for longer.
            picture = memoryview(bytes(done.reply[1]))
            for _, warnings in done.warnings:
                for advice in warnings:
                    self._tell(wanted.waiting[0][0], advice.message, advice.code)
        except Exception:
            log.exception("a picture failed")
            self._end(wanted, None, "the adapter failed on this frame; its log has the traceback")
            return
        self._end(wanted, picture, "")
        draw_ms, all_ms = done.timings_ms["total"], 1e3 * (time.monotonic() - wanted.since)
        for of, milliseconds in (("draw", draw_ms), ("image", all_ms)):
            self._seconds.observe(of, 1e-3 * milliseconds)
        log.debug("image", extra={"draw_ms": draw_ms, "ms": all_ms})

    def _end(self, wanted: _Wanted, picture: memoryview | None, refused: str) -> None:
        """Answer all who wait for a frame."""
        self._under_way.pop(wanted.key, None)
        if picture is not None:
            self._keep(wanted.key, picture)
        for simulation, answer in wanted.waiting:
            if picture is None:
                self._answer_none(simulation, answer, refused)
            else:
                self._answer(answer, picture)

    def _keep(self, key: Hashable, picture: memoryview) -> None:
        self._pictures[key] = picture
        self._cached_bytes += len(picture)
        while self._cached_bytes > MAX_CACHED_BYTES and len(self._pictures) > 1:
            self._cached_bytes -= len(self._pictures.popitem(last=False)[1])

    @staticmethod
    def _answer(answer: Answer, picture: memoryview) -> None:
        answer([struct.pack(">i", len(picture)), picture])

    def _answer_none(self, simulation: Simulation, answer: Answer, refused: str) -> None:
        self.messages["image_none"] += 1
        self._tell(simulation, f"no image: {refused}")
        answer(_NO_IMAGE)

    @staticmethod
    def _tell(simulation: Simulation, text: str, kind: str = "") -> None:
        """Write a line to the log, once for each simulation and kind, which is the text itself unless it is given."""
        text = shortened(text, MAX_NOTE_CHARACTERS)
        if (kind or text) not in simulation.told and len(simulation.told) < limits.LOG_LINES:
            simulation.told.add(kind or text)
            log.warning("simulation %d: %s", simulation.number, text)

    def give_up(self) -> None:
        """Answer all requests that still wait: the adapter ends."""
        while self._queue.get() is not None:
            pass
        for wanted in list(self._under_way.values()):
            self._end(wanted, None, "the adapter is shutting down")


