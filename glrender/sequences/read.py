"""Images and headers of a sequence's files, read back."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.compression import CODECS, decode

from ..base.errors import ConfigError, GlrenderError, error_path
from .formats import header_path
from .header import decoding_of

_ANEW = "remove the frame's files, and draw it anew"


def read_image(path: Path) -> np.ndarray:
    """The (height, width) image of a frame's file, its first row on top; digital numbers are of an integer type.

    Raises
    ------
    ConfigError
        A file that is missing, spoilt or none of a sequence's; a stream without its header or of another camera.
    """
    with _reading(path):
        return _image(path)


def _image(path: Path) -> np.ndarray:
    ending = _ending(path)
    if ending in CODECS:
        table = read_header(path).get("camera")
        try:
            how = decoding_of(table)
        except (KeyError, TypeError):
            raise ConfigError(str(header_path(path)), "must have the detector and the compression of a camera", table,
                              _ANEW) from None
        with error_path(str(path)):
            try:
                return decode(path.read_bytes(), **how)
            except ConfigError as error:
                # Who asks `decode` is to have a spoilt stream sent anew.
                error.hint = error.hint if error.path == "codec" else _ANEW
                raise
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
        As of `read_image`; a header that is no table in JSON.
    """
    source = header_path(path) if _ending(path) in CODECS else path
    with _reading(source):
        text = _header_text(path)
        header = None if text is None else json.loads(text)
        if header is not None and not isinstance(header, dict):
            raise ConfigError(str(source), "must have a header that is a table", header, _ANEW)
        return header


def _header_text(path: Path) -> str | bytes | None:
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
    return text


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except GlrenderError:
        raise
    except ImportError as error:
        raise ConfigError(str(path), f"needs {error.name}", hint=f"pip install {error.name}") from None
    except Exception as error:
        # Each library raises an error class of its own.
        raise ConfigError(str(path), f"cannot be read as a frame: {error}", hint=_ANEW) from None


def _ending(path: Path) -> str:
    return path.suffix.removeprefix(".").lower()
