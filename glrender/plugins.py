"""Plug-ins are found, never imported by name: entry-point groups, each name with one owner."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from . import brdf
from .brdf import Law
from .errors import ConfigError

BRDF_GROUP = "glrender.brdf"


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
