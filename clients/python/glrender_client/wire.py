"""Messages as docs/protocol.md writes them down: requests packed, replies read."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import msgpack
import numpy as np

from .errors import Busy, ServerError
from .notebook import png

PROTOCOL_VERSION = 1
_OF_A_SCENE = ("render", "range")
MAX_COMPARE_BYTES = 1_000_000
"""Pixels of a frame that is compared [byte]: a request's header may have 1 MiB, with its state."""
# Largest number of a frame that is compared [DN], as the server takes it.
_FULL_DN = 1e9
# Outputs with noise, which a seed belongs to.
_NOISY = ("dn", "compressed")


class FrameWarning(NamedTuple):
    """A warning of a frame that was made nevertheless: its kind, the field to look at, and a sentence."""

    code: str
    path: str
    message: str

    def __str__(self) -> str:
        return self.message


class Comparison(NamedTuple):
    """A frame against the predicted one: the normal equations of the fit of K parameters.

    ``numpy.linalg.solve(matrix, vector)`` is the step that best explains the frame; a parameter that is known is left
    out with its row and column. `names` and `units` are the parameters' and those of ``gain`` and ``offset``, `matrix`
    is J^T W J (K, K), `vector` J^T W r (K,), `chi2` r^T W r over `n_pixels` that count, all with the best `gain` and
    `offset_DN` at the state that was sent.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    matrix: np.ndarray
    vector: np.ndarray
    chi2: float
    n_pixels: int
    gain: float
    offset_DN: float


class HasDict(Protocol):
    """A `glrender.State`, or another object with its `to_dict`."""

    def to_dict(self) -> dict[str, Any]: ...


@dataclass(frozen=True, eq=False)
class Reply:
    """A rendered frame, or laser ranges.

    Attributes
    ----------
    header : dict
        `plan`, `timings_ms`, `t_s`, `unit`, and for digital numbers `exposure_s`, `seed`, `stages`, and
        `faults`, where each is, if any was asked for.
    arrays : dict of str to array
        ``image`` and the products asked for; of ranges ``range``, ``body_id``, ``facet_id``,
        ``beam_incidence``. Read-only, without a copy of what came.
    frames : tuple of Reply
        Replies to a request for several frames, one for each, in their order; this reply itself has no arrays then.
    """

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]
    frames: tuple[Reply, ...] = ()

    @property
    def pixels(self) -> np.ndarray:
        """The image, (height, width), row 0 on top; of output "compressed" the stream, (N) uint8."""
        return self.arrays["image"]

    @property
    def comparison(self) -> Comparison:
        """The answer to `compare`."""
        told = self.header["comparison"]
        # Fields that a newer server adds are passed over.
        return Comparison(tuple(told["names"]), tuple(told["units"]), np.array(told["matrix"], float),
                          np.array(told["vector"], float), *(told[name] for name in Comparison._fields[4:]))

    @property
    def warnings(self) -> tuple[FrameWarning, ...]:
        """Warnings of the frame, or of any of several: nothing in view, saturation (docs/protocol.md)."""
        return (*self._told("warnings"), *(warning for frame in self.frames for warning in frame.warnings))

    @property
    def notes(self) -> tuple[FrameWarning, ...]:
        """Notes of the frame, or of any of several: the exposure that "auto" chose."""
        return (*self._told("notes"), *(note for frame in self.frames for note in frame.notes))

    def _told(self, name: str) -> list[FrameWarning]:
        return [FrameWarning(each["code"], each["path"], each["message"]) for each in self.header.get(name, ())]

    def __repr__(self) -> str:
        header = self.header
        total = header.get("timings_ms", {}).get("total", float("nan"))
        if "image" not in self.arrays:
            return f"<Reply {header.get('op')} t={header.get('t_s')} s: {total:.1f} ms, arrays {sorted(self.arrays)}>"
        image = self.pixels
        products = sorted(set(self.arrays) - {"image"})
        size = " x ".join(map(str, image.shape[1::-1]))
        return (f"<Reply {header.get('camera')} t={header.get('t_s')} s: {size} "
                f"{image.dtype} [{header.get('unit')}], {total:.1f} ms, products {products}>")

    def _repr_png_(self) -> bytes | None:
        """For notebooks: the image in grey; a stream has none."""
        return png(self.pixels) if "image" in self.arrays and self.pixels.ndim == 2 else None


class Watched(NamedTuple):
    """The newest frame that a server has drawn for anyone, and the streams of frames that it has.

    `streams` is a list of ``{"client", "cameras", "number"}``; `generation` counts the scenes that the server has had,
    as `status` does, and all frames are of the newest; `client`, `request` (the header of that client's
    request, with its state) and `reply` are those of the newest frame, or empty and None where it is not newer than
    the one before.
    """

    number: int
    streams: list[dict[str, Any]]
    client: str = ""
    request: dict[str, Any] = {}
    reply: Reply | None = None
    generation: int = 0


class Packer:
    """Numbers and packs the requests of one client, whose name no other has.

    Attributes
    ----------
    scene : str or None
        Digest of the scene that the client has loaded: no frame of another is to come in its place.
    """

    def __init__(self):
        self.name, self._next_id = f"python-{os.getpid()}-{uuid.uuid4().hex[:12]}", 1
        self.scene: str | None = None
        self._n_noisy = 0

    def __call__(self, op: str, fields: Mapping[str, Any]) -> tuple[int, bytes]:
        """The request's number and its header."""
        number, self._next_id = self._next_id, self._next_id + 1
        if self.scene is not None and op in _OF_A_SCENE:
            fields = {"scene": self.scene, **fields}
        if op == "render":
            fields = self.seeded(fields)
        return number, msgpack.packb({"v": PROTOCOL_VERSION, "op": op, "id": number, "client": self.name, **fields},
                                     default=_plain)

    def seeded(self, fields: Mapping[str, Any]) -> dict[str, Any]:
        """The fields of a `render` request, in which each frame with noise has a seed.

        One without is given the number of the client's frames without a seed before it, so that noise moves from frame
        to frame, and a program that runs anew gets the same.
        """
        if "frames" in fields:
            return {**fields, "frames": [self.seeded(frame) for frame in fields["frames"]]}
        if fields.get("output") not in _NOISY or "seed" in fields:
            return dict(fields)
        seed, self._n_noisy = self._n_noisy, self._n_noisy + 1
        return {**fields, "seed": seed}


