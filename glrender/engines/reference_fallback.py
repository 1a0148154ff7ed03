"""Reference fallback: another backend draws a frame whose error exceeds the tolerance, where the caller allows it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from glrender_camera import PinholeCamera

from ..base.errors import ConfigError, DeviceError
from ..base.progress import Progress
from ..planner.plan import RenderPlan
from ..scene.plugins.registry import backends
from ..scene.scene import Scene
from ..view.state import State
from .image import Image

SLOW_BACKENDS = ("raytrace", "cycles")
"""Slow backends in the order in which they are tried."""
# What the slow frame models is what OpenGL models: light between facets is asked for by backend="cycles".
_OPTIONS: dict[str, dict[str, Any]] = {"cycles": {"bounces": 0}}


def checked_allow_slow(value: object) -> bool | str:
    """`allow_slow` of a request: true, false, or the slow backend's name.

    Raises
    ------
    ConfigError
    """
    if isinstance(value, bool) or (isinstance(value, str) and value in SLOW_BACKENDS):
        return value
    raise ConfigError("allow_slow", f"must be true, false, or one of {', '.join(SLOW_BACKENDS)}", value)


def misses_tolerance(plan: RenderPlan) -> bool:
    """Whether a frame's error is above the tolerance."""
    return bool(plan.missed)


def with_emission(slow: RenderPlan, fast: RenderPlan) -> RenderPlan:
    """A slow frame's plan with the emission that OpenGL added to it."""
    if not fast.emission:
        return slow
    return replace(slow, emission=fast.emission, roi=fast.roi)


class SlowFrames:
    """The slow backends of a scene, each opened when it is first needed and kept.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene):
        # To a slow frame OpenGL adds the emission itself.
        self._scene = replace(scene, emission=())
        self._opened: dict[str, Any] = {}

    def close(self) -> None:
        """Release the backends; more frames open them anew."""
        for backend in self._opened.values():
            backend.close()
        self._opened.clear()

    def instead_of(self, fast: Image, allow_slow: bool | str, state: State, camera: PinholeCamera, *, error_gain: float,
                   on_progress: Callable[[float], None] | None) -> Image:
        """The surfaces once more, by a backend that samples until their error is within the tolerance.

        Parameters
        ----------
        fast : Image
            What OpenGL made of them.
        allow_slow : bool or str
            True for the first backend that meets the tolerance, else its name.
        state : State
        camera : PinholeCamera
            One of the scene's, or one that draws for it.
        error_gain : float [1]
            What the camera's PSF leaves of the error.
        on_progress : callable, optional
            Called with the share done, 0..1, of all the backends that may draw: it rises to 1 when one is enough.

        Returns
        -------
        Image
            The one of the least error, with warnings that say who drew it and why no other did. Of a dark and a lit one
            it is the lit one: a dark one's error is a share of light that may have been missed.

        Raises
        ------
        ConfigError
            The backend named does not work here.
        DeviceError
            It failed.
        """
        best, reasons, progress = fast, [], Progress(on_progress)
        names = SLOW_BACKENDS if allow_slow is True else (allow_slow,)
        for index, name in enumerate(names):
            try:
                backend = self._open(name)
            except DeviceError as error:
                if allow_slow is not True:
                    raise ConfigError("allow_slow", f"backend {name!r} does not work here: {error}", name) from error
                reasons.append(f"{name} does not work here: {error}")
                continue
            slow = _drawn(backend, name, fast, state, camera, error_gain,
                          progress.part(index / len(names), (index + 1) / len(names)))
            if _is_lit(best) and not _is_lit(slow):
                reasons.append(f"{name} finds no light")
                continue
            if not misses_tolerance(slow.plan):
                progress.finish()
                return slow
            best = min(best, slow, key=lambda image: (not _is_lit(image), image.plan.excess))
            reasons.append(f"{name} leaves {slow.plan.predicted_error:.2g}")
        progress.finish()
        return replace(best, plan=replace(best.plan, warnings=(*best.plan.warnings, *reasons)))

    def _open(self, name: str) -> Any:
        if name not in self._opened:
            self._opened[name] = backends()[name](self._scene, **_OPTIONS.get(name, {}))
        return self._opened[name]


def _is_lit(image: Image) -> bool:
    return bool(image.irradiance_W_m2.any()) or any(body.irradiance_W_m2 > 0.0 for body in image.small_bodies)


def _drawn(backend: Any, name: str, fast: Image, state: State, camera: PinholeCamera, error_gain: float,
           on_progress: Callable[[float], None]) -> Image:
    plan = fast.plan
    takes_progress = "on_progress" in inspect.signature(backend.render).parameters
    slow = backend.render(state, camera, max_error=min(plan.max_error / error_gain, 1.0),
                          **({"on_progress": on_progress} if takes_progress else {}))
    reached = slow.plan.predicted_error * error_gain
    told = (f"drawn by {name}: OpenGL leaves an error of {plan.predicted_error:.2g}, above the tolerance of "
            f"{plan.max_error:g}",)
    # What it misses before the point spread function may be met behind it.
    before = tuple(slow.plan.misses().values())
    kept = tuple(text for text in slow.plan.warnings if not text.startswith(before))
    made = replace(slow.plan, max_error=plan.max_error, predicted_error=reached, asked=plan.asked)
    return replace(slow, plan=replace(made, warnings=(*kept, *made.misses().values(), *told)))
