"""A frame as a file: pictures for the eye, arrays, and the formats of sequences."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from glrender import ConfigError, PinholeCamera
from glrender.sequences.contact_sheet import STRETCHES, grey_levels
from glrender.sequences.formats import FORMATS, FrameFile, write
from glrender_camera.compression import CODECS
from glrender_camera.levels import black_and_white
from glrender_camera.validate import did_you_mean, positive

_PICTURES = (".png", ".jpg", ".jpeg")
WITHOUT_PRODUCTS = (*_PICTURES, ".npy")
ENDINGS = (*WITHOUT_PRODUCTS, *(f".{name}" for name in FORMATS if name != "png"))
_LIBRARIES = {".fits": ("astropy", "fits"), ".exr": ("OpenEXR", "exr")}


def add_picture(parser: argparse.ArgumentParser, default: str) -> None:
    """Add the arguments that say how a frame is written; `default` names the file that is written without --out."""
    parser.add_argument("--out", type=Path, metavar="FILE",
                        help=f"by its ending {', '.join(ENDINGS)}: a picture for the eye of 8 bits, or the numbers"
                             + (f" ({default})" if default else ""))
    parser.add_argument("--stretch", choices=STRETCHES, help="of a picture: gamma 2.2 by default")
    parser.add_argument("--white", type=float, metavar="VALUE",
                        help="of a picture: the value shown as white [frame's unit]; the brightest 0.1 %% by default")
    parser.add_argument("--raw", action="store_true", help="digital numbers as they are in a PNG of 8 or 16 bits")


def check_stream(arguments: argparse.Namespace) -> None:
    """Refuse, before anything is drawn, what a stream's file has not, or an ending that promises another format.

    Raises
    ------
    ConfigError
    """
    for option in ("raw", "white", "stretch"):
        if getattr(arguments, option) is not None and getattr(arguments, option) is not False:
            raise ConfigError(f"--{option}", "is of pixels, and --output compressed writes the camera's stream",
                              getattr(arguments, option), "ask for --output dn")
    if arguments.out is not None:
        if arguments.out.suffix.lower() in ENDINGS:
            raise ConfigError("--out", "must have an ending of its own with --output compressed: the file is the "
                              "camera's stream", str(arguments.out), "end it in the codec's name, as in frame.jpeg_ls, "
                              "or ask for --output dn")
        check_place("--out", arguments.out)


def check_codec(path: Path | None, camera: PinholeCamera) -> None:
    """Refuse, before anything is drawn, a stream's file that ends in the name of another codec than its camera's.

    Raises
    ------
    ConfigError
    """
    codec = camera.model.compression.codec
    if path is not None and path.suffix[1:].lower() in CODECS and path.suffix != f".{codec}":
        raise ConfigError("--out", f"must end in .{codec}, the codec of camera {camera.name!r}", str(path),
                          f"name it {path.with_suffix('.' + codec)}")


def check_picture(arguments: argparse.Namespace, unit: str) -> None:
    """Refuse, before anything is drawn, what cannot be written.

    Raises
    ------
    ConfigError
    """
    path, ending = arguments.out, arguments.out.suffix.lower()
    if ending not in ENDINGS:
        raise ConfigError("--out", f"must end in {', '.join(ENDINGS)}", str(path), did_you_mean(ending, ENDINGS))
    check_place("--out", path)
    library, extra = _LIBRARIES.get(ending, ("numpy", ""))
    if find_spec(library) is None:
        raise ConfigError("--out", f"{ending} needs {library}", str(path), f"pip install 'glrender[{extra}]'")
    if arguments.raw and (ending != ".png" or unit != "DN"):
        raise ConfigError("--raw", "is of digital numbers in a PNG", str(path), "--output dn --out frame.png")
    for option in ("white", "stretch"):
        if getattr(arguments, option) is not None and (ending not in _PICTURES or arguments.raw):
            raise ConfigError(f"--{option}", "is of a picture for the eye, and the file has the numbers",
                              getattr(arguments, option), "leave it out, or write --out frame.png without --raw")
    if arguments.white is not None:
        positive("--white", arguments.white)


def check_place(option: str, path: Path) -> None:
    """Refuse a file that cannot be written because of its folder, before anything is drawn.

    Raises
    ------
    ConfigError
    """
    if not path.parent.is_dir():
        raise ConfigError(option, "must be in a folder that is there", str(path), f"mkdir -p {path.parent}")
    if path.is_dir():
        raise ConfigError(option, "is a folder", str(path), "name a file in it")


def write_frame(arguments: argparse.Namespace, frame: FrameFile) -> None:
    """Write a frame as the arguments of `add_picture` say."""
    path, ending = arguments.out, arguments.out.suffix.lower()
    if ending == ".npy":
        with open(path, "wb") as file:  # given a name, NumPy would add its own ending to .NPY
            np.save(file, frame.pixels)
    elif ending in _PICTURES and not arguments.raw:
        detector = frame.header["camera"]["detector"]
        write_picture(path, frame.pixels, arguments.stretch, arguments.white, detector and detector["offset_DN"])
    else:
        write(path, frame)


def write_picture(path: Path, image: np.ndarray, stretch: str | None = None, white: float | None = None,
                  offset_DN: float | None = None) -> None:
    """An 8-bit picture for the eye; pixels brighter than `white`, the brightest 0.1 % by default, are white."""
    from PIL import Image

    black, brightest = black_and_white([image], offset_DN)
    if white is not None and not white > black:
        raise ConfigError("--white", f"must be above the sky's {black:g}", white)
    Image.fromarray(grey_levels(image, brightest if white is None else white, stretch or "gamma", black)).save(path)
