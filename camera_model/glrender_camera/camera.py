"""The camera model: one linear chain from the irradiance image to the frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from .compression import Compression, checked_compression, compressed
from .detector import MAX_SEED, Detector
from .errors import ConfigError, error_path
from .exposure import AutoExposure, checked_exposure_s
from .faults.fault import Fault
from .faults.frame_faults import FrameFaults, checked_faults
from .frame import Frame
from .light import light_on_frame
from .optics import Optics
from .points import PointSources
from .presets import PRESETS
from .spectrum import electrons_per_joule, require_overlap
from .validate import integer, known_keys, one_of


@dataclass(frozen=True, kw_only=True)
class CameraModel:
    """Optics, detector and exposure.

    Parameters
    ----------
    optics : Optics
    detector : Detector
    exposure_s : float [s] > 0, or "auto"
        Exposure of a frame that asks for no other.
    auto_exposure : AutoExposure
        Rules of the automatic exposure.
    faults : sequence of Fault, or of tables with their `kind`
        That frames may have, where they ask for no others.
    compression : Compression, optional
        Compression of the frames that are sent.

    Raises
    ------
    ConfigError
    """

    optics: Optics
    detector: Detector
    exposure_s: float | str
    auto_exposure: AutoExposure = field(default_factory=AutoExposure)
    faults: tuple[Fault, ...] = ()
    compression: Compression | None = None

    def __post_init__(self):
        for name, kind in (("optics", Optics), ("detector", Detector), ("auto_exposure", AutoExposure)):
            if not isinstance(getattr(self, name), kind):
                raise ConfigError(name, f"must be {kind.__name__}", getattr(self, name))
        require_overlap("detector.quantum_efficiency", self.detector.quantum_efficiency, self.optics.band_nm)
        object.__setattr__(self, "exposure_s", checked_exposure("exposure_s", self.exposure_s))
        object.__setattr__(self, "faults", checked_faults("faults", self.faults))
        checked_compression(self.compression)

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> CameraModel:
        """From plain data, as in a scene file or on the wire; unknown keys are refused by name.

        Parameters
        ----------
        table : mapping
            `optics`, `detector` and `exposure_s`, optionally `auto_exposure`, `faults` and `compression`. With
            `preset`, a name in `presets.PRESETS`, all are optional and their fields replace the preset's.

        Raises
        ------
        ConfigError
            With the path of the field.
        """
        known = [f.name for f in fields(cls)]
        known_keys("", table, [*known, "preset"])
        parts = {key: value for key, value in table.items() if key != "preset"}
        if "preset" in table:
            preset: Any = PRESETS[one_of("preset", table["preset"], sorted(PRESETS))]
            for key, value in preset.items():
                own = parts.get(key, {} if isinstance(value, Mapping) else value)
                parts[key] = {**value, **own} if isinstance(value, Mapping) and isinstance(own, Mapping) else own
        known_keys("", parts, known, required=("optics", "detector", "exposure_s"))
        for name, kind in (("optics", Optics), ("detector", Detector), ("auto_exposure", AutoExposure),
                           ("compression", Compression)):
            if name in parts:
                with error_path(name):
                    parts[name] = kind.from_dict(known_keys("", parts[name], parts[name]))
        return cls(**parts)

    @property
    def bands(self) -> dict[str, CameraModel]:
        """The only band, without a name; a `MosaicModel` has several."""
        return {"": self}

    @property
    def psf_margin_px(self) -> int:
        """Distance over which light is spread [px]."""
        return max(self.optics.psf_margin_px)

    @property
    def psf_noise_gain(self) -> float:
        """`Optics.psf_noise_gain` [1]."""
        return self.optics.psf_noise_gain

    @cached_property
    def electrons_per_joule(self) -> float:
        """Photo-electrons per joule of in-band sunlight through the aperture [1/J]."""
        return electrons_per_joule(self.optics.band_nm, self.optics.transmission,
                                   self.detector.quantum_efficiency)

    def expose(self, irradiance_W_m2: np.ndarray, seed: int = 0, *, exposure_s: float | str | None = None,
               roi: tuple[int, int, int, int] | None = None,
               relative_illumination: np.ndarray | None = None, previous: Frame | None = None,
               margin_px: int = 0, points: PointSources | None = None,
               faults: Sequence[Fault | Mapping[str, Any]] | None = None) -> Frame:
        """Expose one frame.

        The mean number of photo-electrons is

            n = t A R (c E * psf),   R = int S QE tau lambda / (h c) dlambda / int S dlambda

        with exposure t [s], aperture area A [m2], sunlight S over the band, quantum efficiency
        QE and transmission tau; c is the relative illumination, * the convolution.

        Parameters
        ----------
        irradiance_W_m2 : (H, W) float32 [W/m2], >= 0
            In-band irradiance at the aperture from each pixel's solid angle, without noise.
        seed : int, 0..2**64 - 1
            Seed of the temporal noise: equal seeds give equal bytes.
        exposure_s : float [s] > 0 or "auto", optional
            Default is the model's.
        roi : (x0, y0, x1, y1) int [px], optional
            A promise that the irradiance is 0 outside columns x0..x1-1 and rows y0..y1-1; it
            saves time and changes no byte.
        relative_illumination : (H, W) float [1], >= 0, optional
            Factor on each pixel's light: the cosine of the field angle by which the aperture is
            foreshortened (`PinholeCamera.expose` gives it), vignetting. Default 1.
        previous : Frame, optional
            This camera's last frame. An automatic exposure is then what the last frame asks for,
            as on board, instead of what this one needs.
        margin_px : int [px], >= 0
            The image reaches so far beyond the frame on each side: light from there is spread into
            the frame before the margin is cut off. `optics.psf_margin_px` is enough but for stray
            light.
        points : PointSources, optional
            Stars, unresolved bodies: spread at their own places between the pixels, and added.
        faults : sequence of Fault, or of tables, optional
            Instead of the model's; empty for none.

        Returns
        -------
        Frame

        Raises
        ------
        ConfigError
            NaN, infinite or negative irradiance, with the pixel; a bad exposure, seed or region.
        """
        light = light_on_frame(self.optics, irradiance_W_m2, roi=roi, margin_px=margin_px, points=points,
                               relative_illumination=relative_illumination)
        rate = self.optics.aperture_area_m2 * self.electrons_per_joule
        stages = self.stages(light.signal[light.lit].size > 0, points, light.text)
        return self.read_out(light.signal, rate, seed, exposure_s, previous, lit=light.lit, stages=stages,
                             faults=self.faults if faults is None else faults)

    def read_out(self, signal: np.ndarray, rate: float, seed: int, exposure_s: float | str | None,
                 previous: Frame | None, *, lit: tuple[slice, slice] = np.s_[:, :], stages: dict[str, str],
                 faults: Sequence[Fault | Mapping[str, Any]]) -> Frame:
        """The frame of an image that the optics have spread.

        Parameters
        ----------
        signal : (H, W) float32
            Overwritten. 0 outside `lit`.
        rate : float [e-/s per unit of signal]
        seed, exposure_s, previous, faults
            As for `expose`.
        lit : (slice, slice)
        stages : dict of str to str
            Handed on.
        """
        seed = integer("seed", seed, 0, MAX_SEED)
        exposure: Any = checked_exposure("exposure_s", self.exposure_s if exposure_s is None else exposure_s)
        if previous is not None and not isinstance(previous, Frame):
            raise ConfigError("previous", "must be a Frame", previous)
        struck = FrameFaults(checked_faults("faults", faults), seed, self.detector.sensor_seed)
        if struck.exposure_s is not None:
            exposure = struck.exposure_s
        elif exposure == "auto":
            exposure = (self.auto_exposure.of_irradiance(signal[lit], rate, self.detector) if previous is None
                        else self.auto_exposure.after(previous, self.detector))
        # The Sun may overflow to infinity here; the detector clips it.
        with np.errstate(over="ignore"):
            signal[lit] *= np.float32(rate * exposure)
        struck.strike(signal, self.detector)
        dn, electrons, saturated = self.detector.read(signal, exposure, seed,
                                                      struck.collect if struck.changes_charge else None)
        sent = compressed(struck.sent(dn), self.compression, self.detector)
        return Frame(dn=sent.dn, electrons=electrons, saturated=saturated, exposure_s=exposure, seed=seed,
                     stages=stages | {"faults": struck.text, "compression": sent.text}, faults=struck.truth,
                     stream=sent.stream, offset_DN=self.detector.offset_DN)

    def stages(self, is_lit: bool, points: PointSources | None = None,
               light_text: str = "skipped: none") -> dict[str, str]:
        """Stages in words: modelled, or skipped with the reason; with the account of the light."""
        optics, detector = self.optics, self.detector
        unlit = None if is_lit else "no pixel is lit"

        def stage(value: object, text: str, needs_light: bool = False) -> str:
            if needs_light and unlit:
                return f"skipped: {unlit}"
            return text if value else "skipped: it is zero"

        return {
            "psf": stage(optics.psf_text, optics.psf_text, True),
            "points": f"{len(points.xy_px)} stars or unresolved bodies" if points else "skipped: none given",
            "stray_light": stage(optics.stray_light, optics.stray_light.text if optics.stray_light else "", True),
            "light": light_text,
            "photo_electrons": stage(1.0, f"{self.electrons_per_joule:.6g} e-/J", True),
            "photo_response_nonuniformity": stage(detector.photo_response_nonuniformity,
                                                  f"{detector.photo_response_nonuniformity:g}", True),
            "frame_transfer_smear": stage(detector.frame_transfer_row_s,
                                          f"{detector.frame_transfer_row_s:g} s a row", True),
            "dark_current": stage(detector.dark_current_electrons_per_s,
                                  f"{detector.dark_rate_electrons_per_s:g} e-/s"),
            "dark_current_nonuniformity": stage(
                detector.dark_current_nonuniformity * detector.dark_current_electrons_per_s,
                f"{detector.dark_current_nonuniformity:g}"),
            "hot_pixels": stage(detector.hot_pixel_fraction * detector.hot_pixel_electrons_per_s,
                                f"{detector.hot_pixel_fraction:g} of the pixels"),
            "dead_pixels": stage(detector.dead_pixel_fraction, f"{detector.dead_pixel_fraction:g} of the pixels", True),
            "cosmic_rays": stage(detector.cosmic_ray_hits_per_px_s,
                                 f"{detector.cosmic_ray_hits_per_px_s:g} hits/(px s)"),
            "shot_noise": stage(is_lit or detector.dark_current_electrons_per_s
                                or detector.cosmic_ray_hits_per_px_s, "Poisson"),
            "full_well": f"{detector.full_well_electrons:g} e-",
            "dark_signal_nonuniformity": stage(detector.dark_signal_nonuniformity_electrons,
                                               f"{detector.dark_signal_nonuniformity_electrons:g} e-"),
            "read_noise": stage(detector.read_noise_electrons, f"{detector.read_noise_electrons:g} e-"
                                + (f"; {detector.clipping_text}" if detector.clipping_text else "")),
            "nonlinearity": stage(detector.nonlinearity_DN, f"table of {len(detector.nonlinearity_DN or ())}"),
            "adc": f"{detector.bit_depth} bit, {detector.gain_DN_per_electron:g} DN/e-, "
                   f"offset {detector.offset_DN:g} DN",
        }


def checked_exposure(name: str, value: object) -> float | str:
    """An exposure [s] > 0, up to 1e6, or "auto"."""
    if isinstance(value, str) and value == "auto":
        return value
    if isinstance(value, str):
        raise ConfigError(name, 'must be "auto" or a number of seconds', value)
    return checked_exposure_s(name, value)
