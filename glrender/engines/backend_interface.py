"""The interface of backends, which draw a scene: `Renderer`, and the plug-ins of the group `glrender.backend`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from ..scene.scene import Scene
from ..view.state import State
from .image import Image


class Backend(Protocol):
    """A backend draws a scene: a class of the group `glrender.backend`, called with a `Scene` and its own options.

    It may raise DeviceError, then and in `render`, with a message that says what to install.

    Attributes
    ----------
    settings : tuple of str
        Names of its own options.
    options : tuple of str
        Names of the options that its `render` takes besides those below. `capture` gives it ``use``, an `ImageUse`, and
        ``on_progress``, a callable, if they are among them.
    draws_lenses : bool
        Whether its images are those of a camera that distorts. Of one without this attribute `capture` takes a
        rectilinear image, and moves its light.
    """

    settings: tuple[str, ...]
    options: tuple[str, ...]
    scene: Scene

    @property
    def info(self) -> dict[str, Any]:
        """`backend`, `gl_renderer` and `gl_version` at least: text for people."""

    def render(self, state: State, camera: str | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None) -> Image:
        """Draw one frame, with the arguments of `Renderer.render`."""

    def close(self) -> None:
        """Release the backend's resources; a second call does no harm."""

    def __enter__(self) -> Backend: ...

    def __exit__(self, *exception) -> None: ...
