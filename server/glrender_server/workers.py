"""Several spawned processes that render: each request to a free one; what dies or overruns is replaced."""

from __future__ import annotations

import contextlib
import logging
import math
import multiprocessing.connection  # noqa: F401, else a dead worker's first join imports it: it wants a descriptor
import pickle
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zmq
from glrender import DeviceError, GlrenderError
from glrender.base.plausible import Advice

from .envelope import refusal
from .job import Done, Job
from .scene_digest import scene_digest
from .scene_source import SceneFile
from .slots import SlotStore, has_begun, mark_begun, offsets
from .stream import Channel
from .worker import work

if TYPE_CHECKING:
    from glrender import Scene

    from .operations import Operations

log = logging.getLogger(__name__)

START_S, START_S_PER_FACET = 120.0, 2e-4
"""A worker that is not ready by then has failed; the first time, tables of its shapes are made."""
SLOW_DEADLINE_S = 600.0
"""Deadline of a request that names a backend, or loads a scene."""
# The next start waits longer each time: of a worker that ends by itself, and of one that a signal ends (killed by hand,
# by a driver, for want of memory), so that a service which somebody keeps killing is back within seconds.
_FIRST_BACK_OFF_S, _MAX_BACK_OFF_S, _MAX_BACK_OFF_AFTER_SIGNAL_S = 0.1, 30.0, 1.0
_MAX_TRIES = 2
# Workers of a new scene, one after the other, that a signal ended while they opened it: so many refute the scene, as
# one that needs more memory than there is; fewer may be killed by hand.
_MAX_KILLED_BY_SCENE = 6
# A worker that has used less of its deadline than this share was stopped from outside: its request is not to blame.
_STOPPED_SHARE = 0.02
# A worker that starts, or loads a scene, for less than so long [s]: most take 2, on a busy machine 15.
_COMES_WITHIN_S = 30.0
# While a sender known to be quick has had a frame within this time [s], the last free worker is kept for such.
_KEPT_FOR_QUICK_S = 10.0
# The clock of all of a process' threads, in user and in kernel mode.
_CPUCLOCK_SCHED = 2
# Made once: to join flags takes the time of a system call.
_IN_AND_OUT = zmq.POLLIN | zmq.POLLOUT
# A killed process that is not dead by then hangs in a driver: the server's end does not wait for it.
_DEATH_S = 5.0


@dataclass(eq=False)
class _Task:
    job: Job
    tries: int = 0


@dataclass(eq=False)
class _Worker:
    """A place for a process. It is down, starting, idle, busy with a task, or loading the scene that others have."""

    process: BaseProcess | None = None
    channel: Channel | None = None
    state: str = "down"
    task: _Task | None = None
    slot: SharedMemory | None = None
    deadline: float = 0.0
    deadline_s: float = 0.0
    processor_s: float = 0.0
    progress: float | None = None
    overran: bool = False
    was_stopped: bool = False
    wants_scene: bool = False
    is_after_overrun: bool = False
    generation: int = 0
    failures: int = 0
    start_at: float = 0.0

    def comes_soon(self, now: float) -> bool:
        """Whether it starts after a request that overran, whose sender may have sent more of the kind."""
        if not self.is_after_overrun:
            return False
        if self.state in ("starting", "loading"):
            return now - (self.deadline - self.deadline_s) < _COMES_WITHIN_S
        return self.state == "down" and self.start_at - now < _MAX_BACK_OFF_AFTER_SIGNAL_S


