"""glrender_camera: projection, optics and detector of the spacecraft's cameras. No OpenGL.

Each name is loaded when it is first asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .aberrations import Aberrations
    from .camera import CameraModel
    from .compression import Compression
    from .detector import Detector
    from .distortion import BrownConrady
    from .errors import ConfigError, GlrenderError
    from .exposure import AutoExposure
    from .frame import Frame
    from .mosaic import MosaicModel
    from .optics import Optics
    from .points import PointSources
    from .projection import PinholeCamera
    from .resample import DistortingLens, lens_of
    from .shutter import time_average
    from .stars import StarCatalogue, hipparcos, stars_in_view, sun_in_view
    from .straylight import StrayLight

__all__ = ["Aberrations", "AutoExposure", "BrownConrady", "CameraModel", "Compression", "ConfigError", "Detector",
           "DistortingLens", "Frame", "GlrenderError", "MosaicModel", "Optics", "PinholeCamera", "PointSources",
           "StarCatalogue", "StrayLight", "hipparcos", "lens_of", "stars_in_view", "sun_in_view", "time_average"]

_NAMES = {
    ".aberrations": ("Aberrations",),
    ".camera": ("CameraModel",),
    ".compression": ("Compression",),
    ".detector": ("Detector",),
    ".distortion": ("BrownConrady",),
    ".errors": ("ConfigError", "GlrenderError"),
    ".exposure": ("AutoExposure",),
    ".frame": ("Frame",),
    ".mosaic": ("MosaicModel",),
    ".optics": ("Optics",),
    ".points": ("PointSources",),
    ".projection": ("PinholeCamera",),
    ".resample": ("DistortingLens", "lens_of"),
    ".shutter": ("time_average",),
    ".stars": ("StarCatalogue", "hipparcos", "stars_in_view", "sun_in_view"),
    ".straylight": ("StrayLight",),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found = getattr(import_module(_HOMES[name], __name__), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
