"""Frames as files: FITS, NPZ, PNG of 16 bits, and OpenEXR. Each is whole or not there."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import ConfigError
from ..engines.image import UNITS
from .fits_cards import Cards, cards_of, sky_cards


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameFile:
    """One frame, as it is written.

    Parameters
    ----------
    pixels : (height, width) float32 [W/m2 per pixel] or uint8, uint16 [DN]
    unit : str
        ``W/m2`` or ``DN``.
    products : mapping of str to array
        As of `Image`: `range` [m], `body_id`, ...
    header : mapping
        Plain data: state, camera, plan, seed, exposure, warnings.
    """

    pixels: np.ndarray
    unit: str
    products: Mapping[str, np.ndarray]
    header: Mapping[str, Any]


def write(path: Path, frame: FrameFile) -> None:
    """Write a frame in the format of its path's ending; a process that is killed meanwhile leaves no such file.

    Raises
    ------
    ConfigError
        An unknown ending, a format that does not hold these pixels, or a library that is not installed.
    OSError
    """
    ending = checked_ending(path.suffix.removeprefix("."), frame.unit)
    apart = path.with_name(f".{path.stem}.{os.getpid()}.part.{ending}")
    _WRITERS[ending](apart, frame)
    os.replace(apart, path)


def checked_ending(ending: str, unit: str) -> str:
    """The name of a format that holds pixels of a unit.

    Raises
    ------
    ConfigError
    """
    if ending not in _WRITERS:
        raise ConfigError("format", f"must be one of {', '.join(_WRITERS)}", ending)
    if ending == "png" and unit != "DN":
        raise ConfigError("format", "png holds digital numbers alone", unit, "use fits, npz or exr, or output dn")
    return ending


def _write_npz(path: Path, frame: FrameFile) -> None:
    np.savez(path, image=frame.pixels, header=json.dumps(frame.header), **frame.products)


def _write_png(path: Path, frame: FrameFile) -> None:
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    text = PngInfo()
    text.add_text("glrender", json.dumps(frame.header))
    Image.fromarray(frame.pixels).save(path, pnginfo=text)


def _write_exr(path: Path, frame: FrameFile) -> None:
    try:
        import OpenEXR
    except ImportError:
        raise _missing("exr", "OpenEXR", "exr") from None
    channels = {"Y": frame.pixels.astype(np.float32)}
    for name, array in frame.products.items():
        if array.ndim == 2:
            # Whole numbers have 32 bits without a sign: -1, beside the bodies, is 2**32 - 1.
            channels[name] = array.astype(np.uint32 if array.dtype.kind in "iu" else np.float32)
        else:
            channels |= {f"{name}.{axis}": np.ascontiguousarray(array[..., k], np.float32)
                         for k, axis in enumerate("XYZ")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage,
              "glrender": json.dumps(frame.header)}
    OpenEXR.File(header, channels).write(str(path))


def _write_fits(path: Path, frame: FrameFile) -> None:
    try:
        from astropy.io import fits
    except ImportError:
        raise _missing("fits", "astropy", "fits") from None
    # FITS counts rows from below: row 0 of the file is the picture's lowest, as viewers show it.
    image = fits.PrimaryHDU(np.flipud(frame.pixels))
    sky = sky_cards(frame.header)
    _put(image, {"BUNIT": (frame.unit, "of a pixel"), **cards_of(frame.header), **sky})
    parts = [image]
    for name, array in frame.products.items():
        parts.append(fits.ImageHDU(np.moveaxis(np.flipud(array), 2, 0) if array.ndim == 3 else np.flipud(array),
                                   name=name.upper()))
        _put(parts[-1], {"BUNIT": (UNITS[name], "1: a number or a share"), **({} if array.ndim == 3 else sky)})
    parts.append(fits.ImageHDU(np.frombuffer(json.dumps(frame.header).encode(), np.uint8), name="GLRENDER"))
    _put(parts[-1], {"BUNIT": ("byte", "UTF-8, JSON")})
    fits.HDUList(parts).writeto(path, output_verify="exception")


def _put(part: Any, cards: Cards) -> None:
    for keyword, card in cards.items():
        part.header[keyword] = card


def _missing(name: str, library: str, extra: str) -> ConfigError:
    return ConfigError("format", f"{name} needs {library}", hint=f"pip install 'glrender[{extra}]'")


_WRITERS = {"fits": _write_fits, "npz": _write_npz, "png": _write_png, "exr": _write_exr}
FORMATS = tuple(_WRITERS)