class WorkerPool:
    """Renders in processes; the interface is that of `dispatcher.Engine`.

    Parameters
    ----------
    scene : Scene or SceneFile
        A file is read by the first worker that is awake, and the others have the scene from it.
    backend, shape_dir
        As of `Operations`.
    n_workers : int
    deadline_s : float [s]
        A worker that takes longer over one request is killed, and the request answered `poison`: it would take as long
        again. It is tried once more if its worker dies, or was stopped and used no processor time.
    slow_deadline_s : float [s]
        Instead, for a request that names a backend or loads a scene; the latter is never tried again.
    memory_bytes : int, optional
        Data that a worker may have (RLIMIT_DATA); a request that needs more is answered `device`.
    operations : type
        Class that serves a worker's requests.

    Raises
    ------
    DeviceError
        No worker starts.
    ConfigError, ShapeError
        The file cannot be read.
    """

    def __init__(self, scene: Scene | SceneFile, backend: str = "auto", shape_dir: Path | None = None, *,
                 n_workers: int, deadline_s: float, slow_deadline_s: float = SLOW_DEADLINE_S,
                 memory_bytes: int | None = None, log_format: str = "text", operations: type[Operations] | None = None):
        # As pickle and digest: the scene that is served, and the server's own, which has no digest until it is read.
        is_read = not isinstance(scene, SceneFile)
        self._scene = self._own_scene = pickle.dumps(scene), scene_digest(scene) if is_read else ""
        self._start_s = _start_s(sum(len(body.shape.facets) for body in scene.bodies) if is_read else 0)
        self._unreadable: GlrenderError | None = None
        self._arguments, self._operations = (backend, shape_dir, memory_bytes), operations
        self._deadline_s, self._slow_deadline_s, self._log_format = deadline_s, slow_deadline_s, log_format
        self._spawn = get_context("spawn")
        self._slots, self._frame_bytes = SlotStore(), 0
        self._workers = [_Worker() for _ in range(n_workers)]
        self._again: deque[_Task] = deque()
        self._dying: list[tuple[BaseProcess, SharedMemory | None]] = []
        self.generation, self._n_failed_scenes, self._n_killed_by_scene = 0, 0, 0
        # Lets go of something in shared memory; whether there was any.
        self.make_room: Callable[[], bool] = lambda: False
        self._poller: zmq.Poller | None = None
        self._described: dict[str, Any] = {}
        self.draws_here, self.outage, self.restarts, self._quick_at = False, "", 0, -math.inf
        try:
            for worker in self._workers:
                self._start(worker)
            while not any(worker.state == "idle" for worker in self._workers):
                time.sleep(0.02)
                self._turn_all({})
                if self._unreadable is not None:
                    raise self._unreadable
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
    def is_full(self) -> bool:
        """Whether no job at all would be begun at once."""
        return bool(self._again) or not self._free_workers()

    def has_room(self, job: Job) -> bool:
        """Whether a job would be begun at once.

        Where there are several workers, the last free one is kept from slow frames, and from a sender who is not known
        to be quick and has all the others; or, where quick ones have asked lately, if such senders have all the others:
        a client may have many connections. One scene is loaded at a time; its sender waits for it.
        """
        if self._again or not (idle := self._free_workers()):
            return False
        tasks = [worker.task.job for worker in self._workers if worker.task is not None]
        if any(task.is_load and (job.is_load or task.sender == job.sender) for task in tasks):
            return False
        if len(idle) > 1 or len(self._workers) == 1:
            return True
        now = time.monotonic()
        others = len(self._workers) - 1 - sum(worker.comes_soon(now) for worker in self._workers)
        if job.is_slow and sum(task.is_slow for task in tasks) == others:
            return False
        if job.is_quick:
            return True
        if now - self._quick_at < _KEPT_FOR_QUICK_S:
            return sum(not task.is_quick for task in tasks) < others
        return others == 0 or sum(task.account == job.account for task in tasks) < others

    @property
    def is_idle(self) -> bool:
        """Whether no job is under way."""
        return not self._again and all(worker.task is None for worker in self._workers)

    def start(self, job: Job) -> None:
        """Hand a job to a free worker."""
        if job.is_quick and not job.is_slow:
            self._quick_at = time.monotonic()
        self._begin(_Task(job))

    def watch(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop, now and later."""
        self._poller = poller
        for worker in self._workers:
            self._watch(worker)

    def turn(self, ready: dict[Any, int]) -> None:
        """Take in finished jobs; replace workers that have died or taken too long."""
        self._turn_all(ready)
        self._reap()
        while self._again and self._free_workers():
            self._begin(self._again.popleft())
        while self._again and self.outage:
            job = self._again.popleft().job
            job.done(Done(refusal(job.header, "device", "", self.outage), "device", {}))
        self._slots.trim()

    def end(self) -> None:
        """End every worker, and watch none any more; `close`, which waits until they are dead, may be of any thread."""
        for worker in self._workers:
            self._end(worker)

    def close(self) -> None:
        """End every worker and release the shared memory."""
        self.end()
        self._reap(timeout_s=_DEATH_S)
        self._slots.close()

    def _free_workers(self) -> list[_Worker]:
        """Those that wait for a job, and have the scene that is served."""
        return [w for w in self._workers if w.state == "idle" and w.generation == self.generation]

    @property
    def _is_own_scene(self) -> bool:
        return self._scene is self._own_scene

    @property
    def _is_read(self) -> bool:
        """Whether the scene is there: of a file that nobody has read there is no digest."""
        return bool(self._scene[1])

    @property
    def _may_have_scene(self) -> bool:
        """Whether the scene can be handed out: its file is read by one worker alone."""
        return self._is_read or not any(w.state == "starting" and w.generation == self.generation
                                        for w in self._workers)

    def _tell_scene(self, worker: _Worker) -> None:
        worker.generation = self.generation
        self._tell(worker, "scene", *self._scene)

    def _begin(self, task: _Task) -> None:
        # The last to have finished has the warmest caches.
        worker = max(self._free_workers(), key=lambda free: free.deadline)
        worker.task, worker.state = task, "busy"
        worker.deadline_s = self._slow_deadline_s if task.job.is_slow else self._deadline_s
        self._send(worker, task.job.message)

    def _send(self, worker: _Worker, message: bytes) -> None:
        worker.progress = None
        if worker.slot is not None and not self._slots.is_there(worker.slot):
            self._slots.give_back(worker.slot)  # somebody has tidied up
            worker.slot = None
        worker.slot = worker.slot or self._take(self._frame_bytes)
        if worker.slot is not None:
            mark_begun(worker.slot, False)
        worker.deadline, worker.processor_s = time.monotonic() + worker.deadline_s, used_s(worker.process.pid)
        self._tell(worker, "job", message, worker.slot.name if worker.slot else "")

    def _tell(self, worker: _Worker, *said: Any) -> None:
        # A dead worker is found by the next turn; one that reads nothing, at its deadline.
        with contextlib.suppress(OSError):
            worker.channel.send(*said)
        self._watch(worker)

    def _watch(self, worker: _Worker) -> None:
        """Let the loop wake for what a worker says, and for room in what it has not read."""
        if self._poller is not None and worker.channel is not None:
            self._poller.register(worker.channel.fileno(), _IN_AND_OUT if worker.channel.outbox else zmq.POLLIN)

    def _take(self, n_bytes: int) -> SharedMemory | None:
        is_last = False
        while True:
            try:
                return self._slots.take(n_bytes)
            except OSError as error:
                # Frames kept for retries and viewers give way to frames that are wanted now.
                if self.make_room():
                    continue  # a slot that is free now serves as it is
                if is_last:
                    log.warning("a worker has no shared memory: %s", error)
                    return None
                # Or others are too small: their memory is free when nobody has it in reach any more.
                is_last = True
                self._slots.trim(n_kept=0)
                for worker in self._workers:
                    if worker.state == "idle":
                        self._tell(worker, "forget")

    def _turn_all(self, ready: dict[Any, int]) -> None:
        now = time.monotonic()
        for worker in self._workers:
            if worker.state == "down":
                if now >= worker.start_at:
                    self._start(worker)
                continue
            try:
                if self._poller is None or worker.channel.fileno() in ready:
                    self._exchange(worker)
            except (EOFError, OSError):
                self._bury(worker)
                continue
            if worker.wants_scene and self._may_have_scene:
                worker.wants_scene = False
                self._tell_scene(worker)
            if worker.state in ("starting", "busy", "loading") and now > worker.deadline:
                worker.overran = True
                has_used_s = used_s(worker.process.pid) - worker.processor_s
                worker.was_stopped = has_used_s < _STOPPED_SHARE * worker.deadline_s or is_stopped(worker.process.pid)
                self._bury(worker)
            elif worker.state == "idle" and worker.generation != self.generation:
                worker.state, worker.deadline_s = "loading", self._slow_deadline_s
                worker.deadline = now + worker.deadline_s
                self._tell_scene(worker)
        if any(worker.state in ("idle", "busy", "loading") for worker in self._workers):
            self.outage = ""

    def _exchange(self, worker: _Worker) -> None:
        """Take in what a worker has said, and send it what it has room for."""
        channel = worker.channel
        if channel.outbox:
            channel.flush()
            self._watch(worker)
        for said in channel.messages():
            self._hear(worker, said)
            if worker.channel is not channel:
                return  # it is buried

    def _hear(self, worker: _Worker, said: tuple) -> None:
        kind, *rest = said
        if kind == "awake":
            # Not before: one that dies unread leaves nothing behind.
            worker.wants_scene = True
            # A file may take any time to read, and the others wait for it.
            if not self._is_read:
                worker.deadline = math.inf
        elif kind == "opened":
            *scene, n_facets = rest
            self._scene = self._own_scene = tuple(scene)
            self._start_s = _start_s(n_facets)
            for starting in self._workers:
                starting.deadline_s, starting.deadline = self._start_s, time.monotonic() + self._start_s
        elif kind == "unreadable":
            (self._unreadable,) = rest
        elif kind == "ready":
            worker.state, self.outage, worker.deadline = "idle", "", time.monotonic()
            worker.is_after_overrun = False
            self._n_failed_scenes = self._n_killed_by_scene = 0
            # Meanwhile another may have loaded a newer scene.
            if worker.generation == self.generation:
                self._described = rest[0]
        elif kind == "failed":
            if worker.state == "starting":
                self.outage = f"a worker did not start: {rest[0]}"
            log.error("a worker cannot open the scene that is served: %s", rest[0])
            self._bury(worker, has_failed=True)
        elif kind == "progress":
            worker.progress = rest[0]
        elif kind == "need":
            if worker.slot is not None:
                self._slots.give_back(worker.slot)
            worker.slot = self._take(rest[0])
            if worker.slot is not None:
                mark_begun(worker.slot)
            self._tell(worker, worker.slot.name if worker.slot else "")
        else:
            self._done(worker, *rest)

    def _done(self, worker: _Worker, head: bytes, sizes: list[int], code: str, timings_ms: dict[str, float],
              warnings: list[tuple[str, tuple[Advice, ...]]],
              loaded: tuple[bytes, str, dict[str, Any]] | None) -> None:
        task, worker.task = worker.task, None
        worker.state, worker.failures, worker.deadline, worker.progress = "idle", 0, time.monotonic(), None
        parts, place = [], None
        if sizes:
            # The next frame is likely as large as the last.
            self._frame_bytes = offsets(sizes)[-1]
            parts, place = self._slots.lend(worker.slot, sizes)
            worker.slot = None
        if loaded is not None:
            *scene, self._described = loaded
            self._scene = tuple(scene)
            self.generation += 1
            worker.generation = self.generation
            log.info("a new scene is served; %d workers still load it", len(self._workers) - 1)
        task.job.done(Done([head, *parts], code, timings_ms, place, warnings))

    def _start(self, worker: _Worker) -> None:
        worker.state, worker.overran, worker.wants_scene, worker.generation = "starting", False, False, -1
        # A scene that was loaded may take as long again.
        worker.deadline_s = self._start_s if self._is_own_scene else max(self._start_s, self._slow_deadline_s)
        worker.deadline = time.monotonic() + worker.deadline_s
        try:
            ours, theirs = socket.socketpair()
            worker.channel = Channel(ours)
            with theirs:
                arguments = theirs, *self._arguments, log.getEffectiveLevel(), self._log_format, self._operations
                process = self._spawn.Process(target=work, name="glrender-worker", daemon=True, args=arguments)
                process.start()
        except OSError as error:
            log.error("the system has no room for a worker: %s", error)
            self._bury(worker, has_failed=True)
            return
        worker.process = process
        self._watch(worker)

    def _bury(self, worker: _Worker, has_failed: bool = False) -> None:
        """Another in the place of a worker that died, after a while that doubles; its task again, once."""
        how = f"overran its deadline of {worker.deadline_s:g} s" if worker.overran else "died"
        was_starting = worker.state == "starting"
        # Not before it was given the scene: until then the scene is not to blame.
        is_opening = worker.state in ("starting", "loading") and worker.generation == self.generation
        # A worker that was dying when it got the request is not the request's fault: no try.
        is_its_fault = worker.state == "busy" and (worker.overran or worker.slot is None or has_begun(worker.slot))
        exit_code = None if worker.process is None else worker.process.exitcode
        is_by_signal = not (worker.overran or has_failed) and (exit_code is None or exit_code < 0)
        # One that does not come after all, killed again and again, is waited for no more.
        worker.is_after_overrun = worker.state == "busy" and worker.overran and not worker.was_stopped
        self._end(worker)
        if is_opening and not self._is_read:
            self._n_failed_scenes += 1
            if self._n_failed_scenes > _MAX_TRIES and not self.outage:
                self.outage = "the workers that read the scene's file died; the server's log may say why"
        elif is_opening and not self._is_own_scene:
            self._n_failed_scenes += not is_by_signal
            self._n_killed_by_scene += is_by_signal
            if self._n_failed_scenes > _MAX_TRIES or self._n_killed_by_scene >= _MAX_KILLED_BY_SCENE:
                log.error("the scene that was loaded cannot be opened any more: the server's own is served again")
                self._scene, self._n_failed_scenes, self._n_killed_by_scene = self._own_scene, 0, 0
                self.generation += 1
        back_off = min(_FIRST_BACK_OFF_S * 2**worker.failures,
                       _MAX_BACK_OFF_AFTER_SIGNAL_S if is_by_signal else _MAX_BACK_OFF_S)
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
        if task.tries < (1 if task.job.is_load or (worker.overran and not worker.was_stopped) else _MAX_TRIES):
            self._again.append(task)
            return
        log.error("poison: request %s of %r", task.job.header["id"], task.job.header["client"])
        times = "once" if task.tries == 1 else f"{task.tries} times"
        task.job.done(Done(refusal(task.job.header, "poison", "", f"the worker {how} on this request, {times}; it is "
                                   "not tried again"), "poison", {}))

    def _end(self, worker: _Worker) -> None:
        worker.state = "down"
        if worker.channel is not None:
            if self._poller is not None and worker.channel.fileno() in self._poller:
                self._poller.unregister(worker.channel.fileno())
            worker.channel.close()
            worker.channel = None
        if worker.process is not None:
            worker.process.kill()
            self._dying.append((worker.process, worker.slot))
        elif worker.slot is not None:
            self._slots.give_back(worker.slot)
        worker.process = worker.slot = None

    def _reap(self, timeout_s: float = 0.0) -> None:
        """Take back what killed workers had, once they are dead: until then one may write to its slot."""
        for process, slot in list(self._dying):
            process.join(timeout_s)
            if process.exitcode is None:
                continue
            process.close()
            self._dying.remove((process, slot))
            if slot is not None:
                self._slots.give_back(slot)


def _start_s(n_facets: int) -> float:
    return START_S + START_S_PER_FACET * n_facets


def used_s(pid: int) -> float:
    """Processor time that a process has used [s], infinite where the system does not say.

    Source: clock_getcpuclockid(3), whose clock of a process Linux numbers so (linux/posix-timers.h).
    """
    try:
        return time.clock_gettime(~pid << 3 | _CPUCLOCK_SCHED)
    except OSError:
        return math.inf


def is_stopped(pid: int) -> bool:
    """Whether a process is stopped by a signal or a debugger. Source: proc_pid_stat(5), field 3."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "Tt"
    except OSError:
        return False
