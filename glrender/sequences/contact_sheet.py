"""A picture for the eye of some frames of a sequence, side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from glrender_camera.levels import black_and_white
from PIL import Image, ImageDraw

_DISPLAY_GAMMA = 2.2
# White over the level where these stretches turn from linear to logarithmic.
_LOG_RANGE, _ASINH_RANGE = 1000.0, 100.0
_THUMB_PX, _COLUMNS, _GAP_PX = 220, 5, 6


def contact_sheet(path: Path, images: list[tuple[str, np.ndarray]], offset_DN: float | None = None) -> None:
    """Write a PNG of named images, all from the darkest sky to the brightest light of any, gamma 2.2.

    Parameters
    ----------
    path : path
    images : list of (str, (height, width) array)
        Irradiance or digital numbers.
    offset_DN : float [DN], optional
        As of `black_and_white`.
    """
    black, white = black_and_white((image for _, image in images), offset_DN)
    n_columns = min(_COLUMNS, len(images))
    n_rows = -(-len(images) // n_columns)
    height, width = images[0][1].shape
    scale = _THUMB_PX / max(height, width)
    cell = max(1, round(width * scale)), max(1, round(height * scale))
    sheet = Image.new("L", (n_columns * (cell[0] + _GAP_PX) + _GAP_PX, n_rows * (cell[1] + 20 + _GAP_PX) + _GAP_PX), 30)
    draw = ImageDraw.Draw(sheet)
    for k, (name, image) in enumerate(images):
        thumb = Image.fromarray(grey_levels(image, white, black=black)).resize(cell, Image.Resampling.BOX)
        x = _GAP_PX + (k % n_columns) * (cell[0] + _GAP_PX)
        y = _GAP_PX + (k // n_columns) * (cell[1] + 20 + _GAP_PX)
        sheet.paste(thumb, (x, y))
        draw.text((x, y + cell[1] + 3), name, fill=200)
    sheet.save(path)


def grey_levels(image: np.ndarray, white: float, stretch: str = "gamma", black: float = 0.0) -> np.ndarray:
    """The grey levels of an image for the eye.

    Parameters
    ----------
    image : (height, width) array
    white : float
        Value from which pixels have level 255.
    stretch : "gamma", "linear", "log" or "asinh"
        Gamma 2.2; the logarithm over three decades; asinh, linear below a hundredth of white and logarithmic above.
    black : float
        Value up to which pixels have level 0.

    Returns
    -------
    (height, width) uint8
    """
    grey = np.clip((image.astype(np.float64) - black) / (white - black), 0.0, 1.0)
    return np.rint(255.0 * _STRETCHES[stretch](grey)).astype(np.uint8)


_STRETCHES = {"gamma": lambda grey: grey ** (1.0 / _DISPLAY_GAMMA), "linear": lambda grey: grey,
              "log": lambda grey: np.log10(1.0 + _LOG_RANGE * grey) / np.log10(1.0 + _LOG_RANGE),
              "asinh": lambda grey: np.arcsinh(_ASINH_RANGE * grey) / np.arcsinh(_ASINH_RANGE)}
STRETCHES = tuple(_STRETCHES)
