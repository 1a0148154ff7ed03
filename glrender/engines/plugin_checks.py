"""Checks of plug-ins that need a context or an image: a law's twin in GLSL, and an emission's light."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..base.errors import PluginError, ShaderError
from ..brdf import Law
from ..planner.plan import EmissionPlan
from ..scene.plugins.checks import blamed_on, check_values, directions, is_foreign, named

# Largest difference over the law's RMS [1]: float32, and opposition surges that are steep in it.
_TWIN_TOLERANCE = 0.01


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
            drawn = evaluate(law, *directions())
        except ShaderError as error:
            raise PluginError(named(type(law)), f"must have a twin that compiles: {error}") from error
        truth = law.brdf(*directions())
    check_values(law, "twin in GLSL", drawn)
    apart, scale = (float(np.sqrt(np.mean(np.square(x)))) for x in (drawn - truth, truth))
    if not apart <= _TWIN_TOLERANCE * scale:
        raise PluginError(named(type(law)), f"must have a twin in GLSL within {_TWIN_TOLERANCE:.0%} RMS of its Python",
                          apart / max(scale, 1e-300))


def check_light(emission: Any, irradiance: np.ndarray, plan: Any) -> None:
    """Refuse an image of a foreign emission that is no light, or comes without a plan.

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