def frame_fields(camera: str | None = None, *, output: str = "irradiance", exposure_s: float | str | None = None,
                 seed: int | None = None, max_error: float | Mapping[str, float] | None = None,
                 samples: int | None = None, products: Sequence[str] = (), roi: Sequence[int] | None = None,
                 faults: Sequence[Mapping[str, Any]] | None = None, deadline_s: float | None = None,
                 compare: np.ndarray | None = None, derivatives: Sequence[str] | None = None,
                 unknown: Sequence[str] | None = None, blur_px: float = 0.0, robust: bool = False) -> dict[str, Any]:
    """The fields of one frame; the arguments are those of `Client.render`."""
    optional = {"camera": camera, "exposure_s": exposure_s, "seed": seed, "max_error": max_error, "samples": samples,
                "products": list(products) or None, "roi": None if roi is None else list(roi),
                "faults": None if faults is None else list(faults), "deadline_s": deadline_s,
                "derivatives": None if derivatives is None else list(derivatives),
                "unknown": None if unknown is None else list(unknown)}
    given = {name: value for name, value in optional.items() if value is not None}
    how = {"blur_px": blur_px, "robust": robust}
    how = {name: value for name, value in how.items() if value is not False and value != 0.0}
    if compare is None:
        for name, value in how.items():
            raise ValueError(f"{name} belongs to compare, got {value!r}: give the frame, or leave it out")
        return {"output": output, **given}
    if output not in ("irradiance", "dn"):  # which the server refuses
        given["output"] = output
    return {**given, "compare": {**_packed(compare), **how}}


