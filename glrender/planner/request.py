"""A frame's request: its tolerance, the use of its image, and the engines that may draw it. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer, within

from ..base.errors import ConfigError
from ..view.regions import Group
from .error_budget import FLUX_SHARE, Budget
from .predicted import allowed_rms

ENGINES = ("coverage", "rays", "raster")
"""Names that `engine=` may have."""
MAX_SAMPLES = 16
"""Most samples along a pixel's side by OpenGL."""


@dataclass(frozen=True, kw_only=True)
class ImageUse:
    """The use that a camera makes of an image: `capture` passes it to `Renderer.render`.

    Attributes
    ----------
    error_gain : float [1], 1e-9..1
        Factor by which later averaging, by a point spread function or of several cells a pixel, reduces an error that
        is independent from pixel to pixel. The tolerance holds after it.
    apart_px : float [px], 0..256
        Bodies that are smaller, and alone in their pixels, are in `Image.small_bodies` instead of the image: sub-pixel
        places that a point spread function can use. At a phase angle g those up to 1 / cos(g / 2) as large are, at
        most 4 times. Of several the smallest, as many as together cover no more than one body of this size; none in an
        emission that dims.
    out : (height, width) float32 array, optional
        Where the irradiance is drawn, instead of new memory.

    Raises
    ------
    ConfigError
    """

    error_gain: float = 1.0
    apart_px: float = 0.0
    out: np.ndarray | None = field(default=None, compare=False)

    def __post_init__(self):
        object.__setattr__(self, "error_gain", within("error_gain", self.error_gain, 1e-9, 1.0))
        object.__setattr__(self, "apart_px", within("apart_px", self.apart_px, 0.0, 256.0))


WHOLE_IMAGE = ImageUse()
"""The use of an image for its own sake: nothing is averaged, and all bodies are in it."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """A frame's demands on all its regions.

    Attributes
    ----------
    camera : PinholeCamera
    max_error : float [1] or mapping of str to float
        The tolerance, checked: RMS, or by unit.
    use : ImageUse
    engines : tuple of str
        Out of `ENGINES`: those that are there.
    has_gpu : bool
    has_sun_disc : bool
        Whether the scene's Sun is no point.
    samples : int or None, 1..`MAX_SAMPLES`
        Along a pixel's side, asked for instead of the planner's choice: drawn by OpenGL.
    engine : str or None
        The only engine that may draw.
    has_derivatives : bool
        Whether areas must be known: coverage draws all, on the image's pixels.

    Raises
    ------
    ConfigError
        The use is none; of samples and engine: no such ones, or not together.
    """

    camera: PinholeCamera
    max_error: float | Mapping[str, float]
    use: ImageUse = WHOLE_IMAGE
    engines: tuple[str, ...] = ENGINES
    has_gpu: bool = False
    has_sun_disc: bool = False
    samples: int | None = None
    engine: str | None = None
    has_derivatives: bool = False

    def __post_init__(self):
        if not isinstance(self.use, ImageUse):
            raise ConfigError("use", "must be an ImageUse of glrender.planner.request", self.use, "leave it out")
        if self.samples is not None:
            object.__setattr__(self, "samples", integer("samples", self.samples, 1, MAX_SAMPLES))
            if "raster" not in self.engines:
                raise ConfigError("samples", "are drawn by OpenGL, which draws no lamps", self.samples, "leave it out")
        if self.engine is not None and self.engine not in self.engines:
            raise ConfigError("engine", f"must be one of {', '.join(self.engines)}", self.engine)
        if self.samples is not None and self.engine not in (None, "raster"):
            raise ConfigError("engine", "must be raster, or left out, where samples are given", self.engine)

    def budget(self, group: Group, how: str) -> Budget:
        """The errors that bodies may have which are drawn so: by a `WindowPlan.how`.

        They are before the camera's point spread function, which leaves that of the flux as it is.
        """
        asked, error_gain = self.max_error, self.use.error_gain
        if not isinstance(asked, Mapping):
            return Budget(tolerance=asked / error_gain, flux=FLUX_SHARE * asked)
        allowed, bare = (allowed_rms(asked, group, how, gain) for gain in (error_gain, 1.0))
        return Budget(tolerance=allowed, flux=FLUX_SHARE * bare, flux_asked=asked.get("flux", math.inf))
