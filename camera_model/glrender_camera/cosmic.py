"""Cosmic rays: straight tracks of charge through the detector's sensitive layer."""

from __future__ import annotations

import numpy as np


def tracks(rng: np.random.Generator, shape: tuple[int, int], n_hits: int, *, electrons_per_px: float,
           depth_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Charge that particles leave behind.

    The flux is isotropic: hits are even over the detector, their zenith angles follow sin z cos z, and
    a track's charge is `electrons_per_px` times its length through the layer, depth / cos z: twice
    the depth on average.

    Parameters
    ----------
    rng : Generator
    shape : (H, W) int [px]
    n_hits : int
    electrons_per_px : float [e-/px]
        Per pixel width of path: about 80 e-/um times the pitch for a minimum ionising particle in
        silicon (Janesick 2001, Scientific Charge-Coupled Devices, section 8.1).
    depth_px : float [px]
        Depth of the sensitive layer, over the pitch.

    Returns
    -------
    pixel : (N,) int64
        Flat indices, rising, each once.
    electrons : (N,) float32 [e-]
        Parts of tracks outside the detector are left out.
    """
    height, width = shape
    column, row = rng.uniform(-0.5, width - 0.5, n_hits), rng.uniform(-0.5, height - 0.5, n_hits)
    # The cumulative distribution is sin^2 z; a grazing ray is held to a track across the detector.
    sine2 = rng.uniform(0.0, 1.0, n_hits)
    run = np.minimum(depth_px * np.sqrt(sine2 / np.maximum(1.0 - sine2, 1e-300)), height + width)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, n_hits)
    pixels, charges = [], []
    for x, y, length, angle in zip(column, row, run, azimuth, strict=True):
        dx, dy = length * np.cos(angle), length * np.sin(angle)
        # Where the track crosses from pixel to pixel, as fractions of its length.
        cuts = np.concatenate([[0.0, 1.0], _crossings(x, dx), _crossings(y, dy)])
        cuts.sort()
        middle = 0.5 * (cuts[1:] + cuts[:-1])
        columns, rows = np.rint(x + middle * dx).astype(int), np.rint(y + middle * dy).astype(int)
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        pixels.append((rows * width + columns)[inside])
        charges.append((np.diff(cuts) * electrons_per_px * np.hypot(length, depth_px))[inside])
    if not pixels:
        return np.empty(0, np.int64), np.empty(0, np.float32)
    pixel, place = np.unique(np.concatenate(pixels), return_inverse=True)
    return pixel, np.bincount(place, np.concatenate(charges), pixel.size).astype(np.float32)


def _crossings(start: float, run: float) -> np.ndarray:
    """Fractions of a run at which a coordinate passes a boundary between pixels."""
    low, high = sorted((start, start + run))
    edges = np.arange(np.ceil(low - 0.5), np.floor(high - 0.5) + 1) + 0.5
    return (edges - start) / run if run else np.empty(0)
