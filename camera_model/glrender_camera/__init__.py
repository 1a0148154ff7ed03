"""glrender_camera: projection, optics and detector of the spacecraft's cameras. No OpenGL."""

from .aberrations import Aberrations
from .camera import CameraModel, Frame
from .detector import Detector
from .distortion import BrownConrady
from .errors import ConfigError, GlrenderError
from .exposure import AutoExposure
from .optics import Optics
from .projection import PinholeCamera
from .shutter import time_average
from .straylight import StrayLight

__all__ = ["Aberrations", "AutoExposure", "BrownConrady", "CameraModel", "ConfigError", "Detector", "Frame",
           "GlrenderError", "Optics", "PinholeCamera", "StrayLight", "time_average"]
