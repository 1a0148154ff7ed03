"""Plug-ins are tried before they are trusted: an error names the plug-in, when its scene opens.

glrender's own classes are not tried here: an error there is a bug, and keeps its traceback.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...base.errors import GlrenderError, PluginError
from ...brdf import Law

log = logging.getLogger(__name__)

_DIRECTIONS = 512


def is_foreign(plugin: type) -> bool:
    """Whether a class comes from a package other than glrender."""
    return plugin.__module__.split(".")[0] != "glrender"


def named(plugin: type) -> str:
    """A plug-in's class, for people."""
    return f"{plugin.__module__}.{plugin.__qualname__}"


@contextmanager
def blamed_on(plugin: type) -> Iterator[None]:
    """An error that a foreign class raises becomes a PluginError that names it; errors of glrender's own stay."""
    try:
        yield
    except GlrenderError:
        raise
    except Exception as error:
        if not is_foreign(plugin):
            raise
        log.warning("plug-in %s failed", named(plugin), exc_info=True)
        raise PluginError(named(plugin), f"failed: {type(error).__name__}: {error}",
                          hint="its package is at fault; the log has the traceback") from error


def try_law(law: Law) -> None:
    """Ask a foreign law for its values: finite, never negative, one for each direction, and all its uniforms.

    Raises
    ------
    PluginError
    """
    if not is_foreign(type(law)):
        return
    with blamed_on(type(law)):
        given = law.uniforms()
        wrong = [name for name in law.uniform_fields if name not in given or not _is_finite(given[name])]
        value = np.asarray(law.brdf(*directions()))
    if wrong:
        raise PluginError(named(type(law)), f"must give finite numbers for {', '.join(wrong)} in uniforms()", given)
    check_values(law, "brdf", value)


def directions() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sun, camera and normal (N, 3): at least half lit and seen, the last ones at zero phase."""
    vectors = np.random.default_rng(7).normal(size=(3, _DIRECTIONS, 3))
    to_sun, to_camera, normal = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    normal[::2] = (to_sun + to_camera)[::2]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    to_camera[-8:] = to_sun[-8:]
    return to_sun, to_camera, normal


def _is_finite(value: Any) -> bool:
    array = np.asarray(value)
    return array.dtype.kind in "fiu" and bool(np.isfinite(array).all())


def check_values(law: Law, what: str, value: np.ndarray) -> None:
    """Refuse values (N,) of a law that are not finite, or below 0."""
    if value.shape != (_DIRECTIONS,):
        raise PluginError(named(type(law)), f"must give one value for each direction in its {what}", value.shape)
    good = np.isfinite(value) & (value >= 0.0)
    if not good.all():
        raise PluginError(named(type(law)), f"must give finite values >= 0 [1/sr] in its {what}", value[~good][0])
