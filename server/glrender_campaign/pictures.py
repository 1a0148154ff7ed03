"""Pictures of a flight's frames, for the eye."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from glrender_camera.levels import black_and_white
from PIL import Image, ImageDraw

_PICTURE_PX = 240


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One frame of a flight, as it is reported.

    Attributes
    ----------
    pixels : (H, W) uint8 or uint16
    offset_DN : float [DN]
        Of the detector.
    t_s : float [s]
    error_m, range_m : float [m]
        Of the estimate after the frame.
    true_px, found_px : (float, float) [px] or None
        The body's origin in the frame, and where the estimator has it.
    reason : str
        Why there was no measurement, or none that was accepted.
    """

    pixels: np.ndarray
    offset_DN: float
    t_s: float
    error_m: float
    range_m: float
    true_px: tuple[float, float] | None
    found_px: tuple[float, float] | None
    reason: str


def strip_of(frames: Sequence[Frame]) -> bytes:
    """A PNG of frames side by side."""
    parts = [for_the_eye(frame) for frame in frames]
    strip = Image.new("RGB", (sum(part.width + 4 for part in parts) - 4, parts[0].height), "white")
    for place, part in enumerate(parts):
        strip.paste(part, (place * (part.width + 4), 0))
    file = io.BytesIO()
    strip.save(file, "PNG", optimize=True)
    return file.getvalue()


def for_the_eye(frame: Frame) -> Image.Image:
    """A frame in grey, 240 px wide: a green ring where the body's origin is, an orange cross where it was found."""
    black, white = black_and_white([frame.pixels], frame.offset_DN)
    grey = np.clip((frame.pixels.astype(np.float32) - black) / (white - black), 0.0, 1.0)
    picture = Image.fromarray((255.0 * np.sqrt(grey)).astype(np.uint8)).convert("RGB")
    scale = _PICTURE_PX / picture.width
    picture = picture.resize((_PICTURE_PX, max(round(picture.height * scale), 1)), Image.Resampling.BILINEAR)
    draw = ImageDraw.Draw(picture)
    if frame.true_px is not None:
        x, y = (scale * (each + 0.5) for each in frame.true_px)
        draw.ellipse((x - 6, y - 6, x + 6, y + 6), outline=(60, 220, 90), width=2)
    if frame.found_px is not None:
        x, y = (scale * (each + 0.5) for each in frame.found_px)
        draw.line((x - 6, y, x + 6, y), fill=(255, 150, 30), width=2)
        draw.line((x, y - 6, x, y + 6), fill=(255, 150, 30), width=2)
    return picture
