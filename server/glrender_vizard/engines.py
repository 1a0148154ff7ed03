"""A renderer for each scene: simulations bring their own, and none waits while another's is opened."""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import zmq
from glrender import GlrenderError
from glrender_server.job import Job
from glrender_server.workers import WorkerPool

from .limits import LEAST_WORKER_BYTES, MAX_SCENES

log = logging.getLogger(__name__)

# A scene that cannot be opened is tried again after so long: somebody may have brought its file.
_AGAIN_S = 10.0
# One that nobody has used for so long since it was opened, nobody waits for.
_UNUSED_S = 10.0
_JOIN_S = 5.0


def memory_shares(all_bytes: int, n_workers: int, given_bytes: int | None = None) -> tuple[int, int]:
    """Scenes that may be open together, and the data that each process may have [bytes].

    Parameters
    ----------
    all_bytes : int
        Of the processes of all scenes together.
    n_workers : int
        Processes of each scene.
    given_bytes : int, optional
        Of each process, if it is given: fewer scenes are open for it. Otherwise an even share.
    """
    least = LEAST_WORKER_BYTES if given_bytes is None else given_bytes
    n_scenes = max(1, min(MAX_SCENES, all_bytes // (n_workers * least)))
    return n_scenes, all_bytes // (n_workers * n_scenes) if given_bytes is None else given_bytes


class _Place:
    """A scene that is being opened in a thread of its own, is open, or has failed."""

    def __init__(self, make: Callable[[], WorkerPool]):
        self.engine: WorkerPool | None = None
        self.error, self.ended = "", 0.0
        self.is_watched = self.is_used = False
        self.thread = threading.Thread(target=self._open, args=(make,), daemon=True, name="glrender-vizard-scene")
        self.thread.start()

    def _open(self, make: Callable[[], WorkerPool]) -> None:
        try:
            self.engine = make()
        except GlrenderError as error:
            self.error = str(error)
        except Exception:
            log.exception("a scene cannot be opened")
            self.error = "the adapter failed on this scene; its log has the traceback"
        self.ended = time.monotonic()

    @property
    def is_opening(self) -> bool:
        return self.thread.is_alive()

    @property
    def is_idle(self) -> bool:
        return not self.is_opening and (self.engine is None or self.engine.is_idle)

    @property
    def may_go(self) -> bool:
        """Whether nobody waits for it: who had it opened comes soon, or not at all."""
        return self.is_idle and (self.is_used or time.monotonic() - self.ended > _UNUSED_S)


class Engines:
    """Opens an engine for a scene when it is first asked for, and closes the longest unused beyond so many.

    Parameters
    ----------
    make : callable
        From a scene's key to its engine; called in a thread of its own, may raise GlrenderError.
    max_scenes : int
    """

    def __init__(self, make: Callable[[Hashable], WorkerPool], max_scenes: int = MAX_SCENES):
        self._make, self._max_scenes = make, max_scenes
        self._places: OrderedDict[Hashable, _Place] = OrderedDict()
        self._closing: list[threading.Thread] = []
        self._poller: zmq.Poller | None = None

    def has_room(self, key: Hashable, job: Job) -> bool:
        """Whether a job would be begun, or refused, at once; its scene is opened if it is not."""
        place = self._places.get(key)
        if place is not None and place.error and time.monotonic() - place.ended > _AGAIN_S:
            del self._places[key]
            place = None
        if place is None:
            if not self._make_room():
                return False
            self._places[key] = _Place(lambda: self._make(key))
            return False
        self._places.move_to_end(key)
        if place.is_opening:
            return False
        return place.engine is None or bool(place.engine.outage) or place.engine.has_room(job)

    def start(self, key: Hashable, job: Job) -> str:
        """Begin a job for which there is room; why it cannot be, if it cannot."""
        place = self._places[key]
        place.is_used = True
        if place.engine is None:
            return place.error
        if place.engine.outage:
            return place.engine.outage
        place.engine.start(job)
        return ""

    @property
    def is_idle(self) -> bool:
        """Whether no job is under way."""
        return all(place.is_idle for place in self._places.values())

    def watch(self, poller: zmq.Poller) -> None:
        """Register what wakes the loop, now and later."""
        self._poller = poller

    def turn(self, ready: dict[Any, int]) -> None:
        """Take in finished jobs."""
        for place in self._places.values():
            if place.is_opening or place.engine is None:
                continue
            if not place.is_watched and self._poller is not None:
                place.engine.watch(self._poller)
                place.is_watched = True
            place.engine.turn(ready)

    def close(self) -> None:
        """Close every engine."""
        for place in self._places.values():
            place.thread.join(_JOIN_S)
            if place.engine is not None:
                place.engine.close()
        self._places.clear()
        for thread in self._closing:
            thread.join(_JOIN_S)

    def _make_room(self) -> bool:
        """Whether another may be opened; else the longest unused is closed, outside the loop, as that takes time."""
        self._closing = [thread for thread in self._closing if thread.is_alive()]
        while len(self._places) + len(self._closing) >= self._max_scenes:
            idle = next((key for key, place in self._places.items() if place.may_go), None)
            if self._closing or idle is None:
                return False
            engine = self._places.pop(idle).engine
            if engine is not None:
                engine.end()
                self._closing.append(threading.Thread(target=engine.close, daemon=True, name="glrender-vizard-close"))
                self._closing[-1].start()
        return True
