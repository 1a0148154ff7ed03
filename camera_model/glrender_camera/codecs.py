"""The codecs of the package imagecodecs: bytes of a frame without loss or at a setting, and the frame of the bytes."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

import numpy as np

from .errors import ConfigError

Lossy = Callable[[np.ndarray, int, float], bytes]
"""The bytes of a frame, of its bit depth, at a setting."""
# The blocks of CCSDS 121, and how many of them share a reference sample.
_AEC = {"blocksize": 16, "rsi": 64}


def library() -> ModuleType:
    """The package.

    Raises
    ------
    ConfigError
        It is not installed.
    """
    try:
        import imagecodecs
    except ImportError:
        raise ConfigError("codec", "needs imagecodecs", None, "pip install 'glrender[compression]'") from None
    return imagecodecs


def reversible_2000(dn: np.ndarray, bits: int, db: float) -> bytes:
    """JPEG 2000 by the transform without rounding, cut off at a PSNR [dB]; 0 for all of it."""
    return library().jpeg2k_encode(dn, level=db, reversible=True, bitspersample=bits, codecformat="j2k", numthreads=1)


LOSSLESS: dict[str, Callable[[np.ndarray, int], bytes]] = {
    "jpeg_ls": lambda dn, bits: library().jpegls_encode(dn),
    "jpeg_2000": lambda dn, bits: reversible_2000(dn, bits, 0.0),
    "jpeg_xl": lambda dn, bits: library().jpegxl_encode(dn, lossless=True, effort=3, numthreads=1),
    "ccsds_121": lambda dn, bits: library().aec_encode(dn, bitspersample=bits, **_AEC)}
# By a PSNR [dB] of JPEG 2000; of JPEG XL by a distance, which halves where that rises by 6 dB.
LOSSY: dict[str, Lossy] = {
    "jpeg_2000": lambda dn, bits, db: library().jpeg2k_encode(dn, level=db, reversible=False, bitspersample=bits,
                                                              codecformat="j2k", numthreads=1),
    "jpeg_xl": lambda dn, bits, db: library().jpegxl_encode(dn, distance=min(10.0 ** ((50.0 - db) / 20.0), 25.0),
                                                            effort=5, bitspersample=bits, numthreads=1)}
DECODED: dict[str, Callable[[bytes, tuple[int, int], int, np.dtype], np.ndarray]] = {
    "jpeg_ls": lambda body, shape, bits, kind: library().jpegls_decode(body),
    "jpeg_2000": lambda body, shape, bits, kind: library().jpeg2k_decode(body),
    "jpeg_xl": lambda body, shape, bits, kind: library().jpegxl_decode(body),
    "ccsds_121": lambda body, shape, bits, kind: np.frombuffer(library().aec_decode(
        body, bitspersample=bits, out=_in_blocks(shape) * kind.itemsize, **_AEC), kind)[:np.prod(shape)].reshape(shape)}


def _in_blocks(shape: tuple[int, int]) -> int:
    """Pixels of a frame, with those that fill the last block of CCSDS 121."""
    return -(-shape[0] * shape[1] // _AEC["blocksize"]) * _AEC["blocksize"]
