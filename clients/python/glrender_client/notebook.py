"""Views of a frame and of a client in a notebook."""

from __future__ import annotations

import html
import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

LARGEST_PX = 512
"""Longer side of a picture; larger images are shown by every n-th pixel."""


def png(image: np.ndarray) -> bytes:
    """An 8-bit grey PNG of a (height, width) image, black at zero, white at its 99.9th percentile; NaN is black."""
    step = -(-max(image.shape) // LARGEST_PX)
    part = np.nan_to_num(np.asarray(image[::step, ::step], np.float64), nan=0.0)
    white = np.percentile(part, 99.9) or part.max() or 1.0
    grey = np.clip(255.0 * part / white, 0.0, 255.0).astype(np.uint8)
    height, width = grey.shape
    rows = np.hstack([np.zeros((height, 1), np.uint8), grey])  # each row begins with its filter, 0: none
    return b"\x89PNG\r\n\x1a\n" + b"".join([
        _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
        _chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)), _chunk(b"IEND", b"")])


def described(title: str, hello: Mapping[str, Any] | None) -> str:
    """HTML: a title, and the cameras and bodies that the server told of, if it was asked."""
    text = f"<b>{html.escape(title)}</b>"
    if hello is None:
        return text
    rows = [("OpenGL", hello["gl_renderer"])]
    rows += [("camera", f"{camera['name']}: {camera['width_px']} x {camera['height_px']} px")
             for camera in hello["cameras"]]
    rows += [("body", f"{body['name']}: {body['n_facets']} facets, {body['law']}") for body in hello["bodies"]]
    cells = "".join(f"<tr><td>{kind}</td><td>{html.escape(value)}</td></tr>" for kind, value in rows)
    return f"{text}<table>{cells}</table>"


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
