"""glrender: headless OpenGL frames for closed-loop navigation around small bodies.

Each name is loaded when it is first asked for: importing the package takes no time and opens no context.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from glrender_camera import PinholeCamera

    from .base import rotations as frames
    from .base.attitude import from_basilisk_mrp, from_matlab_dcm, from_matlab_quat, from_ros, from_scipy, from_spice
    from .base.errors import ConfigError, DeviceError, GlrenderError, ProtocolError, SceneError, ShaderError, ShapeError
    from .capture.capture import Capture, draw_still, take_frame
    from .capture.comparison import Comparison, compare_frame
    from .engines.image import Image  # noqa: F401 (not in __all__: `import *` would hide PIL's)
    from .engines.rays.laser_ranges import RangeNoise, Ranges, laser_ranges
    from .renderer import Renderer, open_renderer
    from .scene.detail.config import Boulders, Craters, Detail, Noise
    from .scene.lamp import Lamp
    from .scene.scene import Body, Scene, load_scene
    from .scene.shape import generate
    from .scene.shape.regions import Region
    from .scene.shape.shape import Shape
    from .scene.stars import Stars
    from .view.state import Pose, State

__version__ = version("glrender")
__all__ = ["Body", "Boulders", "Capture", "Comparison", "ConfigError", "Craters", "Detail", "DeviceError",
           "GlrenderError", "Lamp", "Noise", "PinholeCamera", "Pose", "ProtocolError", "RangeNoise", "Ranges", "Region",
           "Renderer", "Scene", "SceneError", "Shape", "ShaderError", "ShapeError", "Stars", "State", "compare_frame",
           "draw_still", "frames", "from_basilisk_mrp", "from_matlab_dcm", "from_matlab_quat", "from_ros", "from_scipy",
           "from_spice", "generate", "laser_ranges", "load_scene", "open_renderer", "take_frame"]

_MODULES = {"frames": ".base.rotations", "generate": ".scene.shape.generate"}
_NAMES = {
    "glrender_camera": ("PinholeCamera",),
    ".base.attitude": ("from_basilisk_mrp", "from_matlab_dcm", "from_matlab_quat", "from_ros", "from_scipy",
                       "from_spice"),
    ".base.errors": ("ConfigError", "DeviceError", "GlrenderError", "ProtocolError", "SceneError", "ShaderError",
                     "ShapeError"),
    ".capture.capture": ("Capture", "draw_still", "take_frame"),
    ".capture.comparison": ("Comparison", "compare_frame"),
    ".engines.image": ("Image",),
    ".engines.rays.laser_ranges": ("RangeNoise", "Ranges", "laser_ranges"),
    ".renderer": ("Renderer", "open_renderer"),
    ".scene.detail.config": ("Boulders", "Craters", "Detail", "Noise"),
    ".scene.lamp": ("Lamp",),
    ".scene.scene": ("Body", "Scene", "load_scene"),
    ".scene.shape.regions": ("Region",),
    ".scene.shape.shape": ("Shape",),
    ".scene.stars": ("Stars",),
    ".view.state": ("Pose", "State"),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        found = import_module(_MODULES[name], __name__)
    elif name in _HOMES:
        found = getattr(import_module(_HOMES[name], __name__), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_HOMES})
