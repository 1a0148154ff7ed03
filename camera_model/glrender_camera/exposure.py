"""Automatic exposure: from the irradiance of the frame itself, or from the last frame, as a flight loop does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .detector import Detector
from .errors import ConfigError
from .frame import Frame
from .validate import known_keys, positive, within

MAX_EXPOSURE_S, _MAX_STEP = 1e6, 1e6
MIN_EXPOSURE_S = 1e-12
"""Exposure [s] below which "auto" never goes: a tenth of what the Sun's disc asks of 0.1 m, 0.2 mrad and 1e5 e-."""
# Auto-exposure looks at no more pixels than this: a percentile of 65,536 is good to 0.2 %.
_MAX_METERED_PX = 2**16
# The dimmest pixel that counts as lit for the metering, as a fraction of the brightest.
_LIT_FRACTION = 0.01
# Deviations of the noise from which a pixel counts as lit: one dark pixel in 1.7 million is brighter.
_LIT_SIGMAS = 5.0


@dataclass(frozen=True, kw_only=True)
class AutoExposure:
    """Exposure time that puts a percentile of the lit pixels at a target; analytic, no second render.

    Parameters
    ----------
    percentile : float [%], 0..100
        Percentile of the pixels brighter than 1 % of the brightest, after the point spread function.
    target : float [1], 0..1
        Fraction of full scale (the lower of full well and the largest digital number) where
        the percentile is put.
    min_s, max_s : float [s], > 0, up to 1e6
        Limits; by default no shutter is too fast. `max_s` is what a frame without light gets.
    max_step : float [1], > 1, up to 1e6
        Largest ratio of the exposures of two frames, where the last frame's is given.
    """

    percentile: float = 99.0
    target: float = 0.7
    min_s: float = MIN_EXPOSURE_S
    max_s: float = 10.0
    max_step: float = 8.0

    def __post_init__(self):
        within("percentile", self.percentile, 0.0, 100.0)
        if not 0.0 < within("target", self.target, 0.0, 1.0):
            raise ConfigError("target", "must be > 0", self.target)
        within("min_s", positive("min_s", self.min_s), 0.0, MAX_EXPOSURE_S)
        if not within("max_s", self.max_s, 0.0, MAX_EXPOSURE_S) >= self.min_s:
            raise ConfigError("max_s", "must be >= min_s", self.max_s)
        if not within("max_step", self.max_step, 0.0, _MAX_STEP) > 1.0:
            raise ConfigError("max_step", "must be > 1", self.max_step)

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> AutoExposure:
        """From plain data; unknown keys are refused by name."""
        known_keys("", table, [f.name for f in fields(cls)])
        return cls(**table)

    def of_irradiance(self, irradiance_W_m2: np.ndarray, rate_per_W_m2: float, detector: Detector) -> float:
        """Exposure [s] of the frame whose light this is.

        Parameters
        ----------
        irradiance_W_m2 : (h, w) float32 [W/m2]
            After the point spread function; darkness elsewhere.
        rate_per_W_m2 : float [e-/s / (W/m2)]
        detector : Detector
        """
        brightest = float(irradiance_W_m2.max(initial=0.0))
        if not brightest * rate_per_W_m2 > 0.0:
            return self.max_s
        values = irradiance_W_m2[irradiance_W_m2 > _LIT_FRACTION * brightest]
        rate = _percentile(values, self.percentile) * rate_per_W_m2
        rate += detector.dark_rate_electrons_per_s
        return self._limited(self.target * _full_scale_electrons(detector) / rate)

    def after(self, frame: Frame, detector: Detector) -> float:
        """Exposure [s] of the frame that follows this one, from its numbers alone.

        The percentile is taken of the pixels above 1 % of the brightest and 5 sigma of the dark
        noise. Where it is saturated, the exposure falls by `max_step`; where nothing is lit, it
        rises by as much.
        """
        gain, dark_electrons = detector.gain_DN_per_electron, detector.dark_rate_electrons_per_s * frame.exposure_s
        numbers = frame.dn.astype(np.float32) - np.float32(detector.offset_DN)
        dark = gain * dark_electrons
        noise = gain * np.sqrt(detector.read_noise_electrons**2 + dark_electrons
                               + detector.dark_signal_nonuniformity_electrons**2)
        # At least one number: rounding is noise as well.
        lit = dark + max(_LIT_FRACTION * (float(numbers.max()) - dark), _LIT_SIGMAS * noise, 1.0)
        values = numbers[numbers > lit]
        if not values.size:
            return self._limited(frame.exposure_s * self.max_step)
        level = _percentile(values, self.percentile)
        full_scale = gain * _full_scale_electrons(detector)
        # Half a number below the end, or on the noise of a full well, a level is no measure.
        if level >= min(full_scale - _LIT_SIGMAS * gain * detector.read_noise_electrons, full_scale - 0.5):
            return self._limited(frame.exposure_s / self.max_step)
        step = self.target * full_scale / level
        return self._limited(frame.exposure_s * float(np.clip(step, 1.0 / self.max_step, self.max_step)))

    def _limited(self, exposure_s: float) -> float:
        return float(np.clip(exposure_s, self.min_s, self.max_s))


def checked_exposure_s(name: str, value: object) -> float:
    """An exposure [s] > 0, up to 1e6."""
    return within(name, positive(name, value), 0.0, MAX_EXPOSURE_S)


def _percentile(values: np.ndarray, percentile: float) -> float:
    return float(np.percentile(values[:: -(-values.size // _MAX_METERED_PX)], percentile))


def _full_scale_electrons(detector: Detector) -> float:
    return min(detector.full_well_electrons, (detector.max_DN - detector.offset_DN) / detector.gain_DN_per_electron)
