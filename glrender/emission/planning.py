"""How finely a coma is drawn: the cheapest steps and nodes that meet the budget, from errors measured on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from .measuring import NODE_ANGLES, STEPS, FieldErrors

PIXELS_PER_NODE = (1, 2, 4, 8, 16, 32)
# Of the budget, what steps and nodes may take; float32 and the light's map have the rest.
_SHARE = 0.6
# Some hundred rays miss the worst places: a vent, an edge of the body. On 67P the truth is up to that much above
# what they tell of steps, of nodes beside the body and of nodes before it (docs/coma.md).
_MARGINS = (1.4, 1.6, 3.0)
# With a shadow: least steps, and what its edges between nodes leave, times the root of the nodes' angle from the
# origin at the body (4.3 and 5.2 % of an even coma at 0.1 and 0.2 rad; 0.24 % with a node a pixel).
_SHADOW_STEPS, _SHADOW_ERROR = 96, 0.14
# A ray that starts at a camera off the nucleus by an angle lacks that share of the half circle, which has a kink
# at the nucleus: of the light there, angle / pi at most.
_VIEW_ERROR = 0.15
# A node's cost whatever its steps, in steps.
_NODE_STEPS = 6.0


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """What a frame uses for one field: nodes beside the body, and before it."""

    steps: int
    pixels_per_node: int
    front_pixels_per_node: int
    predicted_error: float


def choose(errors: FieldErrors, footprint_m: float, body_m: float, image_px: float, budget: float,
           has_shadow: bool = False, pixel_rad: float = 0.0,
           per_node: Sequence[int] = PIXELS_PER_NODE) -> Sampling:
    """The cheapest steps and nodes that take their share of the budget, or the finest there are.

    Parameters
    ----------
    errors : FieldErrors
    footprint_m : float [m]
        Of a pixel at the body.
    body_m : float [m]
        Typical distance of the surface from the origin.
    image_px : float [px]
        Half of the image's side.
    budget : float [1]
    has_shadow : bool
        Whether the body's shadow, whose edges no table of errors knows, is drawn too.
    pixel_rad : float [rad]
        Angle of a pixel.
    per_node : sequence of int
        Pixels from node to node that there may be, rising.
    """
    # Rings of the image: the column is the sum over rho, and nodes subtend less farther out.
    outer = max(image_px * footprint_m, 1.5 * body_m, footprint_m)
    rho = np.geomspace(max(min(errors.edges_m[0], 0.3 * body_m), 0.3 * footprint_m), outer, 64)
    is_front, ring = rho < body_m, rho**2 / np.sum(rho**2)
    zone = np.clip(np.searchsorted(errors.edges_m, rho) - 1, 0, len(errors.level_m) - 1)
    mean = float(np.sum(ring * errors.level_m[zone] / rho))
    if not mean > 0.0:
        return Sampling(steps=STEPS[0], pixels_per_node=per_node[-1],
                        front_pixels_per_node=per_node[-1], predicted_error=0.0)
    image = lambda each_m: math.sqrt(float(np.sum(ring * (each_m / rho) ** 2))) / mean  # noqa: E731
    # A node for every pixel leaves nothing between.
    spread = lambda table, part: {n: 0.0 if n == 1 else image(  # noqa: E731
        np.where(part, _between(table, zone, n * footprint_m / rho), 0.0)) for n in per_node}
    beside, before = spread(errors.nodes_m, ~is_front), spread(errors.fronts_m, is_front)
    share = float(np.sum(ring[is_front]))
    best, finest = None, None
    edges = {n: _SHADOW_ERROR * math.sqrt(n * footprint_m / body_m) if has_shadow and n > 1 else 0.0
             for n in per_node}
    for index, steps in enumerate(STEPS):
        if has_shadow and steps < _SHADOW_STEPS:
            continue
        of_steps = image(errors.steps_m[index, zone])
        for node, front in product(per_node, per_node):
            terms = [margin * x for margin, x in zip(_MARGINS, (of_steps, beside[node], before[front]), strict=True)]
            predicted = math.hypot(*terms, _VIEW_ERROR * node * pixel_rad, edges[max(node, front)])
            made = Sampling(steps=steps, pixels_per_node=node, front_pixels_per_node=front, predicted_error=predicted)
            # A ray that ends at the body takes a third of the half circle.
            cost = (steps + _NODE_STEPS) / node**2 + share * (steps / 3.0 + _NODE_STEPS) / front**2
            if predicted <= _SHARE * budget and (best is None or cost < best[0]):
                best = (cost, made)
            if finest is None or predicted < finest.predicted_error:
                finest = made
    return finest if best is None else best[1]


def edge_error(footprint_m: float, body_m: float, samples: int) -> float:
    """Error of the image [1] where pixels at the body's edge have the columns that n x n samples see.

    Around an even coma of column pi K / rho, 8 R pixels (R px the body's radius) see half of pi K / R more or less,
    and middles miss the mean by the root of 1/12 of that: 0.116 / sqrt(R) of the image's mean. Outlines that are
    no circles have more edge: up to 1.4 times as much on a contact binary. Samples leave 1 / n of it (jets; an even
    coma less).
    """
    return 0.16 * math.sqrt(footprint_m / body_m) / samples


def _between(table_m: np.ndarray, zone: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """Errors (N,) [m] at angles between nodes: linear in the angle below those measured, the largest's beyond."""
    known = np.array(NODE_ANGLES)
    at = np.clip(np.log(angle_rad / known[0]) / np.log(known[1] / known[0]), 0.0, len(known) - 1.0)
    first = np.minimum(at.astype(int), len(known) - 2)
    part = at - first
    value = (1.0 - part) * table_m[first, zone] + part * table_m[first + 1, zone]
    return value * np.minimum(angle_rad / known[0], 1.0)
