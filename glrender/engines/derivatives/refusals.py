"""Features that have no derivatives are refused by name, with what to change."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from glrender_camera import PinholeCamera

from ...base.errors import ConfigError
from ...planner.request import Request
from ...planner.seen import Seen
from ...scene.scene import Body, Scene
from ...scene.shape.shape import Shape
from ...scene.shape.shells import pieces
from ...view.regions import touching


def check_derivable(names: Sequence[str], scene: Scene, request: Request, seen: Sequence[Seen]) -> None:
    """Refuse derivatives of a frame that is not drawn by the exact areas of facets of one body.

    Raises
    ------
    ConfigError
        What stands in the way, and what to change.
    """
    if request.engine not in (None, "coverage"):
        raise ConfigError("engine", "must be coverage, or left out, with derivatives", request.engine)
    if request.samples is not None:
        raise ConfigError("samples", "must be left out with derivatives, which samples do not have", request.samples)
    if scene.lamps:
        raise ConfigError("derivatives", "are of sunlight, and this scene has lamps", hint="leave lamps out")
    if "coverage" not in request.engines:
        raise ConfigError("derivatives", "need the engine coverage, which needs embreex", hint="install embreex")
    if scene.emission:
        raise ConfigError("derivatives", "are of light that a surface scatters, and this scene has a coma",
                          hint="leave emission out of the scene")
    if several := [body.name for body in scene.bodies if body.materials is not None]:
        raise ConfigError("derivatives", f"cannot be drawn of several materials (body {several[0]!r})",
                          hint="give the body one brdf")
    by_name = {body.name: body for body in scene.bodies}
    visible = [body for body in seen if body.view.is_visible]
    for body in visible:
        if reason := _reason(by_name[body.view.name], body, request.camera):
            what, hint = reason
            raise ConfigError("derivatives", f"cannot be drawn of {what} (body {body.view.name!r})", hint=hint)
    drawn = {body.view.name for body in visible}
    for index, name in enumerate(names):
        if name.startswith("bodies.") and name.removeprefix("bodies.") not in drawn:
            raise ConfigError(f"derivatives[{index}]", "must be of a body that is in view", name, "leave it out")
    _check_apart(visible, request.camera)


def _reason(body: Body, seen: Seen, camera: PinholeCamera) -> tuple[str, str] | None:
    """A feature of a body that has no derivatives, and what to change; none where all have."""
    shape = body.drawn_shape
    reasons = (
        (camera.distortion is not None, "a camera that distorts", "leave distortion out of the camera"),
        (seen.view.bounds_px is None, "a body that reaches behind the camera", "move the camera farther away"),
        (body.albedo_map is not None, "a texture", "leave albedo_map out of the body"),
        (body.smooth_normals, "smooth normals", "give the body smooth_normals=False"),
        (bool(seen.detail_layers), "surface detail", "leave detail out of the body"),
        (_overlap(shape), "shells that overlap", "give a shape of one shell"))
    return next(((what, hint) for holds, what, hint in reasons if holds), None)


def _check_apart(visible: Sequence[Seen], camera: PinholeCamera) -> None:
    """Refuse bodies that may hide or shade each other."""
    hint = "leave one out of the scene, or ask where the bodies stand apart"
    for body in visible:
        if body.casters:
            raise ConfigError("derivatives", f"cannot be drawn where {', '.join(body.casters)} may shade "
                              f"{body.view.name}", hint=hint)
    for group in touching([body.view for body in visible], camera):
        if len(group.names) > 1:
            raise ConfigError("derivatives", f"cannot be drawn where {' and '.join(group.names)} may hide each other",
                              hint=hint)


@lru_cache(maxsize=8)
def _overlap(shape: Shape) -> bool:
    """Whether boxes around a shape's shells overlap."""
    if shape.report.n_shells < 2:
        return False
    n_shells, shell = pieces(shape.facets, len(shape.vertices_m))
    low, high = np.full((2, n_shells, 3), np.inf)
    np.minimum.at(low, shell, shape.vertices_m)
    np.minimum.at(high, shell, -shape.vertices_m)
    touch = ((low[:, None] < -high[None]) & (low[None] < -high[:, None])).all(axis=-1)
    return bool(touch.sum() > n_shells)
