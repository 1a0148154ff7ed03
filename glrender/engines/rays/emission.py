"""Comae in the frames of backends that trace the full shapes: their light is added to the surfaces'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from glrender_camera import PinholeCamera

from ...base.errors import DeviceError
from ...planner.plan import EMISSION_LEFT_OUT, RenderPlan
from ...scene.scene import Scene
from ...view.state import State
from ...view.view import BodyView
from ..emission_interface import Traceable, TracedEmission, TracedFrame
from .engine import RayEngine


class Emitted:
    """A scene's emission plug-ins that can be traced.

    Parameters
    ----------
    scene : Scene
    rays : callable
        Gives the RayEngine that finds depths, when the first frame needs it.
    """

    def __init__(self, scene: Scene, rays: Callable[[], RayEngine]):
        self._scene, self._rays = scene, rays
        # Tables are made when the first frame needs them.
        self._opened: list[TracedEmission] | None = None

    def add(self, irradiance: np.ndarray, state: State, camera: PinholeCamera, views: list[BodyView],
            plan: RenderPlan) -> RenderPlan:
        """Add their light to (height, width) float32 [W/m2], in place; the plan with it, or with the parts left out."""
        emissions = self._scene.emission
        if not emissions:
            return plan
        left_out = tuple(f"{EMISSION_LEFT_OUT} {each.body}" for each in emissions if not isinstance(each, Traceable))
        able = [each for each in emissions if isinstance(each, Traceable)]
        try:
            rays = self._rays() if able else None
        except DeviceError as error:
            left_out += tuple(f"{EMISSION_LEFT_OUT} {each.body}: {error}" for each in able)
            able = []
        if not able:
            return replace(plan, left_out=plan.left_out + left_out)
        if self._opened is None:
            self._opened = [each.trace(self._scene) for each in able]
        named = {view.name: view for view in views}
        frame = TracedFrame(
            state=state, camera=camera, views=named, max_error=plan.max_error,
            solar_irradiance_1au_W_m2=self._scene.solar_irradiance_of(camera),
            ranges=lambda pixel, names: rays.ranges(pixel, camera, [named[name] for name in names]),
            sunlit=lambda r_body_m, name: rays.sunlit(r_body_m - named[name].centre_m, named[name], views))
        added = tuple(each.add(irradiance, frame) for each in self._opened)
        return replace(plan, emission=added, roi=(0, 0, camera.width_px, camera.height_px),
                       left_out=plan.left_out + left_out)
