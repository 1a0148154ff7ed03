"""The emissions of a scene in a context: each plug-in adds its light to a frame whose surfaces are drawn."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from ..planner.plan import RenderPlan
from ..scene.plugins.checks import blamed_on
from ..scene.scene import Scene
from ..view.state import State
from .emission_interface import EmissionFrame
from .plugin_checks import check_light
from .raster.gl.context import Context
from .raster.shadow_maps import Shadows
from .raster.surface_pass import Frame, SurfacePass

# Side of a shadow map that only a coma asks for.
_SHADOW_PX = 1024


class Emissions:
    """Opens the emission plug-ins of a scene.

    Parameters
    ----------
    context : Context
    scene : Scene
    surfaces : SurfacePass
    shadows : Shadows
    """

    def __init__(self, context: Context, scene: Scene, surfaces: SurfacePass, shadows: Shadows):
        self._scene, self._surfaces, self._shadows, self._opened = scene, surfaces, shadows, []
        with ExitStack() as stack:
            for emission in scene.emission:
                with blamed_on(type(emission)):
                    self._opened.append(stack.enter_context(emission.open(context, scene)))
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Release what the plug-ins have in the context."""
        self._stack.close()

    def __bool__(self) -> bool:
        return bool(self._opened)

    @property
    def dims(self) -> bool:
        """Whether one may dim the image: then no light may come as points, which it does not reach."""
        return any(getattr(emission, "dims", True) for emission in self._scene.emission)

    def add(self, irradiance: np.ndarray, state: State, frame: Frame, plan: RenderPlan) -> RenderPlan:
        """Add their light to the irradiance in place; the plan with their accounts: it falls on the whole image."""
        views, camera = {view.name: view for view in frame.views}, frame.camera

        def draw_surfaces(target, stage, bounds_px, grid):
            self._surfaces.draw(replace(frame, shadows={}), target, stage, bounds_px, grid, tuple(views))

        def shadow_map(name):
            shadow = frame.shadows.get(name)
            # The shadow falls on dust far from all that the image shows of the body.
            if shadow is None or not views[name].is_whole:
                bodies = [replace(body, shadow_map_px=_SHADOW_PX if body.name == name else None)
                          for body in frame.bodies]
                shadow = self._shadows.draw(frame.views, bodies, camera, is_whole=True)[0][name]
            return shadow.shadow_map, shadow.shadow_from_body

        given = EmissionFrame(
            state=state, camera=camera, views=views, max_error=plan.max_error,
            solar_irradiance_1au_W_m2=self._scene.solar_irradiance_of(camera),
            rois=tuple(window.roi for window in plan.windows), draw_surfaces=draw_surfaces, shadow_map=shadow_map)
        added = []
        for emission, opened in zip(self._scene.emission, self._opened, strict=True):
            with blamed_on(type(emission)):
                added.append(opened.add(irradiance, given))
            check_light(emission, irradiance, added[-1])
        return replace(plan, emission=tuple(added), roi=(0, 0, camera.width_px, camera.height_px))
