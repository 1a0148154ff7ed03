"""Frames as files: FITS, NPZ, PNG of 16 bits, OpenEXR, and compressed streams. Each is whole or not there."""

from __future__ import annotations

import errno
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.compression import CODECS

from ..base.errors import ConfigError
from .fits_cards import Cards, cards_of, sky_cards
from .folder import whole, write_whole
from .surface_maps import UNITS

# A step of the ranges in a file is at most this share of a pixel's footprint: half of float64 is noise to a compressor.
_RANGE_STEP_PX = 0.1


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
    stream : bytes, optional
        The compressed frame, of which the pixels are decoded.
    """

    pixels: np.ndarray
    unit: str
    products: Mapping[str, np.ndarray]
    header: Mapping[str, Any]
    stream: bytes | None = None


def write(path: Path, frame: FrameFile) -> None:
    """Write a frame in the format of its path's ending; a process that is killed meanwhile leaves no such file.

    A path that ends in the name of a codec gets the stream, and the header, as JSON, a second file.

    Raises
    ------
    ConfigError
        An unknown ending, a format that does not hold these pixels, or a library that is not installed.
    OSError
    """
    ending = path.suffix.removeprefix(".")
    if ending in CODECS:
        write_stream(path, frame)
        return
    checked_ending(ending, frame.unit)
    with whole(path) as apart:
        _WRITERS[ending](apart, frame)


def range_type(camera: PinholeCamera) -> type:
    """The type of ranges in files: float32, but for a camera whose pixels it is too coarse for.

    A step of float32 is a range times 2**-23 at most, a pixel's footprint is a range over the focal length [px].
    """
    return np.float64 if camera.focal_length_px * np.finfo(np.float32).eps > _RANGE_STEP_PX else np.float32


def checked_ending(ending: str, unit: str) -> None:
    """Refuse a format that is unknown, or that does not hold pixels of a unit.

    Raises
    ------
    ConfigError
    """
    if ending not in _WRITERS:
        raise ConfigError("format", f"must be one of {', '.join(_WRITERS)}", ending)
    if ending == "png" and unit != "DN":
        raise ConfigError("format", "png holds digital numbers alone", unit, "use fits, npz or exr, or output dn")


def header_path(path: Path) -> Path:
    """The path of the header of a stream's file."""
    return path.with_name(f"{path.name}.json")


def write_stream(path: Path, frame: FrameFile) -> None:
    """Write a frame's stream, and its header before it: where the stream is, both are.

    Raises
    ------
    OSError
    """
    write_whole(header_path(path), json.dumps(frame.header, indent=1).encode())
    write_whole(path, frame.stream)


def _write_npz(path: Path, frame: FrameFile) -> None:
    np.savez_compressed(path, image=frame.pixels, header=json.dumps(frame.header), **frame.products)


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
        if array.dtype == np.float64:
            raise ConfigError("format", f"exr holds float32, which is too coarse for this camera's {name}",
                              hint="use fits or npz")
        if array.ndim == 2:
            # Whole numbers have 32 bits without a sign: -1, on the sky, is 2**32 - 1.
            channels[name] = array.astype(np.uint32 if array.dtype.kind in "iu" else np.float32)
        else:
            channels |= {f"{name}.{axis}": np.ascontiguousarray(array[..., k], np.float32)
                         for k, axis in enumerate("XYZ"[:array.shape[2]])}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage,
              "glrender": json.dumps(frame.header)}
    try:
        OpenEXR.File(header, channels).write(str(path))
    except RuntimeError as error:
        raise OSError(errno.EIO, str(error)) from error


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
STREAM = "stream"
"""The format of output "compressed": files with the camera's streams, whose endings are the names of their codecs."""
