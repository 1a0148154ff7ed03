"""Point sources: each spread at its own place between the pixels, with its flux."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from . import psf
from .convolution import hats
from .errors import ConfigError
from .optics import FINE, Optics

# So many sources within so many pixels are spread together.
_MANY, _CLUSTER_PX = 32, 128


@dataclass(frozen=True, eq=False)
class PointSources:
    """Stars, or bodies too small to be resolved.

    Parameters
    ----------
    xy_px : (N, 2) float [px]
        In `pixel`: (0, 0) is the centre of the top-left pixel. May lie outside the frame.
    irradiance_W_m2 : (N,) float [W/m2], >= 0
        In band, at the aperture.

    Raises
    ------
    ConfigError
    """

    xy_px: np.ndarray
    irradiance_W_m2: np.ndarray

    def __post_init__(self):
        for name, shape in (("xy_px", (-1, 2)), ("irradiance_W_m2", (-1,))):
            values = np.array(getattr(self, name), np.float64)
            if values.size == 0:
                values = values.reshape(0, *shape[1:])
            if values.ndim != len(shape) or values.shape[1:] != shape[1:] or len(values) != len(self.xy_px):
                raise ConfigError(name, "must be (N, 2) places and (N,) irradiances", np.shape(values))
            if not np.isfinite(values).all() or (name == "irradiance_W_m2" and not (values >= 0.0).all()):
                bad = ~np.isfinite(values) if name == "xy_px" else ~(np.isfinite(values) & (values >= 0.0))
                raise ConfigError(name, "must be finite, irradiances >= 0", values[bad][:3].tolist())
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def image(self, optics: Optics, shape: tuple[int, int], frame_origin_px: tuple[int, int] = (0, 0)) -> np.ndarray:
        """Irradiance after the point spread function.

        Gaussians are integrated over the pixels around each place exactly; a pupil's kernel is
        interpolated between places a fifth of a pixel apart, which keeps flux and centroid and
        widens it by at most 0.01 px^2. A measured kernel, known for pixel centres only, is shared
        out bilinearly and so widened by up to 0.25 px^2.

        Parameters
        ----------
        optics : Optics
        shape : (H, W) int [px]
            Of the image: the frame, or the frame with its margin.
        frame_origin_px : (row, column) int [px]
            Of the image in the frame: negative in a margin.

        Returns
        -------
        (H, W) float32 [W/m2]
        """
        out = np.zeros(shape, np.float32)
        margin_y, margin_x = optics.psf_margin_px
        frame = tuple(n + 2 * o for n, o in zip(shape, frame_origin_px, strict=True))
        xy = self.xy_px - np.array(frame_origin_px[::-1])
        reached = ((xy > (-1.5 - margin_x, -1.5 - margin_y))
                   & (xy < (shape[1] + margin_x + 0.5, shape[0] + margin_y + 0.5))).all(axis=1)
        if optics.psf_measured is not None:
            return self._shared_out(optics, xy[reached], self.irradiance_W_m2[reached], shape, frame_origin_px, frame)
        if not optics.is_diffracted:
            _add_gaussians(out, xy[reached], self.irradiance_W_m2[reached], optics.psf_sigma_px, margin_y + 1)
            return out
        if reached.sum() > _MANY and np.ptp(xy[reached], axis=0).max() < _CLUSTER_PX:
            _add_cluster(out, xy[reached], self.irradiance_W_m2[reached], optics, frame_origin_px, frame)
            return out
        for (x, y), flux in zip(xy[reached], self.irradiance_W_m2[reached], strict=True):
            column, row = int(np.rint(x)), int(np.rint(y))
            weights = _node_weights(optics, (row + frame_origin_px[0], column + frame_origin_px[1]), frame)
            _add(out, flux * _between(optics.psf_fine_kernel, weights, x - column, y - row), row, column)
        return out

    def dimmed(self, relative_illumination: np.ndarray, margin_px: int) -> PointSources:
        """The same sources behind a map [1] of the frame with its margin; the nearest pixel counts."""
        limits = np.array(relative_illumination.shape[::-1]) - 1
        place = np.clip(np.rint(self.xy_px + margin_px), 0, limits).astype(int)
        return PointSources(self.xy_px, self.irradiance_W_m2 * relative_illumination[place[:, 1], place[:, 0]])

    def chosen(self, index: np.ndarray) -> PointSources:
        """Some of the sources."""
        return PointSources(self.xy_px[index], self.irradiance_W_m2[index])

    def is_inside(self, shape: tuple[int, int], margin_px: int = 0) -> np.ndarray:
        """(N,) bool: whether a source lies in a frame (H, W) [px], or within so many pixels of it."""
        edge = 0.5 + margin_px
        return ((self.xy_px >= -edge) & (self.xy_px < np.array(shape[::-1]) - 1.0 + edge)).all(axis=1)

    @staticmethod
    def _shared_out(optics, xy, fluxes, shape, origin, frame) -> np.ndarray:
        margin_y, margin_x = (m + 1 for m in optics.psf_margin_px)
        light = np.zeros((shape[0] + 2 * margin_y, shape[1] + 2 * margin_x), np.float32)
        corner = np.floor(xy).astype(int)
        for dx in (0, 1):
            for dy in (0, 1):
                share = np.prod(np.abs(1.0 - np.array([dx, dy]) - (xy - corner)), axis=1)
                np.add.at(light, (corner[:, 1] + dy + margin_y, corner[:, 0] + dx + margin_x), share * fluxes)
        spread = optics.spread(light, (origin[0] - margin_y, origin[1] - margin_x), frame, is_points=True)
        return np.ascontiguousarray(spread[margin_y:-margin_y, margin_x:-margin_x])


def _node_weights(optics: Optics, place: tuple[int, int], frame: tuple[int, int]) -> list[tuple[tuple, float]]:
    """Indices of the kernels around a pixel of the frame, and their bilinear weights."""
    grid = optics.psf_fine_kernel.shape[:-2]
    if not grid:
        return [((), 1.0)]
    rows, columns = (hats(np.array([p]), n, nodes)[:, 0] for p, n, nodes in zip(place, frame, grid, strict=True))
    return [((i, j), rows[i] * columns[j]) for i in np.flatnonzero(rows) for j in np.flatnonzero(columns)]


def _between(fine: np.ndarray, weights: list[tuple[tuple, float]], dx: float, dy: float) -> np.ndarray:
    """(2 r + 1, 2 r + 1): kernel of a point that lies dx, dy from the middle pixel's centre."""
    n = (fine.shape[-1] - 1) // FINE - 1
    start = []
    for offset in (dy, dx):
        place = FINE * (1.0 - offset)
        low = min(int(np.floor(place)), 2 * FINE - 1)
        start.append((low, place - low))
    kernel = np.zeros((n, n))
    for index, weight in weights:
        for i, a in ((0, 1.0 - start[0][1]), (1, start[0][1])):
            for j, b in ((0, 1.0 - start[1][1]), (1, start[1][1])):
                row, column = start[0][0] + i, start[1][0] + j
                kernel += weight * a * b * fine[index][row::FINE, column::FINE][:n, :n]
    return kernel


