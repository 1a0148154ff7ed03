"""glrender_camera: projection, optics and detector of the spacecraft's cameras. No OpenGL."""

from .aberrations import Aberrations
from .camera import CameraModel
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

__all__ = ["Aberrations", "AutoExposure", "BrownConrady", "CameraModel", "ConfigError", "Detector", "DistortingLens",
           "Frame", "GlrenderError", "MosaicModel", "Optics", "PinholeCamera", "PointSources", "StarCatalogue",
           "StrayLight", "hipparcos", "lens_of", "stars_in_view", "sun_in_view", "time_average"]
