"""The file of a server's own scene, which its first worker opens: the server's process has no use for shapes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from glrender import Scene


class SceneFile(NamedTuple):
    """A scene file, or with `is_belief` a scenario file whose [belief] makes a scene."""

    path: Path
    is_belief: bool = False

    def load(self) -> Scene:
        """Read it, and the shapes that it names.

        Raises
        ------
        ConfigError, ShapeError
        """
        # Here: the process that only names the file starts a second sooner without what opens it.
        if self.is_belief:
            from glrender.scenario import load_believed_scene

            return load_believed_scene(self.path)
        from glrender import load_scene

        return load_scene(self.path)
