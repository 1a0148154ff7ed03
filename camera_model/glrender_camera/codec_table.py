"""Measures of codecs on a frame: rate, errors, and how far the body's centre and its features move."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from .compression import CODECS, Compression, decode, psnr_db
from .levels import black_and_white

COMPRESSIONS = (
    *({"codec": codec} for codec in CODECS),
    *({"codec": "jpeg_ls", "max_error_DN": bound} for bound in (2, 5, 10)), {"codec": "jpeg_ls", "share_of_noise": 0.5},
    *({"codec": codec, **loss} for codec in ("jpeg_2000", "jpeg_xl")
      for loss in ({"rate_bpp": 1.0}, {"rate_bpp": 0.5}, {"psnr_db": 56.0})))
"""Tables of `Compression.from_dict`: all codecs without loss, then bounds, rates and a PSNR."""

# Pixels of the body exceed the sky by this share of the brightest light above the sky [1].
_LIT_SHARE = 0.05
# Features are matched where the best descriptor is nearer than this share of the second (Lowe 2004), and are the same
# within so many pixels.
_RATIO, _SAME_PX, _MOST_FEATURES = 0.8, 1.5, 2000
# Lower than the 0.04 of natural scenes: regolith has little contrast.
_CONTRAST = 0.02


@dataclass(frozen=True, kw_only=True)
class CodecRow:
    """The rate, the errors and the times of one codec on a frame.

    Attributes
    ----------
    compression : Compression
    bits_per_pixel : float [bit/px]
    psnr_db : float [dB] or None
        None of a frame that is decoded without error.
    largest_error_DN : int [DN]
    body_rms_DN : float [DN] or None
        RMS error of the lit pixels. None, as the next three, where no pixel is lit.
    centre_px : float [px] or None
        Distance that the centre of brightness moves.
    features_kept : float [1] or None
        Share of the SIFT features of the signal's root that are found again. None where there are none.
    features_px : float [px] or None
        RMS distance that those have moved.
    encode_s, decode_s : float [s]
        Processor time; of encoding with the search for a rate or PSNR.
    """

    compression: Compression
    bits_per_pixel: float
    psnr_db: float | None
    largest_error_DN: int
    body_rms_DN: float | None
    centre_px: float | None
    features_kept: float | None
    features_px: float | None
    encode_s: float
    decode_s: float


def codec_rows(dn: np.ndarray, bit_depth: int, noise_DN: float | None = None,
               offset_DN: float | None = None,
               compressions: Iterable[Mapping[str, Any]] = COMPRESSIONS) -> Iterator[CodecRow]:
    """Measures of codecs on a frame, one after the other.

    Parameters
    ----------
    dn : (H, W) uint8 or uint16 [DN]
    bit_depth : int, 1..16
    noise_DN : float [DN], optional
        Noise of the lit pixels, as of `compression.noise_DN`; without it shares of the noise are left out.
    offset_DN : float [DN], optional
        As of `black_and_white`.
    compressions : iterable of mapping
        Tables of `Compression.from_dict`.

    Raises
    ------
    ConfigError
        imagecodecs not installed.
    """
    black, white = black_and_white([dn], offset_DN)
    lit = _lit(dn, black, white)
    centre, features = _centre(dn, black, white), _features(dn, black, white)
    for table in compressions:
        if "share_of_noise" in table and noise_DN is None:
            continue
        compression, began = Compression.from_dict(table), time.process_time()
        stream = compression.encode(dn, bit_depth, noise_DN or 0.0)
        encoded = time.process_time()
        made = decode(stream, compression.codec, dn.shape, bit_depth)
        decoded = time.process_time()
        error = made.astype(np.float64) - dn
        moved = None if centre is None else _centre(made, black, white)
        kept_share, moved_px = _moved(features, _features(made, black, white))
        yield CodecRow(
            compression=compression, bits_per_pixel=8.0 * len(stream) / dn.size,
            psnr_db=psnr_db(made, dn, bit_depth) if error.any() else None, largest_error_DN=int(np.abs(error).max()),
            body_rms_DN=float(np.sqrt(np.mean(error[lit] ** 2))) if lit.any() else None,
            centre_px=None if moved is None else float(np.hypot(*(moved - centre))), features_kept=kept_share,
            features_px=moved_px, encode_s=encoded - began, decode_s=decoded - encoded)


def _lit(dn: np.ndarray, black: float, white: float) -> np.ndarray:
    return dn > black + _LIT_SHARE * (white - black)


def _centre(dn: np.ndarray, black: float, white: float) -> np.ndarray | None:
    """Centre of brightness (x, y) [px] of the lit pixels."""
    y, x = np.nonzero(_lit(dn, black, white))
    light = dn[y, x] - black
    return np.array([light @ x, light @ y]) / light.sum() if light.size else None


def _features(dn: np.ndarray, black: float, white: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Places (N, 2) [px] and descriptors of SIFT features of the signal's root, whose noise is even."""
    grey = np.sqrt(np.clip((dn - black) / (white - black), 0.0, 1.0))
    found, descriptors = cv2.SIFT_create(_MOST_FEATURES, contrastThreshold=_CONTRAST).detectAndCompute(
        np.rint(255.0 * grey).astype(np.uint8), None)
    return np.array([each.pt for each in found]).reshape(-1, 2), descriptors


def _moved(before: tuple[np.ndarray, np.ndarray | None],
           after: tuple[np.ndarray, np.ndarray | None]) -> tuple[float | None, float | None]:
    """The share of features that are found again, and the RMS distance [px] that they have moved."""
    (places, descriptors), (others, of_others) = before, after
    if descriptors is None:
        return None, None
    if of_others is None or len(others) < 2:
        return 0.0, None
    pairs = [best for best, second in cv2.BFMatcher().knnMatch(descriptors, of_others, k=2)
             if best.distance < _RATIO * second.distance or best.distance == 0.0]
    distance = np.array([np.hypot(*(others[pair.trainIdx] - places[pair.queryIdx])) for pair in pairs])
    same = distance[distance < _SAME_PX]
    return len(same) / len(places), float(np.sqrt(np.mean(same**2))) if same.size else None
