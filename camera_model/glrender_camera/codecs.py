"""The codecs of the package imagecodecs: bytes of a frame without loss or at a setting, and the frame of the bytes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numpy as np

from .errors import ConfigError

Lossy = Callable[[np.ndarray, int, float], bytes]
"""The bytes of a frame, of its bit depth, at a setting."""
# Samples in a block of CCSDS 121, and blocks that share a reference sample.
_AEC = {"blocksize": 16, "rsi": 64}
# Rows, columns and bit depth, little-endian: the standard's own stream has none of these.
_AEC_HEAD = struct.Struct("<HHB")
# Columns over rows of a codestream of JPEG XL that names the rows alone (ISO 18181-1, D.2).
_XL_RATIOS = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))


class Head(NamedTuple):
    """Numbers that a stream declares before its pixels: a decoder allocates memory by them."""

    shape: tuple[int, ...]
    """Rows, columns, and components where there are several."""
    bit_depth: int | None = None
    """None where the codec counts whole bytes."""
    overshoot_DN: int = 0
    """Decoded numbers exceed the frame's by so many at most."""


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
    """JPEG 2000 by the transform without rounding, cut off at a PSNR [dB]; 0 for the whole stream."""
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
    # Whole blocks: the last one is filled up.
    n_px = -(-shape[0] * shape[1] // _AEC["blocksize"]) * _AEC["blocksize"]
    found = library().aec_decode(body[_AEC_HEAD.size:], bitspersample=bits, out=n_px * kind.itemsize, **_AEC)
    return np.frombuffer(found, kind)[:shape[0] * shape[1]].reshape(shape)


def _ls_head(body: bytes) -> Head:
    """Read JPEG-LS's frame header, and the bound in its scan header (ISO 14495-1, C.2.2 and C.2.3)."""
    at, shape = 2, None
    while body[at] == 0xFF:
        marker, length = body[at + 1], int.from_bytes(body[at + 2:at + 4], "big")
        if marker == 0xF7:
            rows, columns, n = struct.unpack_from(">HHB", body, at + 5)
            shape = (rows, columns) if n == 1 else (rows, columns, n)
        elif marker == 0xDA and shape:
            return Head(shape, overshoot_DN=body[at + 5 + 2 * body[at + 4]])
        at += 2 + length
    raise ValueError("it has no header")


def _2000_head(body: bytes) -> Head:
    """Read the segment SIZ that begins a codestream of JPEG 2000 (ISO 15444-1, A.5.1)."""
    if not body.startswith(b"\xff\x4f\xff\x51"):
        raise ValueError("it has no header")
    columns, rows, left, top = struct.unpack_from(">4I", body, 8)
    n, depth = struct.unpack_from(">HB", body, 40)
    return Head((rows - top, columns - left) if n == 1 else (rows - top, columns - left, n), (depth & 0x7F) + 1)


def _xl_head(body: bytes) -> Head:
    """Read the size that begins a codestream of JPEG XL (ISO 18181-1, D.2), bare or in a box of its container."""
    at = 0
    while body[:2] != b"\xff\x0a":
        size, kind = struct.unpack_from(">I4s", body, at)
        if kind in (b"jxlc", b"jxlp"):
            body = body[at + (12 if kind == b"jxlp" else 8):]
            break
        if size < 8:
            raise ValueError("it has no header")
        at += size
    bits = int.from_bytes(body[2:14], "little")

    def taken(n: int) -> int:
        nonlocal bits
        value, bits = bits & ((1 << n) - 1), bits >> n
        return value

    def side() -> int:
        return 8 * (1 + taken(5)) if is_small else 1 + taken((9, 13, 18, 30)[taken(2)])

    is_small = taken(1)
    rows, ratio = side(), taken(3)
    across, down = _XL_RATIOS[ratio - 1]
    return Head((rows, rows * across // down if ratio else side()))


def _aec_head(body: bytes) -> Head:
    rows, columns, depth = _AEC_HEAD.unpack_from(body)
    return Head((rows, columns), depth)


HEADS: dict[str, Callable[[bytes], Head]] = {
    "jpeg_ls": _ls_head, "jpeg_2000": _2000_head, "jpeg_xl": _xl_head, "ccsds_121": _aec_head}
