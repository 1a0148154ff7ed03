"""Images and headers of a sequence's files, read back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

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
        A file that is none of a sequence's; a stream that is cut off, spoilt or of another camera.
    """
    ending = _ending(path)
    if ending in CODECS:
        with error_path(str(path)):
            header = json.loads(header_path(path).read_text(encoding="utf-8"))
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


def read_header(path: Path) -> dict[str, Any] | None:
    """The header of a frame's file, with the fields of `header.FIELDS`; None of a file that has none.

    Raises
    ------
    ConfigError
        As of `read_image`.
    """
    ending = _ending(path)
    text: Any = None
    if ending in CODECS:
        text = header_path(path).read_bytes()
    elif ending == "npz":
        with np.load(path, allow_pickle=False) as stored:
            text = str(stored["header"]) if "header" in stored else None
    elif ending == "png":
        from PIL import Image

        with Image.open(path) as picture:
            text = getattr(picture, "text", {}).get("glrender")
    elif ending == "fits":
        from astropy.io import fits

        with fits.open(path) as file:
            text = bytes(file["GLRENDER"].data) if "GLRENDER" in file else None
    elif ending == "exr":
        import OpenEXR

        with OpenEXR.File(str(path)) as file:
            text = file.header().get("glrender")
    else:
        raise ConfigError("path", "must be a frame's file", str(path))
    return None if text is None else json.loads(text)


def _ending(path: Path) -> str:
    return path.suffix.removeprefix(".").lower()
