"""The detector: from mean photo-electrons to digital numbers, the EMVA 1288 linear model.

One Poisson draw of (signal x PRNU + dark x t), full well, read noise and fixed offset, gain,
rounding, clipping. The fixed pattern belongs to the sensor's seed, the
temporal noise to the frame's.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import ndtr

from . import cosmic, noise
from .errors import ConfigError
from .pattern import COSMIC, FRAME, FixedPattern, PatternStatistics, fixed_pattern, stream
from .spectrum import Curve, curve
from .validate import integer, known_keys, positive, vector, within

# Beyond this many full wells the drawn number says nothing more.
_MAX_FULL_WELLS = 100.0
# Deviations of the read noise that the offset should hold: 0.13 % of the pixels are clipped beyond.
_HELD_SIGMA = 3.0
MAX_SEED = 2**64 - 1
MAX_COSMIC_RAY_HITS = 100_000
"""Most hits of cosmic rays in a frame: they take two seconds."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Detector:
    """A linear detector.

    Parameters
    ----------
    quantum_efficiency : float or pairs (wavelength [nm], value) [1], 0..1
    full_well_electrons : float [e-], > 0
    gain_DN_per_electron : float [DN/e-], > 0
        EMVA's K; data sheets often give its inverse.
    bit_depth : int, 1..16
    offset_DN : float [DN]
    read_noise_electrons : float [e-], >= 0
        Standard deviation.
    dark_current_electrons_per_s : float [e-/s], >= 0
        Mean, at `dark_reference_temperature_K`.
    dark_reference_temperature_K, temperature_K : float [K], > 0
    dark_doubling_K : float [K], > 0
        Warming that doubles the dark current.
    photo_response_nonuniformity : float [1], 0..0.3
        PRNU: standard deviation of the pixels' relative response.
    dark_signal_nonuniformity_electrons : float [e-], >= 0
        DSNU: standard deviation of the pixels' fixed offset.
    dark_current_nonuniformity : float [1], 0..0.3
        Standard deviation of the pixels' relative dark current.
    hot_pixel_fraction : float [1], 0..0.1
        Share of the pixels with a dark current of their own.
    hot_pixel_electrons_per_s : float [e-/s], >= 0
        Mean of the hot pixels' extra dark current, exponentially distributed, at
        `dark_reference_temperature_K`.
    dead_pixel_fraction : float [1], 0..0.1
        Share of the pixels that see no light.
    cosmic_ray_hits_per_px_s : float [1/(px s)], 0..0.01
        Rate of particles: 5 per cm2 and s on pixels of 13 um are 8e-6.
    cosmic_ray_electrons_per_px : float [e-/px], >= 0
        Charge per pixel width of a particle's path, at about 80 e-/um.
    cosmic_ray_depth_px : float [px], 0.01..100
        Depth of the sensitive layer over the pitch.
    frame_transfer_row_s : float [s], >= 0
        Time in which a frame-transfer sensor shifts the image by a row; light goes on falling
        meanwhile and smears along the columns. 0 is none.
    rolling_shutter_row_s : float [s], -1..1
        Delay of each row's exposure after that of the row above; negative reads upwards, 0 is a global shutter.
        `time_average` applies it to what moves.
    nonlinearity_DN : pairs (ideal DN, actual DN), optional
        Both rising, joined by straight lines and held beyond the ends; default linear.
    sensor_seed : int, 0..2**64 - 1
        Seed of the fixed pattern.

    Raises
    ------
    ConfigError

    Source: EMVA Standard 1288, release 4.0, linear model.
    """

    quantum_efficiency: Curve
    full_well_electrons: float
    gain_DN_per_electron: float
    bit_depth: int
    offset_DN: float = 0.0
    read_noise_electrons: float = 0.0
    dark_current_electrons_per_s: float = 0.0
    dark_reference_temperature_K: float = 293.15
    temperature_K: float = 293.15
    dark_doubling_K: float = 8.0
    photo_response_nonuniformity: float = 0.0
    dark_signal_nonuniformity_electrons: float = 0.0
    dark_current_nonuniformity: float = 0.0
    hot_pixel_fraction: float = 0.0
    hot_pixel_electrons_per_s: float = 0.0
    dead_pixel_fraction: float = 0.0
    cosmic_ray_hits_per_px_s: float = 0.0
    cosmic_ray_electrons_per_px: float = 1000.0
    cosmic_ray_depth_px: float = 1.0
    frame_transfer_row_s: float = 0.0
    rolling_shutter_row_s: float = 0.0
    nonlinearity_DN: tuple[tuple[float, float], ...] | None = None
    sensor_seed: int = 0

    def __post_init__(self):
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731 (frozen dataclass)
        put("quantum_efficiency", curve("quantum_efficiency", self.quantum_efficiency, 0.0, 1.0))
        for name in ("full_well_electrons", "gain_DN_per_electron", "dark_doubling_K"):
            put(name, within(name, positive(name, getattr(self, name)), 0.0, 1e15))
        for name in ("dark_reference_temperature_K", "temperature_K"):
            put(name, within(name, positive(name, getattr(self, name)), 0.0, 1000.0))
        for name in ("read_noise_electrons", "dark_current_electrons_per_s",
                     "dark_signal_nonuniformity_electrons", "hot_pixel_electrons_per_s",
                     "frame_transfer_row_s", "cosmic_ray_electrons_per_px"):
            put(name, within(name, getattr(self, name), 0.0, 1e9))
        # Six sigma of 0.3 would be a negative response; real sensors are at 0.003 to 0.03.
        for name in ("photo_response_nonuniformity", "dark_current_nonuniformity"):
            put(name, within(name, getattr(self, name), 0.0, 0.3))
        for name in ("hot_pixel_fraction", "dead_pixel_fraction"):
            put(name, within(name, getattr(self, name), 0.0, 0.1))
        put("cosmic_ray_hits_per_px_s", within("cosmic_ray_hits_per_px_s", self.cosmic_ray_hits_per_px_s, 0.0, 0.01))
        put("cosmic_ray_depth_px", within("cosmic_ray_depth_px", self.cosmic_ray_depth_px, 0.01, 100.0))
        put("rolling_shutter_row_s", within("rolling_shutter_row_s", self.rolling_shutter_row_s, -1.0, 1.0))
        if self.nonlinearity_DN is not None:
            put("nonlinearity_DN", _rising_pairs("nonlinearity_DN", self.nonlinearity_DN))
        put("bit_depth", integer("bit_depth", self.bit_depth, 1, 16))
        # Full scale must be above it.
        full_scale = 2.0**self.bit_depth - 1.0
        put("offset_DN", within("offset_DN", self.offset_DN, -full_scale, 0.99 * full_scale))
        put("sensor_seed", integer("sensor_seed", self.sensor_seed, 0, MAX_SEED))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Detector:
        """From plain data; unknown keys are refused by name."""
        known_keys("", table, [f.name for f in fields(cls)],
                   required=("quantum_efficiency", "full_well_electrons", "gain_DN_per_electron",
                             "bit_depth"))
        return cls(**table)

    @property
    def max_DN(self) -> int:
        """The largest digital number."""
        return 2**self.bit_depth - 1

    @property
    def dark_warmth(self) -> float:
        """Dark current over that at the reference temperature [1]."""
        return 2.0 ** ((self.temperature_K - self.dark_reference_temperature_K) / self.dark_doubling_K)

    @property
    def dark_rate_electrons_per_s(self) -> float:
        """Mean dark current at the detector's temperature [e-/s], hot pixels aside."""
        return self.dark_current_electrons_per_s * self.dark_warmth

    @property
    def clipping_text(self) -> str:
        """The part of the read noise that is cut off in darkness, in words; empty where the offset holds 3 sigma."""
        sigma_DN = self.read_noise_electrons * self.gain_DN_per_electron
        # Half a digital number is rounded to 0.
        if not self.offset_DN + 0.5 < _HELD_SIGMA * sigma_DN:
            return ""
        share = ndtr(-(self.offset_DN + 0.5) / sigma_DN)
        return (f"{share:.0%} of the noise is clipped at 0 DN where no light falls, and dark pixels are too bright: "
                f"give an offset_DN of {math.ceil(_HELD_SIGMA * sigma_DN)} or more")

    def fixed_pattern(self, shape: tuple[int, int]) -> FixedPattern:
        """The sensor's own maps, made once."""
        return fixed_pattern(PatternStatistics(**{
            each.name: getattr(self, each.name) for each in fields(PatternStatistics)}), shape)

    def read(self, signal_electrons: np.ndarray, exposure_s: float, seed: int,
             collect: Callable[..., None] | None = None) -> tuple[np.ndarray, ...]:
        """Expose and read out.

        Parameters
        ----------
        signal_electrons : (H, W) float32 [e-], >= 0
            Mean photo-electrons of each pixel; trusted to hold no NaN.
        exposure_s : float [s], > 0
        seed : int
            Seed of the temporal noise.
        collect : callable, optional
            Changes the charge, as `FrameFaults.collect` does.

        Returns
        -------
        dn : (H, W) uint8 or uint16 [DN]
        electrons : (H, W) float32 [e-]
            After full well, fixed offset and read noise.
        saturated : (H, W) bool
            At full well, or at the largest digital number.
        """
        if self.clipping_text:
            _warn_once(f"read noise of {self.read_noise_electrons:g} e-: {self.clipping_text}")
        if self.frame_transfer_row_s > 0.0:
            # On its way in and out each pixel stays one shift under every other row of its column.
            column = signal_electrons.sum(axis=0, dtype=np.float64) * (self.frame_transfer_row_s / exposure_s)
            signal_electrons = signal_electrons + column.astype(np.float32)
        shape, key = signal_electrons.shape, noise.key_of(seed, FRAME)
        pattern = self.fixed_pattern(shape)
        rate = self.dark_current_electrons_per_s if pattern.dark_electrons_per_s is None else 1.0
        mean = {"response": pattern.response, "dark": pattern.dark_electrons_per_s,
                "dark_scale": rate * self.dark_warmth * exposure_s, "most": _MAX_FULL_WELLS * self.full_well_electrons}
        extra = self._cosmic_rays(shape, exposure_s, seed)
        if collect is not None:
            # The same key draws the same charge again below, to which the change is added.
            charge = noise.read_out(signal_electrons, key, **mean)[0]
            extra = np.zeros(shape, np.float32) if extra is None else extra
            changed = charge + extra
            photo, dark = self._means(signal_electrons, **mean)
            collect(changed, photo, dark, pattern.response)
            extra = changed - charge
        pairs = None if self.nonlinearity_DN is None else np.array(self.nonlinearity_DN)
        electrons, dn, saturated = noise.read_out(
            signal_electrons, key, **mean, well=self.full_well_electrons, extra=extra,
            offset=pattern.offset_electrons, read_noise=self.read_noise_electrons, gain=self.gain_DN_per_electron,
            offset_DN=self.offset_DN, largest=self.max_DN, nonlinearity=pairs)
        return dn if self.bit_depth > 8 else dn.astype(np.uint8), electrons, saturated

    @staticmethod
    def _means(signal, response, dark, dark_scale, most) -> tuple[np.ndarray, np.ndarray]:
        photo = np.minimum(signal, np.float32(most)) * np.float32(1.0 if response is None else response)
        current = np.minimum(np.float32(1.0 if dark is None else dark) * dark_scale, most)
        return photo, np.broadcast_to(np.float32(current), photo.shape)

    def _cosmic_rays(self, shape: tuple[int, int], exposure_s: float, seed: int) -> np.ndarray | None:
        if self.cosmic_ray_hits_per_px_s == 0.0:
            return None
        rng = stream(seed, COSMIC)
        expected = self.cosmic_ray_hits_per_px_s * exposure_s * shape[0] * shape[1]
        if expected > MAX_COSMIC_RAY_HITS:
            raise ConfigError("exposure_s", f"must leave at most {MAX_COSMIC_RAY_HITS} cosmic-ray hits in the frame",
                              exposure_s, f"{expected:.3g} are expected at this rate")
        n_hits = int(rng.poisson(expected))
        pixel, electrons = cosmic.tracks(rng, shape, n_hits, electrons_per_px=self.cosmic_ray_electrons_per_px,
                                         depth_px=self.cosmic_ray_depth_px)
        # Poisson numbers add: drawn apart, no other pixel's noise changes.
        charge = np.zeros(shape, np.float32)
        charge.ravel()[pixel] = rng.poisson(electrons)
        return charge


@lru_cache(maxsize=64)
def _warn_once(text: str) -> None:
    _log.warning(text)


def _rising_pairs(name: str, value: object) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) < 2:
        raise ConfigError(name, "must be at least two pairs of numbers", value)
    pairs = np.array([vector(f"{name}[{i}]", pair, 2) for i, pair in enumerate(value)])
    if not (np.diff(pairs, axis=0) > 0.0).all():
        raise ConfigError(name, "both columns must rise", value)
    return tuple((float(a), float(b)) for a, b in pairs)
