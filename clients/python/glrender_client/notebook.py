"""Views of a frame and of a client in a notebook, and a stretch to set by hand."""

from __future__ import annotations

import base64
import html
import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

LARGEST_PX = 512
"""Longer side of a picture; larger images are shown by every n-th pixel."""


STRETCHES = {"linear": lambda grey: grey, "gamma": lambda grey: grey ** (1.0 / 2.2),
             "log": lambda grey: np.log10(1.0 + 1000.0 * grey) / np.log10(1001.0),
             "asinh": lambda grey: np.arcsinh(100.0 * grey) / np.arcsinh(100.0)}
"""Shares of white [1] to grey [1]: linear, gamma 2.2, three decades of a logarithm, linear to a hundredth of white."""


def png(image: np.ndarray, stretch: str = "linear", white: float | None = None) -> bytes:
    """An 8-bit grey PNG of an image for the eye.

    Parameters
    ----------
    image : (height, width) array
        Black at zero, of integers at the least, which is the detector's offset; NaN is black.
    stretch : "linear", "gamma", "log" or "asinh"
    white : float, optional
        Value from which pixels are white; the 99.9th percentile by default.
    """
    step = -(-max(image.shape) // LARGEST_PX)
    part = np.nan_to_num(np.asarray(image[::step, ::step], np.float64), nan=0.0)
    black = part.min() if np.issubdtype(image.dtype, np.integer) else 0.0
    part -= black
    white = white - black if white and white > black else np.percentile(part, 99.9) or part.max() or 1.0
    grey = (255.0 * STRETCHES[stretch](np.clip(part / white, 0.0, 1.0))).astype(np.uint8)
    height, width = grey.shape
    rows = np.hstack([np.zeros((height, 1), np.uint8), grey])  # each row begins with its filter, 0: none
    return b"\x89PNG\r\n\x1a\n" + b"".join([
        _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
        _chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)), _chunk(b"IEND", b"")])


def described(title: str, hello: Mapping[str, Any] | None) -> str:
    """HTML: a title, and the cameras and bodies that the server named, if it was asked."""
    text = f"<b>{html.escape(title)}</b>"
    if hello is None:
        return text
    rows = [("OpenGL", hello["gl_renderer"])]
    rows += [("camera", f"{camera['name']}: {camera['width_px']} x {camera['height_px']} px")
             for camera in hello["cameras"]]
    rows += [("body", f"{body['name']}: {body['n_facets']} facets, {body['law']}") for body in hello["bodies"]]
    cells = "".join(f"<tr><td>{kind}</td><td>{html.escape(value)}</td></tr>" for kind, value in rows)
    return f"{text}<table>{cells}</table>"


def stretched(frame: Any) -> Any:
    """An ipywidgets box in which a frame's stretch and white level are set by hand; black is its least value.

    Parameters
    ----------
    frame : Reply, glrender.Image, glrender.Capture, or (height, width) array

    Raises
    ------
    ModuleNotFoundError
        Without ipywidgets: `pip install 'glrender[notebook]'`.
    """
    import ipywidgets as widgets

    image = np.nan_to_num(np.asarray(_pixels(frame), np.float64), nan=0.0)
    image -= image.min()
    brightest = image.max() or 1.0
    choice = widgets.Dropdown(options=list(STRETCHES), description="stretch")
    share = widgets.FloatLogSlider(value=1.0, min=-3, max=0, step=0.05, description="white", readout_format=".3f")
    picture = widgets.Image(format="png")

    def draw(_change: Any = None) -> None:
        picture.value = png(image, choice.value, share.value * brightest)

    for control in (choice, share):
        control.observe(draw, "value")
    draw()

    class Box(widgets.VBox):
        """A box that is a still picture where no widgets are, as on the page of a stored notebook."""

        def _repr_mimebundle_(self, **kwargs: Any) -> dict[str, Any]:
            return {**super()._repr_mimebundle_(**kwargs), "image/png": base64.b64encode(picture.value).decode()}

    return Box([widgets.HBox([choice, share]), picture])


def _pixels(frame: Any) -> Any:
    """The image of what has one: digital numbers before irradiance."""
    frame = getattr(frame, "frame", None) or frame
    return next((getattr(frame, name) for name in ("pixels", "dn", "irradiance_W_m2") if hasattr(frame, name)), frame)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
