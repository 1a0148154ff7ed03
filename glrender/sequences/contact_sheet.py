"""A picture for the eye of some frames of a sequence, side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

_DISPLAY_GAMMA = 2.2
_THUMB_PX, _COLUMNS, _GAP_PX = 220, 5, 6


def contact_sheet(path: Path, images: list[tuple[str, np.ndarray]]) -> None:
    """Write a PNG of named images, each scaled to the brightest 0.1 % of all, gamma 2.2.

    Parameters
    ----------
    path : path
    images : list of (str, (height, width) array)
        Irradiance or digital numbers.
    """
    lit = np.concatenate([image[image > 0].ravel()[:100_000] for _, image in images] or [np.ones(1)])
    white = float(np.quantile(lit, 0.999)) if lit.size else 1.0
    n_columns = min(_COLUMNS, len(images))
    n_rows = -(-len(images) // n_columns)
    height, width = images[0][1].shape
    scale = _THUMB_PX / max(height, width)
    cell = max(1, round(width * scale)), max(1, round(height * scale))
    sheet = Image.new("L", (n_columns * (cell[0] + _GAP_PX) + _GAP_PX, n_rows * (cell[1] + 20 + _GAP_PX) + _GAP_PX), 30)
    draw = ImageDraw.Draw(sheet)
    for k, (name, image) in enumerate(images):
        thumb = Image.fromarray(grey_levels(image, white)).resize(cell, Image.Resampling.BOX)
        x = _GAP_PX + (k % n_columns) * (cell[0] + _GAP_PX)
        y = _GAP_PX + (k // n_columns) * (cell[1] + 20 + _GAP_PX)
        sheet.paste(thumb, (x, y))
        draw.text((x, y + cell[1] + 3), name, fill=200)
    sheet.save(path)


def grey_levels(image: np.ndarray, white: float) -> np.ndarray:
    """The (height, width) uint8 of an image for the eye: `white` and what is brighter are 255, gamma 2.2."""
    grey = np.clip(image / white, 0.0, 1.0) ** (1.0 / _DISPLAY_GAMMA)
    return np.rint(255.0 * grey).astype(np.uint8)
