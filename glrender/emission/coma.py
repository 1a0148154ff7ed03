"""The coma of a scene: its settings, with what draws it by OpenGL and what traces it by rays."""

from __future__ import annotations

from ..engines.raster.gl.context import Context
from ..scene.scene import Scene
from .drawing import ComaDrawing
from .settings import ComaSettings
from .tracing import ComaTracing


class Coma(ComaSettings):
    """Dust around one body, a plug-in of the group `glrender.emission`."""

    def trace(self, scene: Scene) -> ComaTracing:
        """Its tables for a backend that traces rays."""
        return ComaTracing(self, scene)

    def open(self, context: Context, scene: Scene) -> ComaDrawing:
        """Its tables and textures in a context."""
        return ComaDrawing(self, context, scene)
