"""A picture for the eye of some frames of a data set, with their labels drawn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.levels import black_and_white
from PIL import Image, ImageDraw

from ..contact_sheet import grey_levels
from ..header import offset_DN
from .dataset import DataSet
from .read import read_frame

_ON_SHEET, _COLUMNS, _CELL_PX, _GAP_PX, _TEXT_PX = 12, 4, 320, 6, 16
_BOX, _SEEN, _HIDDEN, _LIT, _DARK, _FIGURE, _LIGHT = (
    (90, 160, 255), (90, 255, 90), (255, 80, 80), (255, 220, 60), (150, 110, 40), (0, 255, 255), (255, 0, 255))


def label_sheet(path: Path, dataset: DataSet) -> None:
    """Write a PNG of up to 12 frames, each from its sky to its brightest light, with what their labels say.

    Blue are boxes; yellow and brown limb points that face the Sun and do not; green and red keypoints that are seen
    and hidden; a cyan cross is the centre of figure, a magenta one that of brightness.
    """
    n = len(dataset.states)
    chosen = np.unique(np.linspace(0, n - 1, min(n, _ON_SHEET)).astype(int)).tolist()
    offset = offset_DN(dataset.scene.camera(dataset.options.camera))
    cells = [_cell(dataset.folder, index, offset) for index in chosen]
    width, height = max(cell.width for cell in cells), max(cell.height for cell in cells)
    n_columns = min(_COLUMNS, len(cells))
    n_rows = -(-len(cells) // n_columns)
    sheet = Image.new("RGB", (n_columns * (width + _GAP_PX) + _GAP_PX, n_rows * (height + _GAP_PX) + _GAP_PX),
                      (30, 30, 30))
    for k, cell in enumerate(cells):
        sheet.paste(cell, (_GAP_PX + k % n_columns * (width + _GAP_PX), _GAP_PX + k // n_columns * (height + _GAP_PX)))
    sheet.save(path)


def _cell(folder: Path, index: int, offset: float | None) -> Image.Image:
    frame = read_frame(folder, index)
    pixels = frame.image
    black, white = black_and_white([pixels], offset)
    height, width = pixels.shape
    scale = _CELL_PX / max(height, width)
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    picture = Image.fromarray(grey_levels(pixels, white, black=black)).resize(size, Image.Resampling.BOX).convert("RGB")
    cell = Image.new("RGB", (size[0], size[1] + _TEXT_PX))
    cell.paste(picture)
    draw = ImageDraw.Draw(cell)
    for body in frame.labels["labels"]["bodies"].values():
        _draw_body(draw, scale, body)
    bodies = frame.labels["labels"]["bodies"].values()
    draw.text((2, size[1] + 2), f"{index}: " + "; ".join(
        f"{body['range_m']:.4g} m, {body['phase_deg']:.0f} deg" for body in bodies), fill=(200, 200, 200))
    return cell


def _draw_body(draw: ImageDraw.ImageDraw, scale: float, body: Mapping[str, Any]) -> None:
    # A pixel's centre is half a pixel from its edge, and of the scaled picture likewise.
    at = lambda place: tuple((np.array(place) + 0.5) * scale - 0.5)  # noqa: E731
    if body["box_px"]:
        x0, y0, x1, y1 = body["box_px"]
        draw.rectangle([*at((x0 - 0.5, y0 - 0.5)), *at((x1 - 0.5, y1 - 0.5))], outline=_BOX)
    limb = body.get("limb", {"px": [], "faces_sun": []})
    for place, is_lit in zip(limb["px"], limb["faces_sun"], strict=True):
        draw.point(at(place), fill=_LIT if is_lit else _DARK)
    for point in body["keypoints"].values():
        if point["is_in_view"]:
            x, y = at(point["px"])
            draw.ellipse([x - 2, y - 2, x + 2, y + 2], outline=_SEEN if point["is_seen"] else _HIDDEN)
    for name, colour in (("centre_of_figure_px", _FIGURE), ("centre_of_brightness_px", _LIGHT)):
        if body[name]:
            x, y = at(body[name])
            draw.line([x - 4, y, x + 4, y], fill=colour)
            draw.line([x, y - 4, x, y + 4], fill=colour)