def _packed(frame: np.ndarray) -> dict[str, Any]:
    """A frame as `compare` has it: full, which does not count, where it is masked."""
    if isinstance(frame, np.ma.MaskedArray):
        # Its value is above the camera's bits.
        dtype = np.dtype(np.uint16) if frame.dtype == np.uint8 else frame.dtype
        frame = np.ma.filled(frame.astype(dtype), np.iinfo(dtype).max if dtype.kind in "ui" else _FULL_DN)
    frame = np.asarray(frame)
    if frame.nbytes > MAX_COMPARE_BYTES:
        raise ValueError(f"compare must have at most {MAX_COMPARE_BYTES} bytes, got {frame.nbytes}: give a region of "
                         "the frame, and roi, where it is; or the camera's uint8 or uint16")
    return {"pixels": frame.astype(frame.dtype.newbyteorder("<"), copy=False).tobytes(), "dtype": frame.dtype.name,
            "shape": list(frame.shape)}


def render_fields(state: Mapping[str, Any] | HasDict, camera: str | None = None, *, order: str = "C",
                  backend: str | None = None, background: bool = False, **options: Any) -> dict[str, Any]:
    """The fields of a `render` request; the arguments are those of `Client.render`."""
    return {"state": state, "order": order, **_named(backend), **({"background": True} if background else {}),
            **frame_fields(camera, **options)}


def frames_fields(state: Mapping[str, Any] | HasDict, frames: Iterable[Mapping[str, Any]], order: str = "C",
                  backend: str | None = None) -> dict[str, Any]:
    """The fields of a `render` request for several frames; the arguments are those of `Client.render_frames`."""
    return {"state": state, "order": order, **_named(backend), "frames": [frame_fields(**frame) for frame in frames]}


def _named(backend: str | None) -> dict[str, str]:
    return {} if backend is None else {"backend": backend}


def range_fields(state: Mapping[str, Any] | HasDict, directions_camera: Any, camera: str | None = None,
                 noise: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The fields of a `range` request; the arguments are those of `Client.range`."""
    optional = {"camera": camera, "noise": noise}
    return {"state": state, "directions_camera": directions_camera,
            **{name: value for name, value in optional.items() if value is not None}}


def read_watched(reply: Reply) -> Watched:
    """A reply to `watch`, taken apart."""
    told = reply.header
    if not reply.frames:
        return Watched(told["number"], told["streams"], generation=told.get("generation", 0))
    return Watched(told["number"], told["streams"], told["of_client"], read_header(told["request"]), reply.frames[0],
                   told.get("generation", 0))


def read_header(part: Any) -> dict[str, Any]:
    """The header of a reply."""
    return msgpack.unpackb(part)


def read_reply(header: dict[str, Any], parts: Sequence[Any]) -> Reply:
    """The reply of these parts (bytes-like, the header first); its arrays are views into the parts.

    Raises
    ------
    ServerError
        The server refused the request.
    """
    if not header.get("ok"):
        error = header.get("error", {})
        told = error.get("code", ""), error.get("path", ""), error.get("message", "")
        raise Busy(*told, error.get("retry_after_s", 0.05)) if told[0] == "busy" else ServerError(*told)
    if header.get("op") == "watch" and "reply" in header:
        # Another's reply, whose header describes the parts.
        return Reply(header, {}, (read_reply(read_header(header["reply"]), parts),))
    own: dict[str, np.ndarray] = {}
    of_frames: list[dict[str, np.ndarray]] = [{} for _ in header.get("frames", ())]
    for entry in header.get("arrays", []):
        flat = np.frombuffer(parts[entry["part"]], np.dtype(entry["dtype"]).newbyteorder("<"))
        arrays = of_frames[entry["frame"]] if "frame" in entry else own
        arrays[entry["name"]] = flat.reshape(entry["shape"], order=entry["order"])
    common = {name: value for name, value in header.items() if name not in ("frames", "arrays")}
    return Reply(header, own, tuple(Reply({**common, **fields}, arrays) for fields, arrays in zip(
        header.get("frames", ()), of_frames, strict=True)))


def _plain(value: object) -> object:
    """NumPy numbers and arrays, and objects with `to_dict`, as the lists, numbers and maps of the wire."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, int):
        raise ValueError(f"integers must be between -2^63 and 2^64 - 1, got {value}")
    raise TypeError(f"{type(value).__name__} cannot be sent; give numbers, text, lists, dictionaries, NumPy arrays, or "
                    "what has `to_dict`, as a State does")
