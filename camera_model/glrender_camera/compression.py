"""Compression of a frame on board: the stream that is sent, and the frame that the ground decodes from it.

Codecs are those of the package imagecodecs (extra `compression`): JPEG-LS (ISO 14495-1), JPEG 2000 (ISO 15444-1),
JPEG XL (ISO 18181-1) and CCSDS 121.0-B-3. What a lost packet does to a stream is not modelled.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .codecs import DECODED, HEADS, LOSSLESS, LOSSY, Lossy, library, reversible_2000
from .detector import Detector
from .errors import ConfigError
from .validate import integer, known_keys, one_of, positive, within

# Keys by which each codec loses what it loses; without one it is lossless.
_LOSSES = {"jpeg_ls": ("max_error_DN", "share_of_noise"), "jpeg_2000": ("rate_bpp", "psnr_db"),
           "jpeg_xl": ("rate_bpp", "psnr_db"), "ccsds_121": ()}
CODECS = tuple(_LOSSES)
# Length and CRC-32 of what follows, little-endian: libaec decodes half a stream without an error.
_HEAD = struct.Struct("<II")
# A rate or PSNR is searched for until it is met to this share, or by so many steps.
_MET, _STEPS, _MET_DB = 0.01, 24, 1.0
# A rate that is off by more than this share is not met.
_MET_RATE = 0.1
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
        Rate of jpeg_2000 and jpeg_xl. A frame that needs less without loss has no loss.
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
            raise ConfigError(given[1], f"must not be given with {given[0]}", getattr(self, given[1]),
                              "leave one out")
        checks: dict[str, Callable[[str, Any], Any]] = {
            "max_error_DN": lambda name, value: integer(name, value, 1, _most_error(np.dtype(np.uint16))),
            "share_of_noise": lambda name, value: within(name, positive(name, value), 0.0, 4.0),
            "rate_bpp": lambda name, value: within(name, value, 0.01, 32.0),
            "psnr_db": lambda name, value: within(name, value, 20.0, 120.0)}
        for name in given:
            object.__setattr__(self, name, checks[name](name, getattr(self, name)))
        library()

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
            Noise of the lit pixels; the unit of `share_of_noise`.
        """
        dn = np.ascontiguousarray(dn)
        if max(dn.shape) > _MOST_PX:
            raise ConfigError("codec", f"{self.codec} takes at most {_MOST_PX} rows and columns", dn.shape)
        bound = self.max_error_DN if self.share_of_noise is None else _error_of(self.share_of_noise * noise_DN)
        if bound is not None:
            return _sealed(library().jpegls_encode(dn, level=min(bound, _most_error(dn.dtype))))
        lossless = _sealed(LOSSLESS[self.codec](dn, bit_depth))
        if self.rate_bpp is not None:
            if 8 * len(lossless) <= self.rate_bpp * dn.size:
                return lossless
            rate = lambda stream: 8.0 * len(stream) / dn.size  # noqa: E731
            made, found = self._searched(dn, bit_depth, rate, self.rate_bpp)
            if self.codec == "jpeg_2000" and found < (1.0 - _MET_RATE) * self.rate_bpp:
                # The transform that rounds has no more to send; the one that is reversible has.
                made, _ = self._searched(dn, bit_depth, rate, self.rate_bpp, reversible_2000)
            # A blank frame takes less without loss.
            return min(lossless, made, key=len)
        if self.psnr_db is not None:
            made, found = self._searched(dn, bit_depth, lambda stream: psnr_db(
                decode(stream, self.codec, dn.shape, bit_depth), dn, bit_depth), self.psnr_db)
            # Lossy transforms round, and reach no PSNR above some; without loss a frame may be smaller, too.
            # No stream is the nearest where all that were tried have no error.
            return made if self.psnr_db - _MET_DB < found < np.inf and len(made) < len(lossless) else lossless
        return lossless

    def _searched(self, dn: np.ndarray, bit_depth: int, measure: Callable[[bytes], float],
                  wanted: float, lossy: Lossy | None = None) -> tuple[bytes, float]:
        """The stream whose measure is the wanted one, or of those tried the nearest, and that measure.

        By halving: rate and PSNR both rise with the setting.
        """
        low, high = 10.0, 130.0
        best, best_found, best_off = b"", np.inf, np.inf
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            stream = _sealed((lossy or LOSSY[self.codec])(dn, bit_depth, middle))
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
        An unknown codec; a stream that is cut off, spoilt, of another shape or of a greater depth; imagecodecs not
        installed.
    """
    one_of("codec", codec, CODECS)
    library()
    if not isinstance(stream, bytes | bytearray | memoryview | np.ndarray):
        raise ConfigError("stream", "must be bytes", type(stream).__name__)
    stream = stream.tobytes() if isinstance(stream, np.ndarray) else bytes(stream)
    if not isinstance(shape, list | tuple) or len(shape) != 2:
        raise ConfigError("shape", "must be two integers: rows and columns", shape)
    shape = integer("shape[0]", shape[0], 1, _MOST_PX), integer("shape[1]", shape[1], 1, _MOST_PX)
    bit_depth = integer("bit_depth", bit_depth, 1, 16)
    kind = np.dtype(np.uint8 if bit_depth <= 8 else np.uint16)
    body = stream[_HEAD.size:]
    if len(stream) < _HEAD.size or _HEAD.unpack_from(stream) != (len(body), zlib.crc32(body)):
        raise ConfigError("stream", f"must be a whole stream of {codec}: it is cut off or spoilt", len(stream),
                          "its first 8 bytes are its length and CRC-32; read or send it anew")
    try:
        head = HEADS[codec](body)
        if head.shape != shape:
            raise ConfigError("shape", f"must be {head.shape}, the stream's own of {codec}", shape)
        if head.bit_depth not in (None, bit_depth):
            raise ConfigError("bit_depth", f"must be {head.bit_depth}, the stream's own of {codec}", bit_depth)
        made = DECODED[codec](body, shape, bit_depth, kind)
    except ConfigError:
        raise
    except Exception as error:
        # The library raises an error class of its own for each codec.
        raise ConfigError("stream", f"must be a stream of {codec}: {error}", len(stream)) from None
    if made.shape != shape:
        raise ConfigError("shape", f"must be {made.shape}, the stream's own of {codec}", shape)
    if made.dtype != kind:
        raise ConfigError("bit_depth", f"must be of {made.dtype}, the stream's own of {codec}", bit_depth)
    most = 2**bit_depth - 1
    if made.max() > most + head.overshoot_DN:
        raise ConfigError("bit_depth", f"must hold the stream's largest number, {made.max()}", bit_depth,
                          "give that of the camera that sent it")
    return np.minimum(made, most).astype(kind)


@dataclass(frozen=True, kw_only=True)
class Sent:
    """A frame that reaches the ground: digital numbers, their stream, and a sentence on the codec."""

    dn: np.ndarray
    stream: bytes | None
    text: str


def checked_compression(compression: object) -> None:
    """Refuse values that are neither a `Compression` nor None."""
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
    missed = f" ({asked:g} asked, which the codec does not reach)" if asked and rate > (1.0 + _MET_RATE) * asked else ""
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


def _sealed(body: bytes) -> bytes:
    return _HEAD.pack(len(body), zlib.crc32(body)) + body
