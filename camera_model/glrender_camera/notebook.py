"""Views of images, plans and sequences in a notebook: pictures for the eye, and tables."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable

import cv2
import numpy as np

from .levels import black_and_white

LARGEST_PX = 512
"""Longer side of a picture; larger images are shown smaller, each pixel a mean."""


def png(image: np.ndarray, largest_px: int = LARGEST_PX, offset_DN: float | None = None) -> bytes:
    """An 8-bit grey PNG of a (height, width) image, from the black to the white of `black_and_white`; NaN is black."""
    is_dn = np.asarray(image).dtype.kind in "iu"
    grey: np.ndarray = np.nan_to_num(np.asarray(image, np.float32), nan=0.0)
    height, width = grey.shape
    if (scale := largest_px / max(height, width)) < 1.0:
        grey = cv2.resize(grey, (max(round(width * scale), 1), max(round(height * scale), 1)),
                          interpolation=cv2.INTER_AREA)
    black, white = black_and_white([np.rint(grey).astype(np.int64) if is_dn else grey], offset_DN)
    grey = np.rint(np.clip(255.0 * (grey - black) / (white - black), 0.0, 255.0))
    return cv2.imencode(".png", grey.astype(np.uint8))[1].tobytes()


def table(title: str, rows: Iterable[tuple[str, object]]) -> str:
    """HTML: a title, and rows of a name and a value."""
    cells = "".join(f"<tr><td>{html.escape(name)}</td><td style='text-align:left'>{html.escape(str(value))}</td></tr>"
                    for name, value in rows)
    return f"<b>{html.escape(title)}</b><table>{cells}</table>"


def strip(pictures: Iterable[tuple[str, bytes]]) -> str:
    """HTML: PNGs side by side, each above its name."""
    cells = "".join(
        f"<td style='text-align:center'><img src='data:image/png;base64,{base64.b64encode(data).decode()}'/><br/>"
        f"{html.escape(name)}</td>" for name, data in pictures)
    return f"<table><tr>{cells}</tr></table>"
