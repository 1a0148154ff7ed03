"""Several spawned processes that render: each request to a free one; what dies or overruns is replaced."""

from __future__ import annotations

import contextlib
import logging
import pickle
import time
from collections import deque
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import zmq
from glrender import DeviceError, Scene
from glrender.engines.advice import Advice

from .envelope import refusal
from .job import Done, Job
from .slots import SlotStore, offsets
from .worker import work

log = logging.getLogger(__name__)

START_S, START_S_PER_FACET = 120.0, 2e-4
"""A worker that is not ready by then has failed: a new shape's levels of detail are made and measured once."""
SLOW_DEADLINE_S = 600.0
"""Of a request that allows slow frames, or loads a scene."""
_FIRST_BACK_OFF_S, _MAX_BACK_OFF_S = 0.1, 30.0
_MAX_TRIES = 2


@dataclass(eq=False)
class _Task:
    job: Job
    tries: int = 0


@dataclass(eq=False)
class _Worker:
    """A place for a process. It is down, starting, idle, or busy with a task (None: bringing its scene up to date)."""

    process: BaseProcess | None = None
    connection: Connection | None = None
    state: str = "down"
    task: _Task | None = None
    slot: SharedMemory | None = None
    deadline: float = 0.0
    deadline_s: float = 0.0
    has_begun: bool = False
    progress: float | None = None
    overran: bool = False
    generation: int = 0
    failures: int = 0
    start_at: float = 0.0