def _add_cluster(out: np.ndarray, xy: np.ndarray, fluxes: np.ndarray, optics: Optics, origin: tuple[int, int],
                 frame: tuple[int, int]) -> None:
    """Sources near each other, as `_between` has each: all light of one place in the pixel at once.

    A point's light is shared out to the four places, a fifth of a pixel apart, around it; each place has a kernel.
    """
    fine, corner = optics.psf_fine_kernel, np.floor(xy.min(axis=0)).astype(int) - 1
    columns, rows = np.ceil(xy.max(axis=0)).astype(int) + 2 - corner
    n, middle = (fine.shape[-1] - 1) // FINE - 1, FINE // 2
    place = FINE * (xy - corner) + middle
    low = np.floor(place).astype(int)
    right, down = (place - low).T
    pixel = np.rint(xy).astype(int)
    grid = fine.shape[:-2] or (1, 1)
    rows_of, columns_of = (hats(pixel[:, axis] + o, length, nodes) for axis, o, length, nodes
                           in zip((1, 0), origin, frame, grid, strict=True))
    total = np.zeros((rows + n - 1, columns + n - 1))
    for node in np.ndindex(grid):
        share = fluxes * rows_of[node[0]] * columns_of[node[1]]
        if not share.any():
            continue
        light = np.zeros((FINE * rows, FINE * columns))
        for dy, a in ((0, 1.0 - down), (1, down)):
            for dx, b in ((0, 1.0 - right), (1, right)):
                np.add.at(light, (low[:, 1] + dy, low[:, 0] + dx), share * a * b)
        kernel = fine[node] if fine.ndim == 4 else fine
        for i, j in np.ndindex(FINE, FINE):
            part = light[i::FINE, j::FINE]
            if part.any():
                # Light at i, j lies (i - 2) / 5, (j - 2) / 5 from its pixel's centre.
                own = kernel[FINE + middle - i::FINE, FINE + middle - j::FINE][:n, :n]
                total += fftconvolve(part, own)
    top, left = corner[1] - n // 2, corner[0] - n // 2
    inner = np.s_[max(0, -top):max(0, out.shape[0] - top), max(0, -left):max(0, out.shape[1] - left)]
    part = np.maximum(total[inner], 0.0)
    out[max(0, top):max(0, top) + part.shape[0], max(0, left):max(0, left) + part.shape[1]] += part


def _add_gaussians(out: np.ndarray, xy: np.ndarray, fluxes: np.ndarray, sigma_px: float, radius_px: int) -> None:
    """All at once: one of them costs more to begin than to spread."""
    middle = np.rint(xy)
    across, down = (psf.gaussian_weights(offset, sigma_px, radius_px).T for offset in (xy - middle).T)
    steps = np.arange(-radius_px, radius_px + 1)
    columns, rows = (middle[:, axis, None].astype(int) + steps for axis in (0, 1))
    light = (fluxes[:, None] * down)[:, :, None] * across[:, None, :]
    inside = (((rows >= 0) & (rows < out.shape[0]))[:, :, None]
              & ((columns >= 0) & (columns < out.shape[1]))[:, None, :])
    if not inside.any():
        return
    # A sum in float64, over the rows that are met.
    pixel = ((rows * out.shape[1])[:, :, None] + columns[:, None, :])[inside]
    first, last = pixel.min() // out.shape[1], pixel.max() // out.shape[1] + 1
    total = np.bincount(pixel - first * out.shape[1], light[inside], (last - first) * out.shape[1])
    out[first:last] += total.reshape(last - first, -1).astype(np.float32)


def _add(out: np.ndarray, kernel: np.ndarray, row: int, column: int) -> None:
    top, left = row - kernel.shape[0] // 2, column - kernel.shape[1] // 2
    part = kernel[max(0, -top):max(0, out.shape[0] - top), max(0, -left):max(0, out.shape[1] - left)]
    out[max(0, top):max(0, top) + part.shape[0], max(0, left):max(0, left) + part.shape[1]] += part
