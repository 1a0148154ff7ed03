"""One frame for the page: a small header and the pixels as they were sent to the client."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from glrender_camera.compression import decode

from .geometry import sketch

_TOLD = ("t_s", "output", "unit", "exposure_s", "seed", "n_saturated_px", "plan", "stages", "warnings", "timings_ms",
         "next_exposure_s")
# Pixels begin at a multiple of so many bytes, as typed arrays need.
_ALIGNMENT = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A frame of one client's camera, or of the free camera.

    Attributes
    ----------
    number : int
        Counted by the view.
    stream : tuple of (str, str, int)
        Client, camera, and which of this camera's frames of one request.
    header : dict
        Of the reply.
    request : dict
        The client's; its `state` is what the frame shows.
    pixels : (height, width) array, row-major
        A copy: the server may use its memory again.
    camera : dict
        As `hello` describes it.
    bodies : list of dict
        Likewise.
    generation : int
        Number of the scene, as the server counts them.
    """

    number: int
    stream: tuple[str, str, int]
    header: Mapping[str, Any]
    request: Mapping[str, Any]
    pixels: np.ndarray
    camera: Mapping[str, Any]
    bodies: list[Mapping[str, Any]] = field(default_factory=list)
    generation: int = 0
    kind: str = "frame"

    @cached_property
    def roi_origin_px(self) -> tuple[int, int]:
        """Place of the first pixel in the camera's image."""
        return tuple((self.header.get("roi") or (0, 0))[:2])

    @cached_property
    def message(self) -> bytes:
        """The message to every page: u32 size of the head, the head (JSON), the pixels; made once."""
        height, width = self.pixels.shape
        head = {"kind": self.kind, "number": self.number, "stream": self.stream, "dtype": self.pixels.dtype.name,
                "width": width, "height": height, "origin": self.roi_origin_px, "camera": self.camera,
                "geometry": sketch(self.request["state"], self.camera, self.bodies),
                **{name: self.header[name] for name in _TOLD if name in self.header}}
        text = json.dumps(finite(head), separators=(",", ":")).encode()
        text += b" " * (-(len(text) + 4) % _ALIGNMENT)
        return b"".join([struct.pack("<I", len(text)), text, self.pixels.data.cast("B")])


def shown(header: Mapping[str, Any], pixels: np.ndarray) -> tuple[Mapping[str, Any], np.ndarray]:
    """A copy of a reply's pixels, with its header; of a compressed one, of the digital numbers that are decoded."""
    if header.get("output") != "compressed":
        return header, np.array(pixels, order="C")
    dn = decode(pixels, header["codec"], tuple(header["shape"]), header["bit_depth"])
    return {**header, "output": "dn", "unit": "DN"}, dn


def finite(value: Any) -> Any:
    """Plain data without NaN and infinities, which JSON does not have: they are null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value
