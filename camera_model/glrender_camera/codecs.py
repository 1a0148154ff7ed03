"""The codecs of the package imagecodecs: bytes of a frame without loss or at a setting, and the frame of the bytes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import ModuleType

import numpy as np

from .errors import ConfigError

Lossy = Callable[[np.ndarray, int, float], bytes]
"""The bytes of a frame, of its bit depth, at a setting."""
# The blocks of CCSDS 121, and how many of them share a reference sample.
_AEC = {"blocksize": 16, "rsi": 64}
# Rows, columns and bit depth, little-endian: the standard's own stream tells none of them.
_AEC_HEAD = struct.Struct("<HHB")


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
    "ccsds_121": lambda dn, bits: _AEC_HEAD.pack(*dn.shape, bits) + library().aec_encode(dn, bitspersample=bits,
                                                                                         **_AEC)}
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
    "ccsds_121": lambda body, shape, bits, kind: _aec_decoded(body, shape, bits, kind)}


def _aec_decoded(body: bytes, shape: tuple[int, int], bits: int, kind: np.dtype) -> np.ndarray:
    rows, columns, depth = _AEC_HEAD.unpack_from(body)
    if (rows, columns) != shape:
        raise ConfigError("shape", f"must be {(rows, columns)}, the stream's own of ccsds_121", shape)
    if depth != bits:
        raise ConfigError("bit_depth", f"must be {depth}, the stream's own of ccsds_121", bits)
    # Whole blocks: the last one is filled up.
    n_px = -(-rows * columns // _AEC["blocksize"]) * _AEC["blocksize"]
    found = library().aec_decode(body[_AEC_HEAD.size:], bitspersample=bits, out=n_px * kind.itemsize, **_AEC)
    return np.frombuffer(found, kind)[:rows * columns].reshape(shape)
