"""Images of surfaces: their size before they are unpacked, their grey values, and colours as one linear grey."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from glrender_camera.projection import MAX_IMAGE_PX

from ...base.errors import ShapeError

if TYPE_CHECKING:
    from PIL import Image

MAX_TEXTURE_PX = 2**27
"""Most pixels of a texture, and of all images of a file: 16384 x 8192, 0.5 GiB as float32."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Shares of linear red, green and blue in a grey [1]: ITU-R BT.709."""
REPEATED, HELD, MIRRORED = "repeated", "held", "mirrored"
"""How a texture goes on beyond its edges: again, with its edge, again and turned over."""
# Pillow's formats that are pictures alone: others start programs (EPS) or unpack to any size.
_TEXTURE_FORMATS = ("PNG", "TIFF", "JPEG", "JPEG2000", "BMP", "PPM", "WEBP")


def texture_pixels(path: Path) -> int:
    """Number of pixels in an image file's header; 0 for one that `read_texture` refuses."""
    try:
        with _opened(path) as image:
            return image.width * image.height
    except ShapeError:
        return 0


def read_texture(path: Path) -> np.ndarray:
    """(H, W) float32 [1]: an image's grey value over its full scale.

    Raises
    ------
    ShapeError
    """
    with _opened(path) as image:
        values = np.asarray(image if image.mode in ("L", "I;16", "I", "F") else image.convert("L"))
    return values.astype(np.float32) if values.dtype.kind == "f" else _shares(values)


def image_pixels(data: bytes) -> int:
    """Number of pixels in the header of an image's bytes, which is not too large.

    Raises
    ------
    ShapeError
    """
    with _opened(io.BytesIO(data)) as image:
        return image.width * image.height


def linear_grey(data: bytes, factors: np.ndarray) -> np.ndarray:
    """(H, W) float32 [1]: the grey of an sRGB image whose linear colours are scaled by factors (3,).

    Source: IEC 61966-2-1, sRGB; ITU-R BT.709, luminance.
    """
    weights = LUMINANCE * factors
    with _opened(io.BytesIO(data)) as image:
        if image.mode in ("L", "I;16", "I"):
            return (_linear(_shares(np.asarray(image))) * np.float32(weights.sum())).astype(np.float32)
        colours = np.asarray(image.convert("RGB"))
    shares = _linear(np.arange(256) / 255.0)
    return sum(np.float32(weight) * shares.take(colours[..., k]) for k, weight in enumerate(weights))


def channel_means(data: bytes) -> np.ndarray:
    """Means (3,) [1] of an image's red, green and blue over their full scale, which are no colours but numbers."""
    with _opened(io.BytesIO(data)) as image:
        return np.asarray(image.convert("RGB")).mean(axis=(0, 1)) / 255.0


def laid(texture: np.ndarray, uv: np.ndarray, wraps: tuple[str, str] = (REPEATED, REPEATED)
         ) -> tuple[np.ndarray, np.ndarray]:
    """A texture (H, W) that goes on as far as coordinates (F, 3, 2) of facets need it, and the coordinates for it.

    Where it is drawn, it repeats along u and is held along v: `wraps` says how it goes on along either.

    Raises
    ------
    ShapeError
        It goes on too far.
    """
    u, v, times, n_held = uv[..., 0], uv[..., 1], 1, 0
    if wraps[0] == MIRRORED:
        texture, u = np.concatenate([texture, texture[:, ::-1]], axis=1), 0.5 * u
    if wraps[1] == MIRRORED:
        texture, v = np.concatenate([texture[::-1], texture]), 0.5 * v
    (height, width), n_pixels = texture.shape, texture.size
    if wraps[0] == HELD:
        n_held = 1 + math.ceil(width * max(-float(u.min()), float(u.max()) - 1.0, 0.0))
        u = (width * u + n_held) / (width + 2 * n_held)
    if wraps[1] != HELD:
        least, most = v.min(axis=1, keepdims=True), v.max(axis=1, keepdims=True)
        v = np.where((least >= 0.0) & (most <= 1.0), v, v - np.floor(least))
        times = max(math.ceil(v.max()), 1)
        v = v / times
    if times * height * (width + 2 * n_held) > MAX_TEXTURE_PX:
        raise ShapeError("texture coordinates", f"must repeat an image of {n_pixels} pixels at most "
                         f"{MAX_TEXTURE_PX // n_pixels} times within a facet", max(times, 1 + 2 * n_held // width),
                         "divide the facet")
    texture = np.pad(np.tile(texture, (times, 1)), ((0, 0), (n_held, n_held)), "edge")
    return texture, np.stack([u, v], axis=-1).astype(np.float32)


def _shares(values: np.ndarray) -> np.ndarray:
    """Whole numbers over their full scale, float32."""
    return values.astype(np.float32) / np.float32(65535.0 if values.dtype.itemsize > 1 else 255.0)


def _linear(shares: np.ndarray) -> np.ndarray:
    """Linear values of those that sRGB stores, float32."""
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4).astype(np.float32)


@contextmanager
def _opened(file: Path | io.BytesIO) -> Iterator[Image.Image]:
    """An image that is not too large, before a pixel is decoded; what is wrong with it is a `ShapeError`."""
    from PIL import Image

    # Planetary maps are large: our own limit is checked first.
    Image.MAX_IMAGE_PIXELS = None
    try:
        with Image.open(file, formats=_TEXTURE_FORMATS) as image:
            if max(image.size) > MAX_IMAGE_PX or image.width * image.height > MAX_TEXTURE_PX:
                raise ShapeError("", f"must be a texture of at most {MAX_IMAGE_PX} pixels a side and "
                                 f"{MAX_TEXTURE_PX} in all", image.size, "make it coarser")
            yield image
    except ShapeError:
        raise
    except Exception as error:  # broken images raise anything
        where = file.getbuffer().nbytes if isinstance(file, io.BytesIO) else str(file)
        raise ShapeError("", f"texture cannot be read: {str(error).partition(' <_io')[0]}", where) from None
