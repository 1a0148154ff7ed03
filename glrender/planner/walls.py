"""Light that facets throw on each other, which no engine here draws: its bound. Pure."""

from __future__ import annotations

import math

from ..brdf.integrals import greatest_albedo
from ..scene.scene import Body, Scene


def between_walls(scene: Scene) -> tuple[str, ...]:
    """Sentences on light between the walls of rooms, and of dips that lamps shine into, with its bound.

    Of light on a wall that scatters a share A at most, walls all around get 1 / (1 - A) times as much in all.
    """
    return tuple(f"{body.name}: light between walls, which all together get at most 1/(1 - A) = "
                 f"{_most_times(body):.3g} times the light, and dim ones more" for body in scene.bodies
                 if body.shape.inside or scene.lamps and not scene.hulls[body.name].is_convex)


def _most_times(body: Body) -> float:
    albedo = 0.0
    for part in body.parts:
        scale = 1.0 if part.albedo_map is None else float(part.albedo_map.max())
        albedo = max(albedo, greatest_albedo(part.brdf) * scale)
    return 1.0 / (1.0 - albedo) if albedo < 1.0 else math.inf
