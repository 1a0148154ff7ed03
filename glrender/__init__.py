"""glrender: headless OpenGL frames for closed-loop navigation around small bodies.

Importing it opens no context and loads no OpenGL: laws, scenes and cameras work on a bare machine.
"""

from __future__ import annotations

from importlib import import_module

from glrender_camera import PinholeCamera

from .base import rotations as frames
from .base.attitude import from_basilisk_mrp, from_matlab_dcm, from_matlab_quat, from_ros, from_scipy, from_spice
from .base.errors import ConfigError, DeviceError, GlrenderError, ProtocolError, SceneError, ShaderError, ShapeError
from .engines.image import Image  # noqa: F401 (glrender.Image)
from .scene.detail.config import Boulders, Craters, Detail, Noise
from .scene.scene import Body, Scene, load_scene
from .scene.shape import generate
from .scene.shape.shape import Shape
from .scene.stars import Stars
from .view.state import Pose, State

__version__ = "0.1.0"
# `Image` is a name of this module that `import *` leaves alone: it would hide PIL's.
__all__ = ["Body", "Boulders", "Capture", "ConfigError", "Craters", "Detail", "DeviceError", "GlrenderError", "Noise",
           "PinholeCamera", "Pose", "ProtocolError", "Renderer", "Scene", "SceneError", "Shape", "ShaderError",
           "ShapeError", "Stars", "State", "draw_still", "frames", "from_basilisk_mrp", "from_matlab_dcm",
           "from_matlab_quat", "from_ros", "from_scipy", "from_spice", "generate", "load_scene", "open_renderer",
           "take_frame"]


# Not before they are asked for: the renderer loads OpenGL, frames load compiled loops.
_LATER = {"Renderer": ".renderer", "open_renderer": ".renderer", "Capture": ".capture.capture",
          "draw_still": ".capture.capture", "take_frame": ".capture.capture"}


def __getattr__(name: str):
    if name in _LATER:
        return getattr(import_module(_LATER[name], __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
