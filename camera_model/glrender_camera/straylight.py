"""Stray light: a wide wing around every source, and a veil over the whole frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy

from .errors import ConfigError
from .validate import known_keys, positive, within

# The wing is spread on cells of a quarter of its core or less: 1 % where it bends most.
_CELLS_IN_CORE = 4
_MAX_CELL_PX = 16
_MAX_CORE_PX = 1e5
# Gauss-Legendre nodes on one cell and axis of the wing.
_NODES = 4


@dataclass(frozen=True, kw_only=True)
class StrayLight:
    """Light that surfaces scatter, and that walls and lenses throw over everything.

    A star of unit flux is spread as (1 - wing - veil) of the point spread function, plus the wing

        wing (s - 2) / (2 pi a^2) (1 + r^2 / a^2)^(-s/2)   [1/px2],

    of which 1 - (1 + R^2 / a^2)^(1 - s/2) falls within R; what falls beyond the frame is lost. The
    veil shares its part of all light in the frame out evenly. Sources beyond the frame throw their
    wing into it, and a veil of their own, unless the baffle keeps them out.

    Parameters
    ----------
    wing_fraction : float [1], 0..0.5
    wing_core_px : float [px], > 0, up to 1e5
        a: where the wing bends.
    wing_exponent : float [1], 2.05..6
        s: the power with which the wing falls; polished surfaces scatter with 2 to 3.
    veiling_glare : float [1], 0..0.5
        Share of the light in the frame that is veil.
    veiling_glare_beyond : float [1], 0..0.5
        Share of the light of sources beyond the frame that falls on it as an even veil.
    baffle_deg : float [deg], 0..90
        Field angle beyond which no light enters the optics; a wing seen near a star does not hold farther out.

    Raises
    ------
    ConfigError

    Source: Harvey-Shack surface scatter function; veiling glare after ISO 9358.
    """

    wing_fraction: float = 0.0
    wing_core_px: float = 20.0
    wing_exponent: float = 2.5
    veiling_glare: float = 0.0
    veiling_glare_beyond: float = 0.0
    baffle_deg: float = 45.0

    def __post_init__(self):
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731 (frozen dataclass)
        put("baffle_deg", within("baffle_deg", self.baffle_deg, 0.0, 90.0))
        for name in ("wing_fraction", "veiling_glare", "veiling_glare_beyond"):
            put(name, within(name, getattr(self, name), 0.0, 0.5))
        put("wing_core_px", within("wing_core_px", positive("wing_core_px", self.wing_core_px), 0.0, _MAX_CORE_PX))
        put("wing_exponent", within("wing_exponent", self.wing_exponent, 2.05, 6.0))
        if self.wing_fraction + self.veiling_glare + self.veiling_glare_beyond == 0.0:
            raise ConfigError("wing_fraction", "must be > 0, or veiling_glare", self.wing_fraction)

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> StrayLight:
        """From plain data; unknown keys are refused by name."""
        known_keys("", table, [f.name for f in fields(cls)])
        return cls(**table)

    @property
    def text(self) -> str:
        """The stray light in words."""
        wing = f"{self.wing_fraction:g} in a wing of core {self.wing_core_px:g} px, power {self.wing_exponent:g}"
        parts = [wing] * (self.wing_fraction > 0.0) + [f"{self.veiling_glare:g} as a veil"] * (self.veiling_glare > 0.0)
        parts += [f"{self.veiling_glare_beyond:g} of light from beyond"] * (self.veiling_glare_beyond > 0.0)
        return ", ".join(parts)

    @property
    def direct_share(self) -> float:
        """Share of the light that goes no farther than the point spread function [1]."""
        return 1.0 - self.wing_fraction - self.veiling_glare

    def add(self, image: np.ndarray, margin_px: int = 0) -> np.ndarray:
        """A frame with its stray light.

        Parameters
        ----------
        image : (H, W) float32
            The whole frame with its margin, after the point spread function; not changed.
        margin_px : int [px]
            Width of the margin. The veil is shared out from the frame alone, whatever the margin shows.

        Returns
        -------
        (H, W) float32
        """
        out = image * np.float32(self.direct_share)
        if self.wing_fraction > 0.0:
            out += self._wing(image)
        if self.veiling_glare > 0.0:
            frame = image[margin_px:image.shape[0] - margin_px, margin_px:image.shape[1] - margin_px]
            out += np.float32(self.veiling_glare * frame.mean(dtype=np.float64))
        return out

    def add_from_beyond(self, image: np.ndarray, xy_px: np.ndarray, flux: np.ndarray, margin_px: int = 0) -> None:
        """Add the light that sources beyond an image throw into it.

        Parameters
        ----------
        image : (H, W) float32
            The whole frame with its margin; changed in place.
        xy_px : (N, 2) float [px]
            In the image's pixels; may be far away.
        flux : (N,) float
            In the image's unit.
        margin_px : int [px]
        """
        height, width = image.shape
        if self.veiling_glare_beyond > 0.0:
            n_px = (height - 2 * margin_px) * (width - 2 * margin_px)
            image += np.float32(self.veiling_glare_beyond * float(np.sum(flux)) / n_px)
        if self.wing_fraction == 0.0:
            return
        cell = self._cell_px
        rows, columns = -(-height // cell), -(-width // cell)
        # A cell more on each side, so that there is one beyond each pixel.
        y, x = ((np.arange(-1, n + 1) + 0.5) * cell - 0.5 for n in (rows, columns))
        coarse = np.zeros((rows + 2, columns + 2))
        for (x0, y0), light in zip(np.asarray(xy_px, np.float64), flux, strict=True):
            r2 = ((x - x0)[None, :] ** 2 + (y - y0)[:, None] ** 2) / self.wing_core_px**2
            coarse += light * (1.0 + r2) ** (-0.5 * self.wing_exponent)
        coarse *= self.wing_fraction * self._density
        fine = cv2.resize(coarse.astype(np.float32), ((columns + 2) * cell, (rows + 2) * cell),
                          interpolation=cv2.INTER_LINEAR)
        image += fine[cell:cell + height, cell:cell + width]

    @property
    def _cell_px(self) -> int:
        return int(np.clip(self.wing_core_px / _CELLS_IN_CORE, 1, _MAX_CELL_PX))

    @property
    def _density(self) -> float:
        """Density in the middle of a wing that has all light [1/px2]."""
        return (self.wing_exponent - 2.0) / (2.0 * np.pi * self.wing_core_px**2)

    def _wing(self, image: np.ndarray) -> np.ndarray:
        height, width = image.shape
        cell = self._cell_px
        rows, columns = -(-height // cell), -(-width // cell)
        padded = image if (rows * cell, columns * cell) == image.shape else np.pad(
            image, ((0, rows * cell - height), (0, columns * cell - width)))
        # The mean over a cell; the interpolation back shares it out with weights that sum to 1.
        coarse = cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA)
        transform, shape = _wing_transform(self, cell, rows, columns)
        spread = scipy.fft.irfft2(scipy.fft.rfft2(coarse, shape) * transform, shape)[:rows, :columns]
        spread = np.maximum(spread, 0.0).astype(np.float32)
        return cv2.resize(spread, (columns * cell, rows * cell), interpolation=cv2.INTER_LINEAR)[:height, :width]


@lru_cache(maxsize=8)
def _wing_transform(stray: StrayLight, cell: int, rows: int, columns: int) -> tuple[np.ndarray, tuple[int, int]]:
    """Fourier transform of the wing on the cells, padded so that nothing wraps around."""
    shape = scipy.fft.next_fast_len(2 * rows - 1, True), scipy.fft.next_fast_len(2 * columns - 1, True)
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    kernel = np.zeros(shape)
    y, x = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
    for dy, wy in zip(node, weight, strict=True):
        for dx, wx in zip(node, weight, strict=True):
            r2 = ((y[:, None] + 0.5 * dy) ** 2 + (x + 0.5 * dx) ** 2) * (cell / stray.wing_core_px) ** 2
            kernel += 0.25 * wy * wx * (1.0 + r2) ** (-0.5 * stray.wing_exponent)
    return scipy.fft.rfft2(kernel * (stray.wing_fraction * stray._density * cell**2)).astype(np.complex64), shape
