"""A detector behind a mosaic of colour filters, for scenes rendered in several bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from .camera import CameraModel, Frame
from .compression import Compression, checked_compression
from .detector import Detector
from .errors import ConfigError, error_path
from .exposure import AutoExposure
from .faults.fault import Fault
from .faults.frame_faults import checked_faults
from .light import light_on_frame
from .optics import Optics
from .points import PointSources
from .validate import known_keys, within

BAYER = ("RG", "GB")


@dataclass(frozen=True, kw_only=True)
class MosaicModel:
    """Optics in several bands over one detector, each pixel behind one band's filter.

    Parameters
    ----------
    optics : mapping of one letter to Optics
        Each with its `band_nm`, its filter in `transmission`, its own point spread function.
    detector : Detector
    exposure_s : float [s] > 0, or "auto"
    pattern : sequence of str
        Rows of letters, repeated from the top-left pixel on; default RGGB.
    auto_exposure : AutoExposure
        Automatic exposure by all the mosaic's pixels together.
    magnification : mapping of letter to float [1], 0.9..1.1
        Lateral chromatic aberration: how much larger than the camera's focal length has it a band's image is.
        Letters that are left out have 1. `PinholeCamera.expose` applies it, about the principal point.
    faults : sequence of Fault, or of tables with their `kind`
    compression : Compression, optional
        As of `CameraModel`.

    Raises
    ------
    ConfigError
    """

    optics: Mapping[str, Optics]
    detector: Detector
    exposure_s: float | str
    pattern: Sequence[str] = BAYER
    auto_exposure: AutoExposure = field(default_factory=AutoExposure)
    magnification: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    compression: Compression | None = None

    if TYPE_CHECKING:  # made in __post_init__
        bands: Mapping[str, CameraModel] = field(init=False)

    def __post_init__(self):
        rows = tuple(self.pattern)
        if not rows or not all(isinstance(row, str) and row and len(row) == len(rows[0]) for row in rows):
            raise ConfigError("pattern", "must be rows of letters, all as long as the first", self.pattern)
        object.__setattr__(self, "pattern", rows)
        if not isinstance(self.optics, Mapping):
            raise ConfigError("optics", "must be a table of each letter's optics", self.optics)
        letters = sorted(set("".join(rows)))
        known_keys("optics", self.optics, letters, required=letters)
        known_keys("magnification", self.magnification, letters)
        object.__setattr__(self, "magnification", {
            letter: within(f"magnification.{letter}", value, 0.9, 1.1) for letter, value in self.magnification.items()})
        object.__setattr__(self, "faults", checked_faults("faults", self.faults))
        checked_compression(self.compression)
        models = {}
        for letter, optics in self.optics.items():
            with error_path(f"optics.{letter}"):
                models[letter] = CameraModel(optics=optics, detector=self.detector, exposure_s=self.exposure_s,
                                             auto_exposure=self.auto_exposure, compression=self.compression)
        object.__setattr__(self, "bands", models)

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> MosaicModel:
        """From plain data; unknown keys are refused by name.

        Parameters
        ----------
        table : mapping
            `pattern`, `optics` (a table of each letter's), `detector`, `exposure_s`, optionally `auto_exposure`,
            `magnification`, `faults` and `compression`.

        Raises
        ------
        ConfigError
            With the path of the field.
        """
        known_keys("", table, [f.name for f in fields(cls)], required=("pattern", "optics", "detector", "exposure_s"))
        parts = dict(table)
        letters = known_keys("optics", table["optics"], table["optics"])
        parts["optics"] = {}
        for letter, optics in letters.items():
            with error_path(f"optics.{letter}"):
                parts["optics"][letter] = Optics.from_dict(optics)
        for name, kind in (("detector", Detector), ("auto_exposure", AutoExposure), ("compression", Compression)):
            if name in parts:
                with error_path(name):
                    parts[name] = kind.from_dict(known_keys("", parts[name], parts[name]))
        return cls(**parts)

    @property
    def psf_margin_px(self) -> int:
        """Largest distance over which a band's light is spread [px]."""
        return max(model.psf_margin_px for model in self.bands.values())

    @property
    def psf_noise_gain(self) -> float:
        """The largest band's `Optics.psf_noise_gain` [1]."""
        return max(model.psf_noise_gain for model in self.bands.values())

    def expose(self, irradiance_W_m2: Mapping[str, np.ndarray], seed: int = 0, *,
               exposure_s: float | str | None = None, roi: tuple[int, int, int, int] | None = None,
               relative_illumination: np.ndarray | None = None, previous: Frame | None = None, margin_px: int = 0,
               points: Mapping[str, PointSources] | None = None,
               faults: Sequence[Fault | Mapping[str, Any]] | None = None) -> Frame:
        """Expose one frame, not demosaiced.

        Parameters
        ----------
        irradiance_W_m2 : mapping of letter to (H, W) float32 [W/m2]
            Each in its band, as for `CameraModel.expose`.
        seed, exposure_s, roi, relative_illumination, previous, margin_px, faults
            As for `CameraModel.expose`.
        points : mapping of letter to PointSources, optional
            Each in its band.

        Raises
        ------
        ConfigError
        """
        letters = sorted(self.bands)
        known_keys("irradiance_W_m2", irradiance_W_m2, letters, required=letters)
        if points is not None:
            known_keys("points", points, letters, required=letters)
        shape = np.shape(irradiance_W_m2[letters[0]])
        rate: Any = None
        stages: dict[str, str] = {}
        for letter, model in self.bands.items():
            band_points = None if points is None else points[letter]
            with error_path(letter):
                if np.shape(irradiance_W_m2[letter]) != shape:
                    raise ConfigError("irradiance_W_m2", f"must have shape {shape}, as the others",
                                      np.shape(irradiance_W_m2[letter]))
                found = light_on_frame(model.optics, irradiance_W_m2[letter], roi=roi, margin_px=margin_px,
                                       relative_illumination=relative_illumination, points=band_points)
            light = found.signal
            rate = np.zeros(light.shape, np.float32) if rate is None else rate
            scale = np.float32(model.optics.aperture_area_m2 * model.electrons_per_joule)
            for i, row in enumerate(self.pattern):
                for j in (j for j, x in enumerate(row) if x == letter):
                    place = np.s_[i::len(self.pattern), j::len(row)]
                    rate[place] = light[place] * scale
            own = model.stages(light[found.lit].size > 0, band_points, found.text)
            stages |= {f"{name}_{letter}": own[name] for name in ("psf", "stray_light", "light", "photo_electrons")}
            stages |= {"mosaic": " ".join(self.pattern)} | {name: text for name, text in own.items()
                                                            if f"{name}_{letter}" not in stages}
        model = next(iter(self.bands.values()))
        return model.read_out(rate, 1.0, seed, exposure_s, previous, stages=stages,
                              faults=self.faults if faults is None else faults)
