"""Plug-ins are found, never imported by name: entry-point groups, each name with one owner."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

from . import brdf
from .brdf import Law
from .errors import ConfigError

if TYPE_CHECKING:
    from .scene import Scene

BRDF_GROUP = "glrender.brdf"
BACKEND_GROUP = "glrender.backend"
EMISSION_GROUP = "glrender.emission"
OPENGL_BACKENDS = ("auto", "egl", "osmesa")


@cache
def laws() -> dict[str, type[Law]]:
    """Reflectance laws by name: glrender's own, and those of the group `glrender.brdf`.

    Raises
    ------
    ConfigError
        Two owners of one name.
    """
    found = {law.glsl: law for name in brdf.__all__
             if isinstance(law := getattr(brdf, name), type) and issubclass(law, Law) and law is not Law}
    for entry in entry_points(group=BRDF_GROUP):
        if entry.name in found:
            raise ConfigError(f"{BRDF_GROUP}.{entry.name}", "has two owners", entry.value)
        found[entry.name] = entry.load()
    return found


@cache
def backends() -> dict[str, EntryPoint]:
    """Backends beside OpenGL, by name; each loads a class with the interface of `Renderer`.

    Raises
    ------
    ConfigError
        Two owners of one name.
    """
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=BACKEND_GROUP):
        if entry.name in found or entry.name in OPENGL_BACKENDS:
            raise ConfigError(f"{BACKEND_GROUP}.{entry.name}", "has two owners", entry.value)
        found[entry.name] = entry
    return found


@cache
def emissions() -> dict[str, EntryPoint]:
    """Light that no surface scatters, by name; each loads a class as in `emission_frame.Emission`.

    Raises
    ------
    ConfigError
        Two owners of one name.
    """
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=EMISSION_GROUP):
        if entry.name in found:
            raise ConfigError(f"{EMISSION_GROUP}.{entry.name}", "has two owners", entry.value)
        found[entry.name] = entry
    return found


def open_renderer(scene: Scene, backend: str = "auto", device_index: int | None = None) -> Any:
    """A `Renderer`, or the plug-in of that name with the same interface, e.g. ``raytrace``.

    Raises
    ------
    ConfigError
        No such backend.
    DeviceError
        The backend does not work here; the message says what to install.
    """
    if backend in OPENGL_BACKENDS:
        from .renderer import Renderer

        return Renderer(scene, backend=backend, device_index=device_index)
    if backend not in backends():
        raise ConfigError("backend", f"must be one of {', '.join((*OPENGL_BACKENDS, *backends()))}", backend)
    return backends()[backend].load()(scene)
