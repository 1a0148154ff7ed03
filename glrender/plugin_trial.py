"""Plug-ins are tried before they are trusted: what one does wrong is told with its name, when its scene opens.

glrender's own classes are not tried here: what is wrong with those is a bug, and keeps its traceback.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from .brdf import Law
from .emission_frame import EmissionPlan
from .errors import GlrenderError, PluginError, ShaderError

log = logging.getLogger(__name__)

_DIRECTIONS = 512
# Of the law's RMS: float32, and opposition surges that are steep in it.
_TWIN_TOLERANCE = 0.01


def is_foreign(plugin: type) -> bool:
    """Whether a class comes from a package other than glrender."""
    return plugin.__module__.split(".")[0] != "glrender"


def named(plugin: type) -> str:
    """A plug-in's class, for people."""
    return f"{plugin.__module__}.{plugin.__qualname__}"


@contextmanager
def blamed_on(plugin: type) -> Iterator[None]:
    """What a foreign class raises becomes a PluginError that names it; rules of glrender that it applies stay."""
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
        value = np.asarray(law.brdf(*_directions()))
    if wrong:
        raise PluginError(named(type(law)), f"must give finite numbers for {', '.join(wrong)} in uniforms()", given)
    _check_values(law, "brdf", value)


def try_twin(law: Law, evaluate: Callable[..., np.ndarray]) -> None:
    """Compile a foreign law's GLSL and hold it against its Python: `evaluate` is `Renderer.evaluate_brdf`.

    Raises
    ------
    PluginError
    """
    if not is_foreign(type(law)):
        return
    with blamed_on(type(law)):
        try:
            drawn = evaluate(law, *_directions())
        except ShaderError as error:
            raise PluginError(named(type(law)), f"must have a twin that compiles: {error}") from error
        truth = law.brdf(*_directions())
    _check_values(law, "twin in GLSL", drawn)
    apart, scale = (float(np.sqrt(np.mean(np.square(x)))) for x in (drawn - truth, truth))
    if not apart <= _TWIN_TOLERANCE * scale:
        raise PluginError(named(type(law)), f"must have a twin in GLSL within {_TWIN_TOLERANCE:.0%} RMS of its Python",
                          apart / max(scale, 1e-300))


def check_light(emission: Any, irradiance: np.ndarray, plan: Any) -> None:
    """Refuse what a foreign emission made of an image if it is no light, or tells no plan.

    Raises
    ------
    PluginError
    """
    if not is_foreign(type(emission)):
        return
    if not isinstance(plan, EmissionPlan) or not plan.predicted_error >= 0.0:
        raise PluginError(named(type(emission)), "must return an EmissionPlan with an error >= 0 from add", plan)
    if not (np.isfinite(irradiance).all() and irradiance.min() >= 0.0):
        raise PluginError(named(type(emission)), "must leave irradiance finite and >= 0",
                          f"{int(np.sum(~(np.isfinite(irradiance) & (irradiance >= 0.0))))} pixels that are not")


def _directions() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sun, camera and normal (N, 3): half of them lit and seen at least, the last ones at zero phase."""
    vectors = np.random.default_rng(7).normal(size=(3, _DIRECTIONS, 3))
    to_sun, to_camera, normal = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    normal[::2] = (to_sun + to_camera)[::2]
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    to_camera[-8:] = to_sun[-8:]
    return to_sun, to_camera, normal


def _is_finite(value: Any) -> bool:
    array = np.asarray(value)
    return array.dtype.kind in "fiu" and bool(np.isfinite(array).all())


def _check_values(law: Law, what: str, value: np.ndarray) -> None:
    if value.shape != (_DIRECTIONS,):
        raise PluginError(named(type(law)), f"must give one value for each direction in its {what}", value.shape)
    good = np.isfinite(value) & (value >= 0.0)
    if not good.all():
        raise PluginError(named(type(law)), f"must give finite values >= 0 [1/sr] in its {what}", value[~good][0])
