"""The plan of a frame before it is drawn: the bodies that are drawn together, and in which ways. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..base.errors import ConfigError
from ..view.regions import Group, touching
from .body_plan import plan_body
from .engine_choice import apart_limit, ways_to_draw
from .plan import BodyPlan, WindowPlan
from .request import Request
from .seen import Seen

# The way out where the engine that was asked for cannot draw a body.
_NO_ENGINE = {"coverage": "exact coverage draws bodies that are all before the camera, of facets without texture, "
                          "smooth normals or surface detail; leave engine out",
              "rays": "rays draw no surface detail; leave engine out"}


@dataclass(frozen=True, kw_only=True, eq=False)
class FramePlan:
    """The bodies of a frame, and for each group that is drawn together the ways to draw it, in order.

    Attributes
    ----------
    request : Request
    seen : tuple of Seen
    bodies : tuple of BodyPlan
    groups : tuple of Group
        Those in view: their regions share no pixel.
    options : tuple of tuple of WindowPlan
        Of each group, at least one.
    """

    request: Request
    seen: tuple[Seen, ...]
    bodies: tuple[BodyPlan, ...]
    groups: tuple[Group, ...]
    options: tuple[tuple[WindowPlan, ...], ...]


def plan_frame(seen: Sequence[Seen], request: Request) -> FramePlan:
    """The plan of a frame.

    Bodies far apart in the image are drawn apart, so that the cost follows their pixels; a body smaller than a few
    pixels is drawn on a grid of its own that fits its outline.

    Raises
    ------
    ConfigError
        The engine that was asked for cannot draw a body.
    """
    views = [body.view for body in seen]
    groups = touching(views, request.camera)
    shared = {name: request.budget(group, "raster") for group in groups for name in group.names}
    bodies = {body.view.name: plan_body(body, request.camera, shared.get(body.view.name)) for body in seen}
    options, by_name, apart_px = [], {body.view.name: body for body in seen}, apart_limit(groups, request.use.apart_px)
    for group in groups:
        members = [by_name[name] for name in group.names]
        options.append(tuple(ways_to_draw(group, members, [bodies[name] for name in group.names], request, apart_px)))
    if hopeless := [name for group, ways in zip(groups, options, strict=True) if not ways for name in group.names]:
        raise ConfigError("engine", f"cannot draw {', '.join(hopeless)}", request.engine,
                          _NO_ENGINE.get(request.engine or "", ""))
    return FramePlan(request=request, seen=tuple(seen), bodies=tuple(bodies.values()), groups=tuple(groups),
                     options=tuple(options))
