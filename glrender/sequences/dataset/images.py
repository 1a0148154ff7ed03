"""Pixels and products of frames as bytes: PNG, NPY and NPZ, the same for the same pixels."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

import numpy as np
from PIL import Image

# Level of zlib: noise hardly shrinks more by a higher one, which takes twice as long.
_LEVEL = 1


def png(pixels: np.ndarray) -> bytes:
    """A PNG of (height, width) uint8 or uint16, or of (height, width) bool as 0 and 255."""
    stream = io.BytesIO()
    Image.fromarray(np.where(pixels, np.uint8(255), np.uint8(0)) if pixels.dtype == bool else pixels).save(
        stream, "png", compress_level=_LEVEL)
    return stream.getvalue()


def npy(array: np.ndarray) -> bytes:
    """An NPY file of an array."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
    return stream.getvalue()


def npz(arrays: Mapping[str, np.ndarray]) -> bytes:
    """A compressed NPZ file of arrays, as `numpy.load` reads it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as archive:
        for name, array in arrays.items():
            # Dated 1980, as all entries without a date: equal arrays are equal bytes.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), npy(array), zipfile.ZIP_DEFLATED, _LEVEL)
    return stream.getvalue()


def mask(body_id: np.ndarray) -> np.ndarray:
    """The (height, width) mask of a frame: 0 on the sky, k + 1 at body k of the scene."""
    return (body_id + 1).astype(np.uint8 if body_id.max(initial=-1) < 255 else np.uint16)


def kept(products: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Products as they are kept: all but `body_id`, which the mask has."""
    return {name: array for name, array in products.items() if name != "body_id"}
