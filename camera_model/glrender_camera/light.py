"""The light on the frame: the irradiance image checked, spread by the optics, stars and stray light added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from .errors import ConfigError
from .optics import Optics
from .points import PointSources
from .validate import integer

# A rounding error of the renderer below this fraction of the maximum is clipped, more is a fault.
NEGATIVE_TOLERANCE = 1e-12
# The brightest sources beyond an image are followed until they have this share of its light.
_BRIGHT_SHARE = 0.999


@dataclass(frozen=True, kw_only=True, eq=False)
class Light:
    """Light that the optics put on the frame.

    Attributes
    ----------
    signal : (H, W) float32 [W/m2]
        New, without the margin.
    lit : (slice, slice)
        The part outside which it is 0; empty in darkness.
    text : str
        Where the light came from and which share fell on the frame; the rest is beyond kernels, frame and wing.
    """

    signal: np.ndarray
    lit: tuple[slice, slice]
    text: str


def light_on_frame(optics: Optics, irradiance_W_m2: np.ndarray, *, roi: object = None,
                   relative_illumination: np.ndarray | None = None, margin_px: int = 0,
                   points: PointSources | None = None) -> Light:
    """Irradiance on the frame after the optics.

    Parameters
    ----------
    optics, irradiance_W_m2, roi, relative_illumination, margin_px, points
        As in `CameraModel.expose`.

    Raises
    ------
    ConfigError
    """
    irradiance = np.asarray(irradiance_W_m2)
    if irradiance.ndim != 2 or irradiance.size == 0 or irradiance.dtype.kind != "f":
        raise ConfigError("irradiance_W_m2", "must be a (height, width) array of floats",
                          (irradiance.shape, str(irradiance.dtype)))
    irradiance = irradiance.astype(np.float32, copy=False)
    if relative_illumination is not None and np.shape(relative_illumination) != irradiance.shape:
        raise ConfigError("relative_illumination", f"must have the image's shape {irradiance.shape}",
                          np.shape(relative_illumination))
    if points is not None and not isinstance(points, PointSources):
        raise ConfigError("points", "must be PointSources", points)
    box = _lit_box(irradiance, _region(roi, irradiance.shape))
    margin_px = integer("margin_px", margin_px, 0, (min(irradiance.shape) - 1) // 2)
    height, width = (n - 2 * margin_px for n in irradiance.shape)
    stray = optics.stray_light
    # Light that the point spread function carries out of the image throws its wing from there.
    room_px = max(optics.psf_margin_px) if stray is not None and stray.wing_fraction > 0.0 else 0
    edge_px = margin_px + room_px
    signal = np.zeros((height + 2 * edge_px, width + 2 * edge_px), np.float32)
    lit, own, beyond = np.s_[0:0, 0:0], 0.0, 0.0
    if box is not None:
        margin_y, margin_x = optics.psf_margin_px
        drawn = np.s_[box[1]:box[3], box[0]:box[2]]
        x0, y0, x1, y1 = (side + room_px for side in box)
        lit = np.s_[max(0, y0 - margin_y):min(signal.shape[0], y1 + margin_y),
                    max(0, x0 - margin_x):min(signal.shape[1], x1 + margin_x)]
        # A copy, so that the filter sees darkness around the box on every path.
        # Pixels outside the region are dark, whatever they hold.
        light = np.zeros((lit[0].stop - lit[0].start, lit[1].stop - lit[1].start), np.float32)
        inner = np.s_[y0 - lit[0].start:y1 - lit[0].start, x0 - lit[1].start:x1 - lit[1].start]
        np.maximum(irradiance[drawn], 0.0, out=light[inner])
        if relative_illumination is not None:
            light[inner] *= _checked_illumination(relative_illumination[drawn])
        origin = lit[0].start - edge_px, lit[1].start - edge_px
        inside = light[max(0, -origin[0]):max(0, height - origin[0]), max(0, -origin[1]):max(0, width - origin[1])]
        own = _total(inside)
        beyond = _total(light) - own if inside.size < light.size else 0.0
        signal[lit] = optics.spread(light, origin, (height, width))
    if points is not None:
        if relative_illumination is not None:
            points = points.dimmed(relative_illumination, margin_px)
        is_drawn = points.is_inside((height, width), margin_px)
        signal += points.chosen(is_drawn).image(optics, signal.shape, (-edge_px, -edge_px))
        is_own = points.is_inside((height, width))
        own += float(points.irradiance_W_m2[is_own].sum())
        beyond += float(points.irradiance_W_m2[~is_own].sum())
    if stray is not None and (box is not None or points is not None):
        signal = stray.add(signal, edge_px)
        if points is not None:
            far = _brightest(points.chosen(~is_drawn))
            stray.add_from_beyond(signal, far.xy_px + edge_px, far.irradiance_W_m2, edge_px)
    if points is not None and not is_drawn.all():
        # The light that their point spread function brings in has no second wing.
        rest = points.chosen(~is_drawn).image(optics, signal.shape, (-edge_px, -edge_px))
        signal += rest if stray is None else rest * np.float32(stray.direct_share)
    if stray is not None and (box is not None or points is not None):
        lit = np.s_[0:signal.shape[0], 0:signal.shape[1]]
    elif points is not None:
        lit = _around(lit, points.xy_px + edge_px, optics.psf_margin_px, signal.shape)
    if edge_px:
        signal = np.ascontiguousarray(signal[edge_px:-edge_px, edge_px:-edge_px])
        lit = tuple(slice(max(0, part.start - edge_px), max(0, part.stop - edge_px)) for part in lit)
    text = (f"{own:.6g} W/m2 from the frame's own sky, {beyond:.6g} from beyond it; "
            f"{_total(signal[lit]):.6g} fall on the frame")
    return Light(signal=signal, lit=lit, text=text if own + beyond > 0.0 else "skipped: it is dark")


def _total(image: np.ndarray) -> float:
    """Sum of a float32 image in float64, without a copy in float64."""
    return cv2.sumElems(image)[0] if image.size else 0.0


def _around(lit: tuple[slice, slice], xy_px: np.ndarray, reach_px: tuple[int, int],
            shape: tuple[int, int]) -> tuple[slice, slice]:
    """Box of the lit part of an image and of the pixels that points at x, y [px] may reach."""
    # A kernel is put around the nearest pixel, or shared out between two.
    reach = np.array(reach_px[::-1]) + 2.0
    near = xy_px[((xy_px > -reach) & (xy_px < np.array(shape[::-1]) + reach)).all(axis=1)]
    if not len(near):
        return lit
    low = np.clip(near.min(axis=0) - reach, 0, shape[::-1]).astype(int)
    high = np.clip(np.ceil(near.max(axis=0) + reach) + 1, 0, shape[::-1]).astype(int)
    parts = [(int(low[1]), int(high[1])), (int(low[0]), int(high[0]))]
    if all(part.stop > part.start for part in lit):
        parts = [(min(a, part.start), max(b, part.stop)) for (a, b), part in zip(parts, lit, strict=True)]
    return tuple(slice(*part) for part in parts)


def _brightest(points: PointSources) -> PointSources:
    """The brightest points, which have nearly all of the light."""
    index = np.argsort(-points.irradiance_W_m2, kind="stable")
    light = np.cumsum(points.irradiance_W_m2[index])
    n = int(np.searchsorted(light, _BRIGHT_SHARE * light[-1])) + 1 if light.size else 0
    return points.chosen(index[:n])


def _checked_illumination(values: np.ndarray) -> np.ndarray:
    if not (np.isfinite(values).all() and values.min(initial=0.0) >= 0.0):
        bad = values[~(values >= 0.0) | ~np.isfinite(values)]
        raise ConfigError("relative_illumination", "must be finite and >= 0", float(bad[0]),
                          f"{bad.size} such pixel(s)")
    return values


def _region(roi: object, shape: tuple[int, int]) -> tuple[int, int, int, int]:
    height, width = shape
    if roi is None:
        return 0, 0, width, height
    if not isinstance(roi, Sequence) or len(roi) != 4:
        raise ConfigError("roi", "must be (x0, y0, x1, y1)", roi)
    x0, x1 = (integer(f"roi[{i}]", roi[i], 0, width) for i in (0, 2))
    y0, y1 = (integer(f"roi[{i}]", roi[i], 0, height) for i in (1, 3))
    return x0, y0, max(x0, x1), max(y0, y1)


def _lit_box(irradiance: np.ndarray, region: tuple[int, int, int, int]) -> tuple[int, int, int, int] | None:
    """Tight box of the pixels above 0, so that a hint changes nothing; None in darkness."""
    x0, y0, x1, y1 = region
    part = irradiance[y0:y1, x0:x1]
    if part.size == 0:
        return None
    low, high = float(part.min()), float(part.max())
    if not (np.isfinite(low) and np.isfinite(high)):
        raise _bad_pixel(part, ~np.isfinite(part), x0, y0, "must be finite")
    if low < -NEGATIVE_TOLERANCE * max(high, 0.0):
        raise _bad_pixel(part, part == low, x0, y0, "must not be negative")
    if not high > 0.0:
        return None
    rows = np.flatnonzero(part.max(axis=1) > 0.0)
    columns = np.flatnonzero(part[rows[0]:rows[-1] + 1].max(axis=0) > 0.0)
    return int(x0 + columns[0]), int(y0 + rows[0]), int(x0 + columns[-1] + 1), int(y0 + rows[-1] + 1)


def _bad_pixel(part: np.ndarray, bad: np.ndarray, x0: int, y0: int, rule: str) -> ConfigError:
    row, column = np.argwhere(bad)[0]
    return ConfigError(f"irradiance_W_m2[{row + y0}, {column + x0}]", rule, float(part[row, column]),
                       f"{np.count_nonzero(bad)} such pixel(s)")
