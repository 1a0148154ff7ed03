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
            channels[name] = array.astype(np.uint32 if array.dtype.kind == "u" else np.float32)
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
    image.header["BUNIT"] = (frame.unit, "of a pixel")
    _add_keywords(image.header, frame.header)
    products = [fits.ImageHDU(np.moveaxis(np.flipud(array), 2, 0) if array.ndim == 3 else np.flipud(array),
                              name=name.upper()) for name, array in frame.products.items()]
    text = np.frombuffer(json.dumps(frame.header).encode(), np.uint8)
    fits.HDUList([image, *products, fits.ImageHDU(text, name="GLRENDER")]).writeto(path, output_verify="exception")


def _add_keywords(cards: Any, header: Mapping[str, Any]) -> None:
    """The keywords that an astronomer looks for; the extension GLRENDER has everything as JSON."""
    camera, state, plan = header["camera"], header["state"], header["plan"]
    keywords = {
        "ORIGIN": (f"glrender {header['glrender']}", "program"),
        "INSTRUME": (camera["name"][:60], "camera"),
        "T_S": (state["t_s"], "[s] time of mid-exposure"),
        "FRAMENUM": (header["index"], "number in its sequence"),
        "FOCALPX": (camera["focal_length_px"], "[px] focal length"),
        # FITS counts pixels from 1, and rows from below.
        "CRPIX1": (camera["principal_point_px"][0] + 1.0, "[px] column of the boresight"),
        "CRPIX2": (camera["height_px"] - camera["principal_point_px"][1], "[px] row of the boresight"),
        "CDELT1": (np.degrees(1.0 / camera["focal_length_px"]), "[deg] of a pixel at the boresight"),
        "CDELT2": (np.degrees(1.0 / camera["focal_length_px"]), "[deg] of a pixel at the boresight"),
        "ASKED": (",".join(f"{unit}={most:g}" for unit, most in plan["asked"].items()), "tolerances"),
        "MAXERR": (plan["max_error"], "RMS drawn for, of the mean lit pixel"),
        "PREDERR": (plan["predicted_error"], "predicted RMS, likewise")}
    for axis, value in zip("XYZ", state["r_sun_inertial_m"], strict=True):
        keywords[f"SUN_{axis}"] = (value, "[m] Sun, inertial")
    for axis, value in zip("XYZ", state["spacecraft"]["r_inertial_m"], strict=True):
        keywords[f"SC_{axis}"] = (value, "[m] spacecraft, inertial")
    for axis, value in zip("WXYZ", state["spacecraft"]["q_from_inertial"], strict=True):
        keywords[f"SC_Q{axis}"] = (value, "spacecraft from inertial")
    if "exposure_s" in header:
        keywords["EXPTIME"] = (header["exposure_s"], "[s] exposure")
        keywords["SEED"] = (header["seed"], "of the noise")
    for name, card in keywords.items():
        cards[name] = card


def _missing(name: str, library: str, extra: str) -> ConfigError:
    return ConfigError("format", f"{name} needs {library}", hint=f"pip install 'glrender[{extra}]'")


_WRITERS = {"fits": _write_fits, "npz": _write_npz, "png": _write_png, "exr": _write_exr}
FORMATS = tuple(_WRITERS)
