"""Processes that draw: those of this machine, started here."""

from __future__ import annotations

import dataclasses
import logging
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from glrender_camera.validate import integer

from ..base.errors import ConfigError, DeviceError
from ..view.state import State
from .options import FrameOptions

# Tasks that a process has: the one that it works on, and the next.
_TASKS = 2
_MAX_PROCESSES = 256
_log = logging.getLogger(__name__)

Task = tuple[int, Callable[..., Any], tuple]
"""A task's number, its function and the arguments."""


@dataclass(frozen=True)
class Pool:
    """An executor and how to use it.

    Attributes
    ----------
    executor : Executor
    n_processes : callable
        Returns how many there are now.
    watch : callable
        Called where nothing was done for `pause_s`: it may raise.
    given : callable
        Replaces a value by a handle that tasks take, so that the value is sent once.
    deaths : tuple of type
        Exceptions of a task whose process died.
    death : str
        Text of the error after such a death.
    n_tasks : int
        Given to a process at a time.
    """

    executor: Executor
    n_processes: Callable[[], int]
    watch: Callable[[], None] = lambda: None
    pause_s: float | None = None
    given: Callable[[Any], Any] = lambda value: value
    deaths: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    death: str = "a process that draws was killed: was memory short? Take fewer processes"
    n_tasks: int = _TASKS

    def done(self, tasks: Iterator[Task]) -> Iterator[tuple[int, Any]]:
        """Numbers and results of tasks as they are done; few are given out ahead of time.

        Raises
        ------
        The task's own error, and DeviceError where its process died.
        """
        under_way: dict[Future, int] = {}
        while True:
            room = self.n_tasks * max(self.n_processes(), 1)
            while len(under_way) < room and (task := next(tasks, None)) is not None:
                number, function, arguments = task
                under_way[self.executor.submit(function, *arguments)] = number
            if not under_way:
                return
            finished, _ = wait(under_way, timeout=self.pause_s, return_when=FIRST_COMPLETED)
            if not finished:
                self.watch()
            for future in finished:
                number = under_way.pop(future)
                try:
                    result = future.result()
                except self.deaths:
                    raise DeviceError(f"{self.death}; finished work stays: start again") from None
                yield number, result


def checked_processes(n_processes: int | None, name: str = "processes") -> int:
    """How many processes of this machine to take; None and 0 are one for each core.

    Raises
    ------
    ConfigError
    """
    return integer(name, n_processes or 0, 0, _MAX_PROCESSES) or min(os.cpu_count() or 1, _MAX_PROCESSES)


def parted(states: Sequence[State], options: FrameOptions) -> tuple[Sequence[State], Sequence[State | None]]:
    """The states that a process needs at its start, and those that it gets with each frame.

    States with courses are sent at once, with what they have in common; irradiance needs no courses.
    """
    if _has_courses(states, options):
        return states, [None] * len(states)
    return (), [dataclasses.replace(state) for state in states]


def processes_of(states: Sequence[State], options: FrameOptions, n_processes: int | None,
                 is_elsewhere: bool = False) -> int | None:
    """The number of processes; by default (None or 0) one where courses cannot be sent to others.

    Raises
    ------
    ConfigError
        Courses that cannot be sent, where several processes are asked for or they are elsewhere.
    """
    if not _has_courses(states, options) or n_processes == 1 and not is_elsewhere:
        return n_processes
    try:
        sent = pickle.dumps([state.course for state in states])
        # Another process imports a script's functions from its file; a notebook has none.
        if b"__main__" not in sent or hasattr(sys.modules["__main__"], "__file__"):
            return n_processes
        why = "a class or function of a notebook"
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        why = str(error)
    rule = f"the motion of the states cannot be sent to others ({why})"
    hint = "or give functions of a module, no lambdas"
    if is_elsewhere:
        raise ConfigError("pool", f"must be none: {rule}", hint=hint)
    if n_processes:
        raise ConfigError("n_processes", f"must be 1: {rule}", n_processes, hint)
    _log.warning("one process draws: %s; %s", rule, hint)
    return 1


def _has_courses(states: Sequence[State], options: FrameOptions) -> bool:
    """Whether frames depend on courses: irradiance has no motion."""
    return options.is_of_detector and any(state.course is not None for state in states)


@contextmanager
def own_processes(n_processes: int | None, start: Callable[..., None], arguments: tuple,
                  stop: Callable[[], None]) -> Iterator[Pool]:
    """Processes of this machine, as many as it has cores by default; each calls `start` first, and ends with us.

    One process is this one, which calls `stop` at the end.

    Raises
    ------
    ConfigError
    """
    n_processes = checked_processes(n_processes)
    if n_processes == 1:
        try:
            start(*arguments)
            yield Pool(_ThisProcess(), lambda: 1, n_tasks=1)
        finally:
            stop()
        return
    with TemporaryDirectory(prefix="glrender-") as folder:
        # In a file: Python waits for ever for a process that dies before it has read more than a pipe holds.
        file = Path(folder, "start.pickle")
        file.write_bytes(pickle.dumps((start, arguments)))
        executor = ProcessPoolExecutor(n_processes, mp_context=get_context("spawn"), initializer=_begin,
                                       initargs=(file,))
        try:
            yield Pool(executor, lambda: n_processes)
        finally:
            executor.shutdown(cancel_futures=True)


class _ThisProcess(Executor):
    """Runs each task at once."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        done = Future()
        done.set_result(function(*arguments))
        return done


def _begin(file: Path) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    start, arguments = pickle.loads(file.read_bytes())  # noqa: S301 (what `own_processes` wrote, in its own folder)
    start(*arguments)


def _end_with_parent() -> None:
    """A process whose parent was killed would wait for work for ever."""
    connection.wait([parent_process().sentinel])
    os._exit(1)
