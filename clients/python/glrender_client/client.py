"""A blocking client of the glrender service."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from .connection import MAX_POLL_MS, connected, positive_s
from .curve import curve_keys
from .errors import Busy, GlrenderClientError, Patience, RequestTimeout
from .notebook import described
from .owner import Owner
from .pipeline import in_order
from .presence import told_presence
from .recording import Recorder
from .shared import NotShared, SharedFrames
from .wire import (
    HasDict,
    Packer,
    Reply,
    Watched,
    frames_fields,
    range_fields,
    read_header,
    read_reply,
    read_watched,
    render_fields,
)

# Requests above this size are held against the server's limit first: ZeroMQ drops what exceeds it unanswered.
_SURELY_TAKEN_BYTES = 65536
# Frames in a row that could not be read in place; each was drawn twice.
_MAX_NOT_SHARED = 2


class Client:
    """Asks a glrender server for frames. One thread uses it; each process makes its own.

    Parameters
    ----------
    endpoint : str
        ``tcp://127.0.0.1:5555`` or ``ipc:///path``.
    timeout_s : float [s]
        For each try of a request. A server that says `busy` is asked again meanwhile, in pauses that grow.
    retries : int
        Further tries after a timeout, each over a new connection; the server answers a request
        that it has already done from its last reply, so nothing is drawn twice.
    key, server_key : path, optional
        For a server with CURVE: this client's ``NAME.key_secret`` and the server's ``server.key``.
    record : path, optional
        A new file that keeps every request and its reply, for `replay`.
    shared_memory : bool, optional
        Whether frames of `render` and `render_frames` are read in place, in the memory that the server wrote them to;
        by default over ``ipc`` on Linux, but for a recording. That memory is the server's again when the last of a
        reply's arrays is gone. Where it cannot be read, frames come over the socket; after two such in a row, all do.
    """

    def __init__(self, endpoint: str = "tcp://127.0.0.1:5555", *, timeout_s: float = 10.0, retries: int = 2,
                 key: Path | None = None, server_key: Path | None = None, record: Path | None = None,
                 shared_memory: bool | None = None):
        if retries < 0:
            raise ValueError(f"retries must be >= 0, got {retries!r}")
        if shared_memory and record is not None:
            raise ValueError("shared_memory must not be True with `record`: a recording holds the pixels")
        self._endpoint, self._timeout_s, self._retries = endpoint, positive_s(timeout_s), retries
        self._pack, self._owner = Packer(), Owner()
        self._keys = curve_keys(key, server_key)
        self._recorder = None if record is None else Recorder(record)
        if shared_memory is None:
            shared_memory = endpoint.startswith("ipc:") and sys.platform == "linux" and record is None
        self._shared, self._n_not_shared = (SharedFrames() if shared_memory else None), 0
        self._context = zmq.Context()
        self._socket: zmq.Socket | None = None
        self._hello: dict[str, Any] | None = None

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Client of {self._endpoint}{' (closed)' if self._context.closed else ''}>"

    def _repr_html_(self) -> str:
        """For notebooks: its endpoint, and the last reply to `hello`."""
        return described(repr(self)[1:-1], self._hello)

    def close(self) -> None:
        """Say goodbye, if the server listens, and close the connection; in a forked child it does nothing."""
        if not self._owner.is_here or self._context.closed:
            return
        self._owner.check()
        if self._socket is not None:
            try:
                number, message = self._pack("close", {})
                self._try_once(message, number, 0.2)
            except GlrenderClientError:
                pass  # a server that is gone keeps nothing of ours
        self._disconnect()
        self._context.term()
        if self._shared is not None:
            self._shared.close()
        if self._recorder is not None:
            self._recorder.close()

    def hello(self) -> dict[str, Any]:
        """Description of the server: protocol versions, cameras, bodies, products, limits, OpenGL."""
        self._hello = self._ask("hello", {}).header
        return self._hello

    def status(self) -> dict[str, Any]:
        """Counters of the server: uptime, requests, errors by code, last timings."""
        return self._ask("status", {}).header

    def load_scene(self, scene: Mapping[str, Any], *, timeout_s: float | None = None) -> dict[str, Any]:
        """Replace the server's scene, for every client; shapes are file names in its shape folder.

        From then on this client's frames and ranges are of this scene: where the server shows another by then, which
        somebody else has loaded or which it started anew with, they are refused (``scene``) until it is loaded again.

        Parameters
        ----------
        scene : mapping
        timeout_s : float, optional [s]
            For each try's answer instead of this client's: the first time a shape of a million facets takes minutes.
        """
        loaded = self._ask("load_scene", {"scene": dict(scene)}, timeout_s).header
        self._pack.scene = loaded.get("scene")
        return loaded

    def render(self, state: Mapping[str, Any] | HasDict, camera: str | None = None, *, output: str = "irradiance",
               exposure_s: float | str | None = None, seed: int | None = None,
               max_error: float | Mapping[str, float] | None = None, samples: int | None = None,
               products: Sequence[str] = (), roi: Sequence[int] | None = None, order: str = "C",
               backend: str | None = None, background: bool = False,
               faults: Sequence[Mapping[str, Any]] | None = None, deadline_s: float | None = None,
               compare: np.ndarray | None = None, derivatives: Sequence[str] | None = None,
               unknown: Sequence[str] | None = None, blur_px: float = 0.0, robust: bool = False) -> Reply:
        """Ask for one frame, or how a frame differs from it.

        Parameters
        ----------
        state : mapping or State
            ``{"t_s", "r_sun_inertial_m", "spacecraft": {"r_inertial_m", "q_from_inertial"}, "bodies": {...}}``;
            lists or NumPy arrays. Or a `glrender.State`, and any object with its `to_dict`.
        camera : str, optional
            Name; the scene's only camera by default.
        output : "irradiance", "dn" or "compressed"
            float32 W/m2 per pixel, the detector's digital numbers, or the stream that a camera with compression sends:
            uint8, which ``glrender_camera.compression.decode`` reads by the header's `codec`, `shape`, `bit_depth`.
        exposure_s : float or "auto", optional
        seed : int, optional
            Seed of the noise; the same request and seed give the same bytes. By default frames with noise are counted,
            from 0: the reply's header has the seed.
        max_error : float or mapping, optional
            Error tolerance instead of the scene's: RMS, or of each unit that is named out of ``rms``, ``flux``,
            ``centroid_px``, ``limb_px``, ``range``.
        samples : int, optional
            Samples along a pixel's side instead of the planner's choice.
        products : sequence of str
            ``range``, ``body_id``, ``facet_id``, ``incidence``, ``emission``, ``phase``, ``r_body``, ``sunlit``.
        roi : four int [px], optional
            Region of interest x0, y0, x1, y1, one past the last: that part of the very frame, and no more, is sent.
        order : "C" or "F"
            Order of the bytes on the wire; the arrays are (height, width) either way.
        backend : str, optional
            The backend that draws instead of the server's own, "raytrace" or "cycles". It takes seconds or minutes:
            give `timeout_s` of this client as much.
        background : bool
            Whether the frame is drawn only while nobody else waits, and in 0.5 % of the time while others ask.
        faults : sequence of mappings, optional
            With "dn": ``{"kind": "lost_lines", "place": "limb"}``, ..., instead of the camera's own; empty for none.
        deadline_s : float [s], optional
            After this time nothing more of the frame is begun: it is the best so far, and its predicted error holds.
            The reply's `is_late` says whether the frame took longer; the same request may give other bytes.
        compare : (height, width) uint8, uint16, float32 or float64 array [DN], optional
            A frame of the camera, or its region `roi`, of 1 MB at most; masked pixels do not count. It is compared
            with the mean digital numbers of this state and `exposure_s`, and no image is sent: the reply's
            `comparison` has the normal equations.
        derivatives : sequence of str, optional
            With `compare`: the parameters of the fit (docs/derivatives.md); ``spacecraft`` by default.
        unknown : sequence of str, optional
            With `compare`: out of ``gain`` and ``offset``; both by default.
        blur_px : float [px]
            With `compare`: deviation of a Gaussian by which both frames are blurred, to find the state from farther.
        robust : bool
            With `compare`: whether pixels that differ by much more than most weigh less.

        Raises
        ------
        ServerError
            With `code`, `path` and `message`.
        RequestTimeout
        """
        return self._ask_frames(render_fields(
            state, camera, output=output, exposure_s=exposure_s, seed=seed, max_error=max_error, samples=samples,
            products=products, roi=roi, order=order, backend=backend, background=background, faults=faults,
            deadline_s=deadline_s, compare=compare, derivatives=derivatives, unknown=unknown, blur_px=blur_px,
            robust=robust))

    def watch(self, after: int = 0, *, of_client: str | None = None, camera: str | None = None,
              password: str = "") -> Watched:
        """See the newest frame that the server has drawn for anyone, at no cost to whoever asked for it.

        Parameters
        ----------
        after : int
            Number of the last frame that was seen; only a newer one comes.
        of_client, camera : str, optional
            Whose frames, of which camera; everyone's by default.
        password : str
            Password of a server that shows its frames by `--view` alone.

        Raises
        ------
        ServerError
            ``forbidden`` where the server was not started with `--watch`.
        RequestTimeout
        """
        optional = {"of_client": of_client, "camera": camera, "pass": password}
        return read_watched(self._ask_frames(
            {"after": after, **{name: value for name, value in optional.items() if value}}, "watch"))

    def render_frames(self, state: Mapping[str, Any] | HasDict, frames: Iterable[Mapping[str, Any]], *,
                      order: str = "C", backend: str | None = None) -> tuple[Reply, ...]:
        """Several frames of one state in one request: of several cameras, or of one with several settings.

        Parameters
        ----------
        state : mapping or State
        frames : iterable of mappings
            Each the keyword arguments of `render` but `state` and `order`; 15 images and products in all.
        order : "C" or "F"
        backend : str, optional
            As of `render`, for all frames.

        Returns
        -------
        tuple of Reply
            In the order of `frames`.

        Raises
        ------
        ServerError
            One frame that is refused refuses all; the path names it, e.g. ``frames[1].camera``.
        RequestTimeout
        """
        return self._ask_frames(frames_fields(state, frames, order, backend)).frames

    def range(self, state: Mapping[str, Any] | HasDict, directions_camera: Any, camera: str | None = None, *,
              noise: Mapping[str, Any] | None = None) -> Reply:
        """Laser ranges along directions, exact against the facets.

        Parameters
        ----------
        state : mapping or State
        directions_camera : (N, 3) float
            Unit vectors in the camera's frame.
        camera : str, optional
            Whose place and frame; the scene's only camera by default.
        noise : mapping, optional
            The instrument's errors: ``sigma_m``, ``resolution_m``, ``max_range_m``, ``seed``.

        Returns
        -------
        Reply
            Arrays of length N: ``range`` float64 [m], ``body_id``, ``facet_id`` int32, ``beam_incidence`` float64
            [rad]; NaN and -1 where nothing returns.

        Raises
        ------
        ServerError
        RequestTimeout
        """
        return self._ask("range", range_fields(state, directions_camera, camera, noise))

    def render_many(self, requests: Iterable[Mapping[str, Any]], in_flight: int = 4) -> Iterator[Reply]:
        """Frames in the order of their requests, while the server already works on the next.

        Parameters
        ----------
        requests : iterable of mappings
            Each the keyword arguments of `render`: ``{"state": ..., "camera": ..., "seed": ...}``.
        in_flight : int
            Requests sent ahead, 1 to 16.

        Raises
        ------
        ServerError
            In place of the first frame that was refused; no further frame comes.
        RequestTimeout
        """
        if self._context.closed:
            raise GlrenderClientError("this client is closed")
        self._owner.check()
        packed = (self._pack("render", render_fields(**request)) for request in requests)
        return in_order(self, packed, in_flight)

    def _ask_frames(self, fields: Mapping[str, Any], op: str = "render") -> Reply:
        if op == "render":
            # A frame that cannot be read in place is asked for again, and is the same.
            fields = self._pack.seeded(fields)
        if self._shared is not None and self._n_not_shared < _MAX_NOT_SHARED:
            try:
                reply = self._ask(op, {**fields, "shared": True})
                self._n_not_shared = 0
                return reply
            except NotShared:
                self._n_not_shared += 1
        return self._ask(op, fields)

    def _ask(self, op: str, fields: Mapping[str, Any], timeout_s: float | None = None) -> Reply:
        timeout_s = self._timeout_s if timeout_s is None else positive_s(timeout_s)
        if self._context.closed:
            raise GlrenderClientError("this client is closed")
        self._owner.check()
        number, message = self._pack(op, fields)
        if len(message) > _SURELY_TAKEN_BYTES:
            most = (self._hello or self.hello())["limits"]["max_header_bytes"]
            if len(message) > most:
                raise GlrenderClientError(f"a request must have at most {most} bytes, `{op}` has {len(message)}: "
                                          "shapes and textures are file names, not data")
        for _ in range(self._retries + 1):
            found = self._try_while_busy(message, number, timeout_s)
            if found is not None:
                return found
            # The request or the reply may be lost with the connection: ask anew over another.
            self._disconnect()
        raise self._timeout(op, timeout_s)

    def _try_while_busy(self, message: bytes, number: int, timeout_s: float) -> Reply | None:
        """Try a request once; a busy server is asked again later, until the time is over."""
        patience = Patience(timeout_s)
        while True:
            try:
                found = self._try_once(message, number, patience.left_s)
            except Busy as error:
                time.sleep(patience.pause_s(error))
            else:
                if found is None:
                    patience.check()
                return found

    def _timeout(self, op: str, timeout_s: float) -> RequestTimeout:
        return RequestTimeout.after(self._endpoint, op, timeout_s, self._retries + 1,
                                    told_presence(self._endpoint, self._keys))

    def _try_once(self, message: bytes, number: int, timeout_s: float) -> Reply | None:
        self._send(message)
        deadline = time.monotonic() + timeout_s
        while (found := self._receive(deadline)) is not None:
            header, parts = found
            # Any other is the late reply to a request given up before.
            if header.get("id") in (number, 0):
                self._keep(message, parts)
                if "shared" in header and self._shared is not None:
                    parts = [parts[0], *self._shared.parts(header["shared"])]
                return read_reply(header, parts)
        return None

    def _send(self, message: bytes) -> None:
        self._owner.check()
        if self._socket is None:
            self._socket = connected(self._context, self._endpoint, self._keys)
        self._socket.send(message)

    def _receive(self, deadline: float) -> tuple[dict[str, Any], list[Any]] | None:
        """The next reply, whosever it is, or None when the time is over."""
        self._owner.check()
        left = deadline - time.monotonic()
        if left <= 0.0 or self._socket is None or not self._socket.poll(max(1, int(min(1e3 * left, MAX_POLL_MS)))):
            return None
        parts = [frame.buffer for frame in self._socket.recv_multipart(copy=False)]
        return read_header(parts[0]), parts

    def _keep(self, message: bytes, parts: list[Any]) -> None:
        if self._recorder is not None:
            self._recorder.keep(message, parts)

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
