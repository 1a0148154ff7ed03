"""Point sources: each spread at its own place between the pixels, with its flux."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from . import psf
from .convolution import hats
from .errors import ConfigError
from .optics import FINE, Optics

# More sources in a block of so many pixels are spread together, and as many as have more pixels than this.
_MANY, _BLOCK_PX, _AT_ONCE = 32, 128, 200_000


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

        A lone Gaussian is integrated over the pixels around its place exactly; another kernel is interpolated between
        places a fifth of a pixel apart, which keeps flux and centroid and widens it by at most 0.01 px^2. So are
        Gaussians where there are many, or wide ones, and for the mean of a crowd it is 0.007 px^2.

        Parameters
        ----------
        optics : Optics
        shape : (H, W) int [px]
            Size of the image: the frame, or the frame with its margin.
        frame_origin_px : (row, column) int [px]
            Place of the image in the frame: negative in a margin.

        Returns
        -------
        (H, W) float32 [W/m2]
        """
        out = np.zeros(shape, np.float32)
        margin_y, margin_x = optics.psf_margin_px
        frame = (shape[0] + 2 * frame_origin_px[0], shape[1] + 2 * frame_origin_px[1])
        xy = self.xy_px - np.array(frame_origin_px[::-1])
        reached = ((xy > (-1.5 - margin_x, -1.5 - margin_y))
                   & (xy < (shape[1] + margin_x + 0.5, shape[0] + margin_y + 0.5))).all(axis=1)
        xy, fluxes = xy[reached], self.irradiance_W_m2[reached]
        is_gaussian = not optics.is_diffracted and optics.psf_measured is None
        crowds, lone = _crowds(xy, (2 * margin_y + 3) ** 2 if is_gaussian else 0)
        for crowd in crowds:
            add = _add_gaussian_crowd if is_gaussian else _add_crowd
            add(out, xy[crowd], fluxes[crowd], optics, frame_origin_px, frame)
        if is_gaussian:
            # Sources that are spread at once stay within a core's cache, or little beyond.
            for part in np.array_split(lone, lone.size * (2 * margin_y + 3) ** 2 // _AT_ONCE + 1):
                _add_gaussians(out, xy[part], fluxes[part], optics.psf_sigma_px, margin_y + 1)
            return out
        for (x, y), flux in zip(xy[lone], fluxes[lone], strict=True):
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
        """The chosen sources."""
        return PointSources(self.xy_px[index], self.irradiance_W_m2[index])

    def is_inside(self, shape: tuple[int, int], margin_px: int = 0) -> np.ndarray:
        """(N,) bool: whether a source lies in a frame (H, W) [px] or its margin."""
        edge = 0.5 + margin_px
        return np.all((self.xy_px >= -edge) & (self.xy_px < np.array(shape[::-1]) - 1.0 + edge), axis=1)


def _crowds(xy: np.ndarray, n_px: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Indices of sources that are spread together, by blocks of pixels, and of the others: `n_px` is a kernel's."""
    # One crowd is not cut by the blocks' edges.
    low = xy.min(axis=0) if len(xy) and np.ptp(xy, axis=0).max() < _BLOCK_PX else 0.0
    block = np.floor((xy - low) / _BLOCK_PX).astype(np.int64)
    _, where, count = np.unique(block[:, 1] * 2**32 + block[:, 0], return_inverse=True, return_counts=True)
    is_crowd = (count > _MANY) | (count * n_px > _AT_ONCE)
    order = np.argsort(where, kind="stable")
    parts = np.split(order, np.cumsum(count)[:-1]) if len(xy) else []
    return [part for part, crowded in zip(parts, is_crowd, strict=True) if crowded], np.flatnonzero(~is_crowd[where])


def _node_weights(optics: Optics, place: tuple[int, int], frame: tuple[int, int]) -> list[tuple[tuple, float]]:
    """Indices of the kernels around a pixel of the frame, and their bilinear weights."""
    grid = optics.psf_fine_kernel.shape[:-2]
    if not grid:
        return [((), 1.0)]
    rows, columns = (hats(np.array([p]), n, nodes)[:, 0] for p, n, nodes in zip(place, frame, grid, strict=True))
    return [((i, j), rows[i] * columns[j]) for i in np.flatnonzero(rows) for j in np.flatnonzero(columns)]


def _between(fine: np.ndarray, weights: list[tuple[tuple, float]], dx: float, dy: float) -> np.ndarray:
    """(2 r + 1, 2 r + 1): kernel of a point that lies dx, dy from the middle pixel's centre."""
    rows, columns = _sides(fine)
    start = []
    for offset in (dy, dx):
        place = FINE * (1.0 - offset)
        low = min(int(np.floor(place)), 2 * FINE - 1)
        start.append((low, place - low))
    kernel = np.zeros((rows, columns))
    for index, weight in weights:
        for i, a in ((0, 1.0 - start[0][1]), (1, start[0][1])):
            for j, b in ((0, 1.0 - start[1][1]), (1, start[1][1])):
                row, column = start[0][0] + i, start[1][0] + j
                kernel += weight * a * b * fine[index][row::FINE, column::FINE][:rows, :columns]
    return kernel


def _sides(fine: np.ndarray) -> tuple[int, int]:
    """Rows and columns of pixels that a fine kernel's light falls on."""
    rows, columns = ((n - 1) // FINE - 1 for n in fine.shape[-2:])
    return rows, columns


class _Lattice:
    """A crowd's light at places a fifth of a pixel apart: each shared out to the four around it, its centre kept."""

    def __init__(self, xy: np.ndarray):
        self.corner = np.floor(xy.min(axis=0)).astype(int) - 1
        self.columns, self.rows = np.ceil(xy.max(axis=0)).astype(int) + 2 - self.corner
        place = FINE * (xy - self.corner) + FINE // 2
        self._low = np.floor(place).astype(int)
        self._share = place - self._low

    def light(self, fluxes: np.ndarray) -> np.ndarray:
        """(FINE rows, FINE columns) of (N,): place i lies (i - 2) / 5 px from the first pixel's centre."""
        shape = FINE * self.rows, FINE * self.columns
        total = np.zeros(shape[0] * shape[1])
        (x, y), (right, down) = self._low.T, self._share.T
        for dy, a in ((0, 1.0 - down), (1, down)):
            for dx, b in ((0, 1.0 - right), (1, right)):
                total += np.bincount((y + dy) * shape[1] + x + dx, fluxes * a * b, total.size)
        return total.reshape(shape)

    def add_to(self, out: np.ndarray, spread: np.ndarray) -> None:
        """Add the crowd's light, spread by the kernels: as many more rows and columns on each side as they reach."""
        reach_y, reach_x = (spread.shape[0] - self.rows) // 2, (spread.shape[1] - self.columns) // 2
        _add_part(out, np.maximum(spread, 0.0), self.corner[1] - reach_y, self.corner[0] - reach_x)


def _add_crowd(out: np.ndarray, xy: np.ndarray, fluxes: np.ndarray, optics: Optics, origin: tuple[int, int],
               frame: tuple[int, int]) -> None:
    """Sources near each other, as `_between` has each: all light of one place in the pixel at once."""
    from scipy.signal import fftconvolve  # 24 MiB of memory that few scenes need

    fine, lattice = optics.psf_fine_kernel, _Lattice(xy)
    (n, m), middle = _sides(fine), FINE // 2
    pixel = np.rint(xy).astype(int)
    grid = fine.shape[:-2] or (1, 1)
    rows_of, columns_of = (hats(pixel[:, axis] + o, length, nodes) for axis, o, length, nodes
                           in zip((1, 0), origin, frame, grid, strict=True))
    total = np.zeros((lattice.rows + n - 1, lattice.columns + m - 1))
    for node in np.ndindex(grid):
        share = fluxes * rows_of[node[0]] * columns_of[node[1]]
        if not share.any():
            continue
        light = lattice.light(share)
        kernel = fine[node] if fine.ndim == 4 else fine
        for i, j in np.ndindex(FINE, FINE):
            part = light[i::FINE, j::FINE]
            if part.any():
                total += fftconvolve(part, kernel[FINE + middle - i::FINE, FINE + middle - j::FINE][:n, :m])
    lattice.add_to(out, total)


def _add_gaussian_crowd(out: np.ndarray, xy: np.ndarray, fluxes: np.ndarray, optics: Optics, *_: object) -> None:
    """Spread a crowd of sources by Gaussians: along the columns, then along the rows."""
    lattice, radius_px = _Lattice(xy), optics.psf_margin_px[0] + 1
    weights = psf.gaussian_weights((np.arange(FINE) - FINE // 2) / FINE, optics.psf_sigma_px, radius_px)

    def seen(n: int) -> csr_array:
        """(n + 2 radius, FINE n): shares of each place's light in each pixel."""
        place = np.arange(FINE * n)
        pixel = place // FINE + np.arange(2 * radius_px + 1)[:, None]
        row_column = pixel.ravel(), np.broadcast_to(place, pixel.shape).ravel()
        return csr_array((weights[:, place % FINE].ravel(), row_column))

    lattice.add_to(out, (seen(lattice.columns) @ (seen(lattice.rows) @ lattice.light(fluxes)).T).T)


def _add_gaussians(out: np.ndarray, xy: np.ndarray, fluxes: np.ndarray, sigma_px: float, radius_px: int) -> None:
    """Spread all Gaussians at once: a single one costs more to begin than to spread."""
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
    _add_part(out, kernel, row - kernel.shape[0] // 2, column - kernel.shape[1] // 2)


def _add_part(out: np.ndarray, part: np.ndarray, top: int, left: int) -> None:
    part = part[max(0, -top):max(0, out.shape[0] - top), max(0, -left):max(0, out.shape[1] - left)]
    out[max(0, top):max(0, top) + part.shape[0], max(0, left):max(0, left) + part.shape[1]] += part
