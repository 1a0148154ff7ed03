"""A blocking client of the glrender service."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np
import zmq

from .curve import curve_keys, set_curve
from .errors import Busy, GlrenderClientError, RequestTimeout, ServerError

PROTOCOL_VERSION = 1


@dataclass(frozen=True, eq=False)
class Reply:
    """A rendered frame.

    Attributes
    ----------
    header : dict
        `plan`, `timings_ms`, `t_s`, `unit`, and for digital numbers `exposure_s`, `seed`, `stages`.
    arrays : dict of str to array
        ``image`` and the products asked for; read-only, without a copy of what came.
    """

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]

    @property
    def pixels(self) -> np.ndarray:
        """The image, (height, width), row 0 on top."""
        return self.arrays["image"]

    def __repr__(self) -> str:
        image, header = self.pixels, self.header
        total = header.get("timings_ms", {}).get("total", float("nan"))
        products = sorted(set(self.arrays) - {"image"})
        return (f"<Reply {header.get('camera')} t={header.get('t_s')} s: {image.shape[1]} x {image.shape[0]} "
                f"{image.dtype} [{header.get('unit')}], {total:.1f} ms, products {products}>")


class Client:
    """Asks a glrender server for frames; use it from one thread, and not across a fork.

    Parameters
    ----------
    endpoint : str
        ``tcp://127.0.0.1:5555`` or ``ipc:///path``.
    timeout_s : float [s]
        For each try of a request.
    retries : int
        Further tries after a timeout, each over a new connection; the server answers a request
        that it has already done from its last reply, so nothing is drawn twice.
    key, server_key : path, optional
        For a server with CURVE: this client's ``NAME.key_secret`` and the server's ``server.key``.
    """

    def __init__(self, endpoint: str = "tcp://127.0.0.1:5555", *, timeout_s: float = 10.0, retries: int = 2,
                 key: str | os.PathLike[str] | None = None, server_key: str | os.PathLike[str] | None = None):
        if not timeout_s > 0.0:
            raise ValueError(f"timeout_s must be > 0, got {timeout_s!r}")
        if retries < 0:
            raise ValueError(f"retries must be >= 0, got {retries!r}")
        self._endpoint, self._timeout_s, self._retries = endpoint, timeout_s, retries
        self._name, self._next_id = f"python-{os.getpid()}-{uuid.uuid4().hex[:12]}", 1
        self._keys = curve_keys(key, server_key)
        self._context = zmq.Context()
        self._socket: zmq.Socket | None = None

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Client of {self._endpoint}{' (closed)' if self._context.closed else ''}>"

    def close(self) -> None:
        """Say goodbye, if the server listens, and close the connection."""
        if self._context.closed:
            return
        if self._socket is not None:
            try:
                number, message = self._packed("close", {})
                self._try_once(message, number, 0.2)
            except GlrenderClientError:
                pass  # a server that is gone keeps nothing of ours
        self._disconnect()
        self._context.term()

    def hello(self) -> dict[str, Any]:
        """What the server is: protocol versions, cameras, bodies, products, limits, OpenGL."""
        return self._ask("hello", {})[0]

    def status(self) -> dict[str, Any]:
        """How the server does: uptime, requests, errors by code, last timings."""
        return self._ask("status", {})[0]

    def load_scene(self, scene: Mapping[str, Any]) -> dict[str, Any]:
        """Replace the server's scene, for every client; shapes are file names in its shape folder."""
        return self._ask("load_scene", {"scene": dict(scene)})[0]

    def render(self, state: Mapping[str, Any], camera: str | None = None, *, output: str = "irradiance",
               exposure_s: float | str | None = None, seed: int | None = None, max_error: float | None = None,
               samples: int | None = None, products: Sequence[str] = (), order: str = "C") -> Reply:
        """One frame.

        Parameters
        ----------
        state : mapping
            ``{"t_s", "r_sun_inertial_m", "spacecraft": {"r_inertial_m", "q_from_inertial"}, "bodies": {...}}``;
            lists or NumPy arrays.
        camera : str, optional
            Name; the scene's only camera by default.
        output : "irradiance" or "dn"
            float32 W/m2 per pixel, or the detector's digital numbers.
        exposure_s : float or "auto", optional
        seed : int, optional
            Of the noise; the same request and seed give the same bytes.
        max_error : float, optional
            Error budget instead of the scene's.
        samples : int, optional
            Samples along a pixel's side instead of the planner's choice.
        products : sequence of str
            ``range``, ``body_id``, ``facet_id``, ``incidence``, ``emission``, ``phase``, ``r_body``, ``sunlit``.
        order : "C" or "F"
            Order of the bytes on the wire; the arrays are (height, width) either way.

        Raises
        ------
        ServerError
            With `code`, `path` and `message`.
        RequestTimeout
        """
        optional = {"camera": camera, "exposure_s": exposure_s, "seed": seed, "max_error": max_error,
                    "samples": samples}
        fields = {"state": state, "output": output, "products": list(products), "order": order,
                  **{name: value for name, value in optional.items() if value is not None}}
        header, arrays = self._ask("render", fields)
        return Reply(header, arrays)

    def _packed(self, op: str, fields: Mapping[str, Any]) -> tuple[int, bytes]:
        number, self._next_id = self._next_id, self._next_id + 1
        header = {"v": PROTOCOL_VERSION, "op": op, "id": number, "client": self._name, **fields}
        return number, msgpack.packb(header, default=_plain)

    def _ask(self, op: str, fields: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        if self._context.closed:
            raise GlrenderClientError("this client is closed")
        number, message = self._packed(op, fields)
        for _ in range(self._retries + 1):
            found = self._try_once(message, number, self._timeout_s)
            if found is not None:
                return found
            # The request or the reply may be lost with the connection: ask anew over another.
            self._disconnect()
        raise RequestTimeout(f"{self._endpoint} did not answer `{op}` within {self._timeout_s:g} s, "
                             f"{self._retries + 1} times; is glrender-server running there?")

    def _try_once(self, message: bytes, number: int,
                  timeout_s: float) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
        if self._socket is None:
            self._socket = self._context.socket(zmq.DEALER)
            self._socket.set(zmq.LINGER, 0)
            set_curve(self._socket, self._keys)
            self._socket.connect(self._endpoint)
        self._socket.send(message)
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0.0:
            if not self._socket.poll(max(1, int(1e3 * left))):
                break
            parts = self._socket.recv_multipart(copy=False)
            header = msgpack.unpackb(parts[0].buffer)
            if header.get("id") not in (number, 0):
                continue  # the late reply to a request given up before
            if not header.get("ok"):
                error = header.get("error", {})
                kind = Busy if error.get("code") == "busy" else ServerError
                raise kind(error.get("code", ""), error.get("path", ""), error.get("message", ""))
            return header, _arrays(header, parts)
        return None

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _arrays(header: Mapping[str, Any], parts: Sequence[Any]) -> dict[str, np.ndarray]:
    arrays = {}
    for entry in header.get("arrays", []):
        flat = np.frombuffer(parts[entry["part"]].buffer, np.dtype(entry["dtype"]).newbyteorder("<"))
        arrays[entry["name"]] = flat.reshape(entry["shape"], order=entry["order"])
    return arrays


def _plain(value: object) -> object:
    """NumPy numbers and arrays as the lists and numbers of the wire."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be sent")
