"""glrender's error tree; each class is one kind of reply code on the wire."""

from __future__ import annotations

from glrender_camera.errors import ConfigError, GlrenderError, error_path

__all__ = ["ConfigError", "DeviceError", "GlrenderError", "PluginError", "ProtocolError", "SceneError", "ShaderError",
           "ShapeError", "error_path"]


class SceneError(ConfigError):
    """A state that this scene cannot render: an unknown body or camera, a camera inside a body."""

    code = "scene"


class ShapeError(SceneError):
    """A shape file that cannot be read or is not a surface."""

    code = "shape"


class PluginError(ConfigError):
    """A plug-in that cannot be used: a second owner of a name, a missing dependency, another version's interface."""


class ShaderError(GlrenderError):
    """A shader that does not compose or compile."""

    code = "shader"


class DeviceError(GlrenderError):
    """OpenGL is missing, or failed."""

    code = "device"


class ProtocolError(ConfigError):
    """A message that breaks the wire protocol."""

    code = "protocol"
