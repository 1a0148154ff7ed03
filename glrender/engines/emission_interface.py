"""The interface of an emission plug-in (entry-point group `glrender.emission`): its input and its output.

A plug-in is a class with `from_table(table, resolve, bodies)`, which reads a `[[emission]]` table of a scene and
returns an object with `body`, the name of the body that the light is around, and `open(context, scene)`, which
gives a context manager with `add(irradiance, frame)`. It may be `Traceable` too. An emission with `dims`
false never dims the surfaces: small bodies in it may then be points apart from the image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from glrender_camera import PinholeCamera

from ..planner.plan import EmissionPlan
from ..scene.scene import Body, Scene
from ..view.state import State
from ..view.view import BodyView
from .raster.gl.context import Context
from .raster.gl.targets import ShadowMap, Target


@dataclass(frozen=True, kw_only=True, eq=False)
class EmissionFrame:
    """A frame after its surfaces were drawn.

    Attributes
    ----------
    state : State
    camera : PinholeCamera
    views : dict of str to BodyView
        In the scene's order.
    max_error : float [1]
    solar_irradiance_1au_W_m2 : float [W/m2]
    rois : tuple of (int, int, int, int) [px]
        Where surfaces may be: x0, y0, x1, y1, one past the last.
    draw_surfaces : callable
        (target, stage, bounds_px, grid) draws all bodies by a fragment shader of the surface pass.
    shadow_map : callable
        (body name) gives its ShadowMap and `shadow_from_body` (4, 4).
    """

    state: State
    camera: PinholeCamera
    views: Mapping[str, BodyView]
    max_error: float
    solar_irradiance_1au_W_m2: float
    rois: tuple[tuple[int, int, int, int], ...]
    draw_surfaces: Callable[[Target, str, tuple[float, float, float, float], tuple[int, int]], None]
    shadow_map: Callable[[str], tuple[ShadowMap, np.ndarray]]


@dataclass(frozen=True, kw_only=True, eq=False)
class TracedFrame:
    """A frame whose surfaces were drawn by a backend that traces rays, in float64.

    Attributes
    ----------
    state, camera, views, max_error, solar_irradiance_1au_W_m2
        As of `EmissionFrame`.
    ranges : callable
        (places (N, 2) [px], names of bodies) gives the distance (N,) float64 [m] of the first surface, or infinity.
    sunlit : callable
        (points (N, 3) [m] in a body's frame, its name) gives whether each has a free line (N,) to the Sun's middle.
    """

    state: State
    camera: PinholeCamera
    views: Mapping[str, BodyView]
    max_error: float
    solar_irradiance_1au_W_m2: float
    ranges: Callable[[np.ndarray, Iterable[str]], np.ndarray]
    sunlit: Callable[[np.ndarray, str], np.ndarray]


class TracedEmission(Protocol):
    """An emission for backends that trace rays."""

    def add(self, irradiance: np.ndarray, frame: TracedFrame) -> EmissionPlan:
        """Add light to the irradiance, as `EmissionPass.add` does."""


@runtime_checkable
class Traceable(Protocol):
    """An emission that backends which trace rays draw too; these leave out others, and say so."""

    def trace(self, scene: Scene) -> TracedEmission:
        """Prepare it for a scene."""


class EmissionPass(Protocol):
    """An emission with its resources on a device."""

    def __enter__(self) -> EmissionPass: ...

    def __exit__(self, *exception) -> None: ...

    def add(self, irradiance: np.ndarray, frame: EmissionFrame) -> EmissionPlan:
        """Add its light to the irradiance (height, width) float32 [W/m2], in place; it may dim the light there."""


class Emission(Protocol):
    """Light of a scene that no surface scatters."""

    body: str

    @classmethod
    def from_table(cls, table: Mapping[str, Any], resolve: Callable[[str, object], Path],
                   bodies: Mapping[str, Body]) -> Emission:
        """From a scene's `[[emission]]` table less its `kind`; `resolve(field, name)` is a file's path."""

    def open(self, context: Context, scene: Scene) -> EmissionPass:
        """Create the resources of the emission in a context."""
