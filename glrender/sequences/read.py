"""Images of a sequence's files, read back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from glrender_camera.compression import CODECS, decode

from ..base.errors import ConfigError, error_path
from .formats import header_path
from .header import decoding_of


def read_image(path: Path) -> np.ndarray:
    """The (height, width) image of a frame's file, its first row on top; digital numbers are of an integer type.

    Raises
    ------
    ConfigError
        A file that is none of a sequence's.
    """
    ending = path.suffix.removeprefix(".")
    if ending in CODECS:
        header = json.loads(header_path(path).read_text(encoding="utf-8"))
        with error_path(str(path)):
            return decode(path.read_bytes(), **decoding_of(header["camera"]))
    if ending == "npz":
        with np.load(path, allow_pickle=False) as stored:
            return stored["image"]
    if ending == "png":
        from PIL import Image

        with Image.open(path) as picture:
            return np.asarray(picture)
    if ending == "fits":
        from astropy.io import fits

        stored = fits.getdata(path, 0)
        return np.flipud(stored).astype(stored.dtype.newbyteorder("="))
    if ending == "exr":
        import OpenEXR

        with OpenEXR.File(str(path)) as file:
            pixels = file.channels()["Y"].pixels
            # Digital numbers, of 16 bits at most, are whole there too.
            is_dn = json.loads(file.header().get("glrender", "{}")).get("unit") == "DN"
            return pixels.astype(np.uint16) if is_dn else pixels
    raise ConfigError("path", "must be a frame's file", str(path))
