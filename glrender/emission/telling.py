"""The account that a frame gives of its coma, whichever engine drew it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..planner.plan import EmissionPlan
from .layers import Layer
from .planning import Sampling
from .settings import ComaSettings


def told(coma: ComaSettings, drawn: Sequence[tuple[Layer, Sampling]], greatest: float, milliseconds: float,
         at_edges: float = 0.0, other_shadows: bool = False) -> EmissionPlan:
    """The plan of a coma.

    Parameters
    ----------
    coma : ComaSettings
    drawn : sequence of (Layer, Sampling)
    greatest : float [1]
        Largest column.
    milliseconds : float [ms]
    at_edges : float [1]
        Error that pixels at the bodies' edges leave.
    other_shadows : bool
        Whether bodies cast shadows past the coma's own that are not drawn.
    """
    left_out = ["sunlight that the dust takes out before it is scattered, and light scattered twice"]
    if not coma.has_shadow:
        left_out.append("the bodies' shadow in the coma")
    if other_shadows:
        left_out.append(f"shadows in the coma that bodies other than {coma.body} cast")
    if coma.dust.extinction_efficiency == 0.0:
        left_out.append(f"extinction: columns up to {greatest:.2g} of cross-section over area")
    if not drawn:
        left_out.append("no source is active")
    if at_edges > 0.0:
        left_out.append(f"the mean over a pixel at the bodies' edges: an error of {at_edges:.2g}")
    fields: list[dict[str, Any]] = [
        {"models": list(layer.models), "steps": sampling.steps, "front_steps": sampling.front_steps,
         "pixels_per_node": sampling.pixels_per_node,
         "front_pixels_per_node": sampling.front_pixels_per_node,
         "far_pixels_per_node": sampling.far_pixels_per_node, "texels": list(layer.field.texel_counts)}
        for layer, sampling in drawn]
    return EmissionPlan(
        kind="coma", body=coma.body, milliseconds=milliseconds, left_out=tuple(left_out),
        modelled={"fields": fields, "shadow": coma.has_shadow,
                  "extinction": coma.dust.extinction_efficiency > 0.0, "greatest_column": greatest},
        predicted_error=math.hypot(at_edges, *(sampling.predicted_error for _, sampling in drawn)) if drawn else 0.0)
