"""Frames and numbers of a running server, asked by two threads: one watches, one has frames drawn in the background."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from glrender_camera import ConfigError
from glrender_client import Client, GlrenderClientError, Reply, Watched

from . import geometry
from .frame import Frame, shown

log = logging.getLogger(__name__)

_WATCH_S, _STATUS_S, _AGAIN_S = 1.0 / 15.0, 1.0, 1.0
# The server answers `watch` and `status` at once, but for one that draws in its own process.
_TIMEOUT_S, _BACKGROUND_TIMEOUT_S, _LEAVE_S = 5.0, 20.0, 0.5
_MAX_STREAMS = 16
# Tolerance of the free camera's frames [1]: an eye needs no more.
_FREE_ERROR = 0.5

Stream = tuple[str, str]
"""A client and its camera."""


class SceneReplaced(GlrenderClientError):
    """The server has another scene than the frame that is asked about."""


class Source:
    """The page's view of one server, which is asked only while somebody looks.

    Parameters
    ----------
    endpoint : str
    keys : (path, path), optional
        Of a server with CURVE: the client's secret key and the server's.
    password : str
        Of a server that shows its frames to its own view alone.

    Attributes
    ----------
    status : dict
        The last reply to `status`; empty while the server does not answer.
    trouble : str
        Why not; empty if it does.
    not_shown : str
        Camera of the last frame that cannot be shown here, and why; empty if all can.
    frames : dict of stream to Frame
        The newest of each, the newest last.
    streams : list of dict
        The server's streams: client, cameras, number.
    """

    def __init__(self, endpoint: str, keys: Iterable[str | Path] | None = None, password: str = ""):
        self.endpoint, self._keys, self._password = endpoint, keys, password
        self.status: dict[str, Any] = {}
        self.trouble = "the server is being asked"
        self.not_shown = ""
        self.frames: OrderedDict[tuple[str, str, int], Frame] = OrderedDict()
        self.streams: list[dict[str, Any]] = []
        self.seen = {"frames": 0, "over_budget": 0}
        self._number = 0
        self._after: dict[Stream | None, int] = {}
        self._wanted: set[Stream | None] = set()
        self._is_looked_at = False
        self._wake, self._ended = threading.Event(), threading.Event()
        self._draws: SimpleQueue[tuple[Future[Reply], Callable[[Client], Reply]] | None] = SimpleQueue()
        self._drawer: Client | None = None
        self._on_news: Callable[[], None] = lambda: None
        # A server that hangs leaves questions unanswered: the threads then end with the process.
        self._threads = [threading.Thread(target=target, name=target.__name__, daemon=True)
                         for target in (self._watch, self._draw_in_turn)]

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin; `news` is for this loop."""
        self._news = asyncio.Event()
        self._on_news = lambda: loop.call_soon_threadsafe(self.tell_news)
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Ask nothing more."""
        self._on_news = lambda: None
        self._ended.set()
        self._wake.set()
        self._draws.put(None)
        for thread in self._threads:
            thread.join(_LEAVE_S)

    def want(self, is_looked_at: bool, streams: set[Stream | None]) -> None:
        """Say whether pages are open, and from which streams they want a frame now: None is the newest of all."""
        self._is_looked_at, self._wanted = is_looked_at, streams
        if is_looked_at:
            self._wake.set()

    async def news(self) -> None:
        """Wait until another frame has come, or a page wants another stream."""
        await self._news.wait()

    def tell_news(self) -> None:
        """Wake who waits for `news`."""
        self._news.set()
        self._news = asyncio.Event()

    def newest(self, stream: Stream | None, after: int = 0) -> Frame | None:
        """The newest frame of a stream that is newer than the one with this number."""
        for frame in reversed(self.frames.values()):
            if frame.number > after and stream in (None, frame.stream[:2]):
                return frame
        return None

    def numbered(self, number: int) -> Frame | None:
        """The frame with this number, if it is still the newest of its stream."""
        return next((frame for frame in self.frames.values() if frame.number == number), None)

    # The thread that watches.

    def _watch(self) -> None:
        while not self._ended.is_set():
            if not self._is_looked_at:
                self._wake.wait()
                self._wake.clear()
                continue
            try:
                with self._client(_TIMEOUT_S) as client:
                    self._follow(client)
            except Exception as error:
                if not isinstance(error, GlrenderClientError):
                    log.exception("the server could not be watched")
                self.status, self.trouble = {}, str(error)
                self._on_news()
                self._ended.wait(_AGAIN_S)

    def _client(self, timeout_s: float) -> Client:
        key, server_key = self._keys or (None, None)
        return Client(self.endpoint, timeout_s=timeout_s, retries=0, key=key, server_key=server_key,
                      shared_memory=True)

    def _follow(self, client: Client) -> None:
        asked_at, self.not_shown = -1e9, ""
        while self._is_looked_at and not self._ended.is_set():
            began = time.monotonic()
            if began - asked_at > _STATUS_S:
                self.status, self.trouble, asked_at = client.status(), "", began
            for stream in list(self._wanted):
                (of_client, camera), after = stream or (None, None), self._after.get(stream, 0)
                watched = client.watch(after, of_client=of_client, camera=camera, password=self._password)
                # Cameras and bodies are those of the frame: another scene, or another server, has its own.
                if watched.generation != self.status.get("generation", 0) or watched.number < after:
                    self.status, asked_at = client.status(), began
                self.streams = watched.streams
                if watched.reply is not None:
                    self._after[stream] = watched.number
                    self._take(watched)
                    self._on_news()
            self._ended.wait(max(0.0, _WATCH_S - (time.monotonic() - began)))

    def _take(self, watched: Watched) -> None:
        if watched.generation != self.status.get("generation", 0):
            return  # a third scene came between: its frames come next
        replies = watched.reply.frames or (watched.reply,)
        counts: dict[str, int] = {}
        frames = self.frames.copy()  # the other thread reads them
        for reply in replies:
            name = reply.header["camera"]
            index = counts[name] = counts.get(name, -1) + 1
            try:
                frame = self._frame(watched, reply, index)
            except ConfigError as error:
                # A stream, and no codec here: frames that are none are shown on.
                self.not_shown = f"camera {name!r}: {error}"
                continue
            frames.pop(frame.stream, None)
            frames[frame.stream] = frame
            plan = reply.header["plan"]
            self.seen["frames"] += 1
            self.seen["over_budget"] += bool(plan["missed"])
        while len(frames) > _MAX_STREAMS:
            frames.popitem(last=False)
        self.frames = frames

    def _frame(self, watched: Watched, reply: Reply, index: int) -> Frame:
        camera = self._camera(reply.header["camera"])
        self._number += 1
        header, pixels = shown(reply.header, reply.pixels)
        return Frame(number=self._number, stream=(watched.client, camera["name"], index), header=header,
                     request=watched.request, pixels=pixels, camera=camera, bodies=self.status["bodies"],
                     generation=watched.generation)

    def _camera(self, name: str) -> Mapping[str, Any] | None:
        return next((camera for camera in self.status.get("cameras", ()) if camera["name"] == name), None)

    # The thread that has frames drawn.

    async def pixel(self, frame: Frame, x: int, y: int) -> dict[str, Any]:
        """Irradiance, range and angles at one pixel of the camera's image, drawn for the state of a frame.

        Returns
        -------
        dict
            `irradiance_W_m2`, `range_m`, `incidence_deg`, `emission_deg`, `phase_deg`, `body`; `trouble` if it cannot
            be drawn now. Where no body is, None.
        """
        if self.trouble:
            return {"trouble": self.trouble}
        products = ["range", "body_id", "incidence", "emission", "phase"]
        asked = self._asked(frame)
        try:
            reply = await self._draw(frame.generation, frame.request["state"], frame.camera["name"],
                                     products=products, roi=(x, y, x + 1, y + 1), max_error=asked.get("max_error"),
                                     samples=asked.get("samples"))
        except Exception as error:
            return {"trouble": _told(error)}
        at = {name: array[0, 0].item() for name, array in reply.arrays.items()}
        body = at["body_id"]
        degrees = {f"{name}_deg": float(np.degrees(at[name])) for name in ("incidence", "emission", "phase")}
        return {"irradiance_W_m2": at["image"], "range_m": at["range"], **degrees,
                "body": frame.bodies[body]["name"] if 0 <= body < len(frame.bodies) else None}

    def _asked(self, frame: Frame) -> Mapping[str, Any]:
        """The request's fields of a frame: its own, or its entry of `frames`."""
        entries = frame.request.get("frames")
        if not entries:
            return frame.request
        of_camera = [entry for entry in entries if entry.get("camera", frame.stream[1]) == frame.stream[1]]
        return of_camera[min(frame.stream[2], len(of_camera) - 1)]

    async def free(self, camera_name: str, body_name: str, azimuth_deg: float, elevation_deg: float, range_m: float,
                   like: Frame | None) -> Frame | str:
        """A frame of the camera that is moved by hand, at the epoch of another frame; or why there is none."""
        status = self.status
        camera, generation, bodies = self._camera(camera_name), status.get("generation", 0), status.get("bodies", [])
        body = next((body for body in bodies if body["name"] == body_name), None)
        if camera is None or body is None:
            return self.trouble or "the scene was replaced"
        has_same = like is not None and {body["name"] for body in bodies} == set(like.request["state"]["bodies"])
        state = geometry.free_state(like.request["state"] if has_same else geometry.default_state(bodies), camera, body,
                                    azimuth_deg, elevation_deg, range_m)
        try:
            reply = await self._draw(generation, state, camera_name, max_error=_FREE_ERROR, samples=1)
        except Exception as error:
            return _told(error)
        return Frame(number=0, stream=("free camera", camera_name, 0), header=reply.header, request={"state": state},
                     pixels=np.array(reply.pixels, order="C"), camera=camera, bodies=bodies, kind="free")

    async def _draw(self, generation: int, *arguments: Any, **options: Any) -> Reply:
        """A frame of the scene with this number."""
        def draw(client: Client) -> Reply:
            if client.status().get("generation", 0) != generation:
                raise SceneReplaced("the scene was replaced since")
            return client.render(*arguments, background=True, **options)

        future: Future[Reply] = Future()
        self._draws.put((future, draw))
        return await asyncio.wrap_future(future)

    def _draw_in_turn(self) -> None:
        for future, draw in iter(self._draws.get, None):
            if future.set_running_or_notify_cancel():  # else its page is closed
                try:
                    self._drawer = self._drawer or self._client(_BACKGROUND_TIMEOUT_S)
                    future.set_result(draw(self._drawer))
                except Exception as error:
                    future.set_exception(error)
            del future  # and with it the server's memory, where the frame is
        if self._drawer is not None:
            self._drawer.close()


def _told(error: Exception) -> str:
    if not isinstance(error, GlrenderClientError):
        log.error("a frame of the background failed", exc_info=error)
    return str(error)