class WorkerPool:
    """Renders in processes; the interface is that of `dispatcher.Engine`.

    Parameters
    ----------
    scene, backend, shape_dir
        As of `Operations`.
    n_workers : int
    deadline_s : float [s]
        A worker that takes longer over one request is killed. The request is tried once more, then
        answered `poison`; so is one whose worker dies.
    slow_deadline_s : float [s]
        Instead, for a request that allows slow frames or loads a scene.

    Raises
    ------
    DeviceError
        No worker starts.
    """

    def __init__(self, scene: Scene, backend: str = "auto", shape_dir: Path | None = None, *, n_workers: int,
                 deadline_s: float, slow_deadline_s: float = SLOW_DEADLINE_S, log_format: str = "text"):
        self._scene_pickle, self._arguments = pickle.dumps(scene), (backend, shape_dir)
        self._start_s = START_S + START_S_PER_FACET * sum(len(body.shape.facets) for body in scene.bodies)
        self._deadline_s, self._slow_deadline_s, self._log_format = deadline_s, slow_deadline_s, log_format
        self._spawn = get_context("spawn")
        self._slots, self._frame_bytes = SlotStore(), 0
        self._workers = [_Worker() for _ in range(n_workers)]
        self._again: deque[_Task] = deque()
        self._generation, self._scene_message = 0, None
        self._poller: zmq.Poller | None = None
        self._described: dict[str, Any] = {}
        self.outage, self.restarts = "", 0
        try:
            for worker in self._workers:
                self._start(worker)
            while not any(worker.state == "idle" for worker in self._workers):
                time.sleep(0.02)
                self._turn_all()
                if self.outage:
                    raise DeviceError(self.outage)
        except BaseException:
            self.close()
            raise

    @property
    def described(self) -> dict[str, Any]:
        """Scene and OpenGL, and how the workers do; of slow frames under way, the share done."""
        slow = [w.progress for w in self._workers if w.state == "busy" and w.progress is not None]
        return {**self._described, "workers": {"ready": sum(w.state in ("idle", "busy") for w in self._workers),
                                               "of": len(self._workers), "restarts": self.restarts},
                "slow_frames": slow}

    @property
    def has_room(self) -> bool:
        """Whether a job would be begun at once."""
        return not self._again and not self._is_loading and any(w.state == "idle" for w in self._workers)

    @property
    def is_idle(self) -> bool:
        """Whether no job is under way."""
        return not self._again and all(worker.task is None for worker in self._workers)

    def start(self, job: Job) -> None:
        """Hand a job to a free worker."""
        self._hand_over(_Task(job))

    def watch(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop, now and later."""
        self._poller = poller
        for worker in self._workers:
            if worker.connection is not None:
                poller.register(worker.connection.fileno(), zmq.POLLIN)

    def turn(self, ready: dict[Any, int]) -> None:
        """Take in what is finished; replace what has died or taken too long."""
        self._turn_all()
        while self._again and not self._is_loading and any(w.state == "idle" for w in self._workers):
            self._hand_over(self._again.popleft())
        self._slots.trim()

    def close(self) -> None:
        """End every worker and release the shared memory."""
        for worker in self._workers:
            self._end(worker)
        self._slots.close()

    @property
    def _is_loading(self) -> bool:
        """A scene that replaces the old one lets no later request pass."""
        return any(w.task is not None and w.task.job.header["op"] == "load_scene" for w in self._workers)

    def _hand_over(self, task: _Task) -> None:
        # The last to have finished has the warmest caches; one with an old scene is the last choice.
        idle = [worker for worker in self._workers if worker.state == "idle"]
        worker = max(idle, key=lambda w: (w.generation, w.deadline))
        worker.task = task
        if worker.generation != self._generation:
            worker.deadline_s = self._slow_deadline_s
            self._send(worker, self._scene_message)
            worker.state = "catching up"
        else:
            self._begin(worker)

    def _begin(self, worker: _Worker) -> None:
        worker.state = "busy"
        header = worker.task.job.header
        is_slow = header.get("allow_slow") or header["op"] == "load_scene"
        worker.deadline_s = self._slow_deadline_s if is_slow else self._deadline_s
        self._send(worker, worker.task.job.message)

    def _send(self, worker: _Worker, message: bytes) -> None:
        worker.has_begun, worker.progress = False, None
        worker.slot = worker.slot or self._take(self._frame_bytes)
        worker.deadline = time.monotonic() + worker.deadline_s
        # A dead worker is found by the next turn.
        with contextlib.suppress(OSError):
            worker.connection.send(("job", message, worker.slot.name if worker.slot else ""))

    def _take(self, n_bytes: int) -> SharedMemory | None:
        try:
            return self._slots.take(n_bytes)
        except OSError as error:
            log.warning("a worker has no shared memory: %s", error)
            return None

    def _turn_all(self) -> None:
        now = time.monotonic()
        for worker in self._workers:
            if worker.state == "down":
                if now >= worker.start_at:
                    self._start(worker)
                continue
            try:
                while worker.state != "down" and worker.connection.poll():
                    self._hear(worker, worker.connection.recv())
            except (EOFError, OSError):
                self._bury(worker)
                continue
            if worker.state in ("starting", "busy", "catching up") and now > worker.deadline:
                worker.overran = True
                worker.process.kill()
                self._bury(worker)
        if any(worker.state in ("idle", "busy", "catching up") for worker in self._workers):
            self.outage = ""

    def _hear(self, worker: _Worker, said: tuple) -> None:
        kind, *rest = said
        if kind == "awake":
            # Not before: what a pipe cannot hold waits for its reader, and one that died unread would be waited for.
            worker.connection.send_bytes(self._scene_pickle)
            worker.connection.send(self._scene_message)
            worker.generation = self._generation
        elif kind == "ready":
            worker.state, self.outage = "idle", ""
            self._described = rest[0]
        elif kind == "failed":
            self.outage = f"a worker did not start: {rest[0]}"
            log.error(self.outage)
            self._bury(worker)
        elif kind == "begun":
            worker.has_begun = True
        elif kind == "progress":
            worker.progress = rest[0]
        elif kind == "need":
            if worker.slot is not None:
                self._slots.give_back(worker.slot)
            worker.slot = self._take(rest[0])
            worker.connection.send(worker.slot.name if worker.slot else "")
        else:
            self._done(worker, *rest)

    def _done(self, worker: _Worker, head: bytes, sizes: list[int], code: str, timings_ms: dict[str, float],
              warnings: list[tuple[str, tuple[Advice, ...]]], described: dict[str, Any] | None) -> None:
        if worker.state == "catching up":
            worker.generation = self._generation
            self._begin(worker)
            return
        task, worker.task = worker.task, None
        worker.state, worker.failures, worker.deadline, worker.progress = "idle", 0, time.monotonic(), None
        parts, place = [], None
        if sizes:
            # The next frame is likely as large as the last.
            self._frame_bytes = offsets(sizes)[-1]
            parts, place = self._slots.lend(worker.slot, sizes)
            worker.slot = None
        if described is not None:
            self._described, self._scene_message = described, task.job.message
            self._generation += 1
            worker.generation = self._generation
        task.job.done(Done([head, *parts], code, timings_ms, place, warnings))

    def _start(self, worker: _Worker) -> None:
        worker.state, worker.overran, worker.deadline = "starting", False, time.monotonic() + self._start_s
        try:
            worker.connection, theirs = self._spawn.Pipe()
            with theirs:
                arguments = theirs, *self._arguments, log.getEffectiveLevel(), self._log_format
                process = self._spawn.Process(target=work, name="glrender-worker", daemon=True, args=arguments)
                process.start()
        except OSError as error:
            log.error("the system has no room for a worker: %s", error)
            self._bury(worker)
            return
        worker.process = process
        if self._poller is not None:
            self._poller.register(worker.connection.fileno(), zmq.POLLIN)

    def _bury(self, worker: _Worker) -> None:
        """Another in the place of a worker that died, after a while that doubles; its task again, once."""
        how = f"overran its deadline of {worker.deadline_s:g} s" if worker.overran else "died"
        was_starting = worker.state == "starting"
        # A worker that was dying when it got the request is not the request's fault: no try.
        is_its_fault = worker.state == "busy" and (worker.has_begun or worker.overran)
        self._end(worker)
        back_off = min(_FIRST_BACK_OFF_S * 2**worker.failures, _MAX_BACK_OFF_S)
        worker.failures, worker.start_at = worker.failures + 1, time.monotonic() + back_off
        self.restarts += 1
        # Another may start in a moment: requests wait for that.
        if was_starting and (worker.overran or worker.failures > _MAX_TRIES) and not self.outage:
            self.outage = "a worker did not start; the server's log may say why"
        log.warning("a worker %s; the next starts in %g s", how, back_off)
        task, worker.task = worker.task, None
        if task is None:
            return
        task.tries += is_its_fault
        if task.tries < _MAX_TRIES:
            self._again.append(task)
            return
        log.error("poison: request %s of %s", task.job.header["id"], task.job.header["client"])
        task.job.done(Done(refusal(task.job.header, "poison", "", f"the worker {how} on this request, {_MAX_TRIES} "
                                   "times; it is not tried again"), "poison", {}))

    def _end(self, worker: _Worker) -> None:
        worker.state = "down"
        if worker.connection is not None:
            if self._poller is not None and worker.connection.fileno() in self._poller:
                self._poller.unregister(worker.connection.fileno())
            worker.connection.close()
            worker.connection = None
        if worker.process is not None:
            worker.process.kill()
            worker.process.join()
            worker.process.close()
            worker.process = None
        if worker.slot is not None:
            self._slots.give_back(worker.slot)
            worker.slot = None
