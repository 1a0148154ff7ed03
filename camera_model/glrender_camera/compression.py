"""Compression of a frame on board: the stream that is sent, and the frame that the ground decodes from it.

Codecs are those of the package imagecodecs (extra `compression`): JPEG-LS (ISO 14495-1), JPEG 2000 (ISO 15444-1),
JPEG XL (ISO 18181-1) and CCSDS 121.0-B-3. What a lost packet does to a stream is not modelled.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import ModuleType
from typing import Any

import numpy as np

from .detector import Detector
from .errors import ConfigError
from .validate import integer, known_keys, one_of, positive, within

# Keys by which each codec loses what it loses; without one it is lossless.
_LOSSES = {"jpeg_ls": ("max_error_DN", "share_of_noise"), "jpeg_2000": ("rate_bpp", "psnr_db"),
           "jpeg_xl": ("rate_bpp", "psnr_db"), "ccsds_121": ()}
CODECS = tuple(_LOSSES)
# Length and CRC-32 of what follows, little-endian: libaec decodes half a stream without an error.
_HEAD = struct.Struct("<II")
# The blocks of CCSDS 121, and how many of them share a reference sample.
_AEC = {"blocksize": 16, "rsi": 64}
# A rate or PSNR is searched for until it is met to this share, or by so many steps.
_MET, _STEPS, _MET_DB = 0.01, 24, 1.0
# Rows or columns of a frame: JPEG-LS counts them with 16 bits.
_MOST_PX = 65535
# Where a body is: so many sigma of the read noise above the offset.
_LIT_SIGMA = 5.0


@dataclass(frozen=True, kw_only=True)
class Compression:
    """A codec and what it may lose; without a bound nothing is lost.

    Parameters
    ----------
    codec : str
        One of `CODECS`.
    max_error_DN : int [DN], 1..255, optional
        Largest error of a pixel; of jpeg_ls.
    share_of_noise : float [1], 0..4, optional
        RMS error in the noise of the frame's lit pixels (read noise, shot noise and rounding by the detector's
        numbers); of jpeg_ls.
    rate_bpp : float [bit/px], optional
        Of jpeg_2000 and jpeg_xl. A frame that needs less without loss has no loss.
    psnr_db : float [dB], 20..120, optional
        20 log10 of the largest digital number over the RMS error; of jpeg_2000 and jpeg_xl.

    Raises
    ------
    ConfigError
        An unknown codec, a key of another one, two keys, imagecodecs not installed.
    """

    codec: str
    max_error_DN: int | None = None
    share_of_noise: float | None = None
    rate_bpp: float | None = None
    psnr_db: float | None = None

    def __post_init__(self):
        one_of("codec", self.codec, CODECS)
        given = [each.name for each in fields(self)[1:] if getattr(self, each.name) is not None]
        allowed = _LOSSES[self.codec]
        for name in given:
            if name not in allowed:
                raise ConfigError(name, f"is no key of {self.codec}", getattr(self, name),
                                  f"it has {' and '.join(allowed) or 'none: it is lossless'}")
        if len(given) > 1:
            raise ConfigError(given[1], f"must not be given with {given[0]}", getattr(self, given[1]))
        checks: dict[str, Callable[[str, Any], Any]] = {
            "max_error_DN": lambda name, value: integer(name, value, 1, _most_error(np.dtype(np.uint16))),
            "share_of_noise": lambda name, value: within(name, positive(name, value), 0.0, 4.0),
            "rate_bpp": lambda name, value: within(name, value, 0.01, 32.0),
            "psnr_db": lambda name, value: within(name, value, 20.0, 120.0)}
        for name in given:
            object.__setattr__(self, name, checks[name](name, getattr(self, name)))
        _library()

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Compression:
        """From plain data; unknown keys are refused by name."""
        return cls(**known_keys("", table, [each.name for each in fields(cls)], required=("codec",)))

    def to_dict(self) -> dict[str, Any]:
        """As `from_dict` reads it."""
        return {each.name: getattr(self, each.name) for each in fields(self) if getattr(self, each.name) is not None}

    def encode(self, dn: np.ndarray, bit_depth: int, noise_DN: float = 0.0) -> bytes:
        """The stream of a frame.

        Parameters
        ----------
        dn : (H, W) uint8 or uint16 [DN]
        bit_depth : int, 1..16
        noise_DN : float [DN]
            Of the lit pixels; `share_of_noise` is of it.
        """
        dn = np.ascontiguousarray(dn)
        bound = self.max_error_DN if self.share_of_noise is None else _error_of(self.share_of_noise * noise_DN)
        if bound is not None:
            return _sealed(_library().jpegls_encode(dn, level=min(bound, _most_error(dn.dtype))))
        lossless = _sealed(_LOSSLESS[self.codec](dn, bit_depth))
        if self.rate_bpp is not None:
            if 8 * len(lossless) <= self.rate_bpp * dn.size:
                return lossless
            return self._searched(dn, bit_depth, lambda stream: 8.0 * len(stream) / dn.size, self.rate_bpp)[0]
        if self.psnr_db is not None:
            made, found = self._searched(dn, bit_depth, lambda stream: psnr_db(
                decode(stream, self.codec, dn.shape, bit_depth), dn, bit_depth), self.psnr_db)
            # Lossy transforms round, and reach no PSNR above some; without loss a frame may be smaller, too.
            return made if found > self.psnr_db - _MET_DB and len(made) < len(lossless) else lossless
        return lossless

    def _searched(self, dn: np.ndarray, bit_depth: int, measure: Callable[[bytes], float],
                  wanted: float) -> tuple[bytes, float]:
        """The stream whose measure is the wanted one, or of those tried the nearest, and that measure.

        By halving: rate and PSNR both rise with the setting.
        """
        low, high = 10.0, 130.0
        best, best_found, best_off = b"", np.inf, np.inf
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            stream = _sealed(_LOSSY[self.codec](dn, bit_depth, middle))
            found = measure(stream)
            if abs(found - wanted) < best_off:
                best, best_found, best_off = stream, found, abs(found - wanted)
            if best_off <= _MET * wanted:
                break
            low, high = (middle, high) if found < wanted else (low, middle)
        return best, best_found


def decode(stream: bytes | np.ndarray, codec: str, shape: tuple[int, int], bit_depth: int) -> np.ndarray:
    """The frame of a stream, as the ground decodes it.

    Parameters
    ----------
    stream : bytes or (N) uint8
    codec : str
        One of `CODECS`.
    shape : (int, int)
        Rows and columns.
    bit_depth : int, 1..16

    Returns
    -------
    (H, W) uint8 or uint16 [DN]
        uint8 up to 8 bits.

    Raises
    ------
    ConfigError
        An unknown codec; a stream that is cut off, spoilt or of another shape; imagecodecs not installed.
    """
    one_of("codec", codec, CODECS)
    _library()
    if not isinstance(stream, bytes | bytearray | memoryview | np.ndarray):
        raise ConfigError("stream", "must be bytes", type(stream).__name__)
    stream = memoryview(stream).tobytes()
    if not isinstance(shape, list | tuple) or len(shape) != 2:
        raise ConfigError("shape", "must be two integers: rows and columns", shape)
    shape = integer("shape[0]", shape[0], 1, _MOST_PX), integer("shape[1]", shape[1], 1, _MOST_PX)
    bit_depth = integer("bit_depth", bit_depth, 1, 16)
    kind = np.dtype(np.uint8 if bit_depth <= 8 else np.uint16)
    body = stream[_HEAD.size:]
    if len(stream) < _HEAD.size or _HEAD.unpack_from(stream) != (len(body), zlib.crc32(body)):
        raise ConfigError("stream", f"must be a whole stream of {codec}: it is cut off or spoilt", len(stream))
    try:
        made = _DECODED[codec](body, shape, bit_depth, kind)
    except Exception as error:
        # The library raises an error class of its own for each codec.
        raise ConfigError("stream", f"must be a stream of {codec}: {error}", len(stream)) from None
    if made.shape != shape:
        raise ConfigError("shape", f"must be {made.shape}, the stream's own of {codec}", shape)
    # Codecs with a loss may overshoot.
    return np.minimum(made, 2**bit_depth - 1).astype(kind)


@dataclass(frozen=True, kw_only=True)
class Sent:
    """A frame that reaches the ground: digital numbers, their stream, and a sentence on the codec."""

    dn: np.ndarray
    stream: bytes | None
    text: str


def checked_compression(compression: object) -> None:
    """Refuse what is neither a `Compression` nor None."""
    if compression is not None and not isinstance(compression, Compression):
        raise ConfigError("compression", "must be Compression", compression)


def compressed(dn: np.ndarray, compression: Compression | None, detector: Detector) -> Sent:
    """A frame (H, W) [DN] as it is sent, and as the ground decodes it."""
    if compression is None:
        return Sent(dn=dn, stream=None, text="skipped: none given")
    noise = noise_DN(dn, offset_DN=detector.offset_DN, gain_DN_per_electron=detector.gain_DN_per_electron,
                     read_noise_electrons=detector.read_noise_electrons)
    stream = compression.encode(dn, detector.bit_depth, noise)
    decoded = decode(stream, compression.codec, dn.shape, detector.bit_depth)
    largest = int(np.abs(decoded.astype(np.int32) - dn).max())
    rate, asked = 8.0 * len(stream) / dn.size, compression.rate_bpp
    missed = f" ({asked:g} asked, which the codec does not reach)" if asked and rate > 1.1 * asked else ""
    return Sent(dn=decoded, stream=stream,
                text=f"{compression.codec}, {rate:.3g} bit/px{missed}, largest error {largest} DN")


def psnr_db(dn: np.ndarray, truth: np.ndarray, bit_depth: int) -> float:
    """Peak signal-to-noise ratio [dB] of a frame against another one, infinite for equal ones."""
    mean_square = np.mean((dn.astype(np.float64) - truth) ** 2)
    return float(20.0 * np.log10(2**bit_depth - 1) - 10.0 * np.log10(mean_square)) if mean_square else np.inf


def noise_DN(dn: np.ndarray, *, offset_DN: float, gain_DN_per_electron: float, read_noise_electrons: float) -> float:
    """RMS noise [DN] of a frame's lit pixels by its detector's numbers; where none is lit, of all."""
    signal = np.maximum(dn.astype(np.float64) - offset_DN, 0.0) / gain_DN_per_electron
    lit = signal > _LIT_SIGMA * read_noise_electrons
    electrons = signal[lit].mean() if lit.any() else signal.mean()
    return float(np.sqrt(gain_DN_per_electron**2 * (read_noise_electrons**2 + electrons) + 1.0 / 12.0))


def _error_of(rms_DN: float) -> int:
    """The bound [DN] of integers that are even between plus and minus it: their RMS is sqrt(n (n + 1) / 3)."""
    return int(np.sqrt(0.25 + 3.0 * rms_DN**2) - 0.5)


def _most_error(kind: np.dtype) -> int:
    """The largest bound [DN] that a stream of JPEG-LS may name (ISO 14495-1, C.2.3)."""
    return min(255, np.iinfo(kind).max // 2)


def _library() -> ModuleType:
    try:
        import imagecodecs
    except ImportError:
        raise ConfigError("codec", "needs imagecodecs", None, "pip install 'glrender[compression]'") from None
    return imagecodecs


def _sealed(body: bytes) -> bytes:
    return _HEAD.pack(len(body), zlib.crc32(body)) + body


_LOSSLESS: dict[str, Callable[[np.ndarray, int], bytes]] = {
    "jpeg_ls": lambda dn, bits: _library().jpegls_encode(dn),
    "jpeg_2000": lambda dn, bits: _library().jpeg2k_encode(dn, level=0, reversible=True, bitspersample=bits,
                                                           codecformat="j2k", numthreads=1),
    "jpeg_xl": lambda dn, bits: _library().jpegxl_encode(dn, lossless=True, effort=3, numthreads=1),
    "ccsds_121": lambda dn, bits: _library().aec_encode(dn, bitspersample=bits, **_AEC)}
# By a PSNR [dB] of JPEG 2000; of JPEG XL by a distance, which halves where that rises by 6 dB.
_LOSSY: dict[str, Callable[[np.ndarray, int, float], bytes]] = {
    "jpeg_2000": lambda dn, bits, db: _library().jpeg2k_encode(dn, level=db, reversible=False, bitspersample=bits,
                                                               codecformat="j2k", numthreads=1),
    "jpeg_xl": lambda dn, bits, db: _library().jpegxl_encode(dn, distance=min(10.0 ** ((50.0 - db) / 20.0), 25.0),
                                                             effort=5, bitspersample=bits, numthreads=1)}
_DECODED: dict[str, Callable[[bytes, tuple[int, int], int, np.dtype], np.ndarray]] = {
    "jpeg_ls": lambda body, shape, bits, kind: _library().jpegls_decode(body),
    "jpeg_2000": lambda body, shape, bits, kind: _library().jpeg2k_decode(body),
    "jpeg_xl": lambda body, shape, bits, kind: _library().jpegxl_decode(body),
    "ccsds_121": lambda body, shape, bits, kind: np.frombuffer(_library().aec_decode(
        body, bitspersample=bits, out=_in_blocks(shape) * kind.itemsize, **_AEC), kind)[:np.prod(shape)].reshape(shape)}


def _in_blocks(shape: tuple[int, int]) -> int:
    """Pixels of a frame, with those that fill the last block of CCSDS 121."""
    return -(-shape[0] * shape[1] // _AEC["blocksize"]) * _AEC["blocksize"]
