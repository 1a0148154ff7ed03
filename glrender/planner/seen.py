"""The bodies of a state before a camera: all that the plan of a frame asks of each, derived once. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from glrender_camera import PinholeCamera

from ..scene.scene import Scene
from ..view.occluders import casters
from ..view.state import State
from ..view.view import BodyView, largest_phase, view_bodies
from .error_model import BodyTraits
from .penumbra import Penumbra, penumbra_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """One body in one frame."""

    view: BodyView
    traits: BodyTraits
    """With the slope of the surface detail that is drawn."""
    casters: tuple[str, ...] = ()
    """Other bodies that may cast a shadow on it."""
    penumbra: Penumbra = Penumbra()
    detail_m: float | None = None
    """Scale of the finest surface detail that pixels resolve [m]; None without any."""
    detail_layers: int = 0

    @classmethod
    def of(cls, view: BodyView, traits: BodyTraits, camera: PinholeCamera, casters: tuple[str, ...] = (),
           penumbra: Penumbra | None = None) -> Seen:
        """A body with the surface detail that the camera resolves."""
        made = cls(view=view, traits=traits, casters=casters, penumbra=penumbra or Penumbra())
        footprint_m = view.depth_m[0] / camera.focal_length_px
        relief = traits.relief
        if relief is None or not view.is_visible or not (active := relief.active(footprint_m)):
            return made
        return replace(made, traits=replace(traits, detail_slope=relief.slope_rms(footprint_m)),
                       detail_m=float(max(relief.scales_m()[active].min(), 2.0 * footprint_m)),
                       detail_layers=len(active))


def seen_bodies(state: State, camera: PinholeCamera, scene: Scene, traits: Sequence[BodyTraits]) -> tuple[Seen, ...]:
    """All bodies of a scene, in its order and that of their traits; where it has lamps, phases are of all lights.

    Raises
    ------
    SceneError
        The state cannot be rendered: an unknown body, a camera inside a body.
    """
    hulls, found = scene.hulls, []
    views = view_bodies(state, camera, hulls)
    if scene.lamps:
        solar_W_m2 = scene.solar_irradiance_of(camera)
        views = [replace(view, phase_rad=largest_phase(view, scene.lamps, camera, solar_W_m2)) for view in views]
    for view, known in zip(views, traits, strict=True):
        sun_radius_rad = view.sun_radius_rad if scene.sun_disc else 0.0
        cast = casters(view, views, hulls, sun_radius_rad) if view.is_visible else []
        found.append(Seen.of(view, known, camera, tuple(caster.name for caster in cast),
                             penumbra_of(view, cast, hulls, sun_radius_rad)))
    return tuple(found)
