"""The planner of a coma takes the cheapest steps and nodes that meet the tolerance, from errors measured on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .measuring import NODE_ANGLES, STEPS, FieldErrors

PIXELS_PER_NODE = (1, 2, 4, 8, 16, 32)
FAR_PIXELS_PER_NODE = (4, 8, 16, 32)
NEAR_NODES = 12
"""Far nodes from the origin's pixel within which each pixel has its own 1/rho: beyond, columns themselves are linear
between nodes, which leaves (n / rho)^2 / 12 of 1/rho."""
NEAR_RADII = 1.5
"""Body radii within which it has so too."""
# Share of the tolerance that steps and nodes may take; float32 and the light's map have the rest.
_SHARE = 0.6
# Some hundred rays miss the worst places: a vent, an edge of the body. On 67P the truth is up to that much above
# their estimate for steps, for nodes off the body and for nodes before it (docs/coma.md).
_MARGINS = (1.4, 1.6, 2.0)
# And what pixels at edges may take. Bodies that are smaller are cheap to draw; so are so many samples across one.
_EDGE_SHARE, _SMALL_PX, _MOST_SAMPLES = 0.7, 256.0, 2048.0
# With a shadow: least steps, and what its edges between nodes leave, times the root of the nodes' angle from the
# origin at the body (4.3 and 5.2 % of an even coma at 0.1 and 0.2 rad; 0.24 % with a node a pixel).
_SHADOW_STEPS, _SHADOW_ERROR = 96, 0.14
# What shadow maps of 1024 texels and steps leave of the edges along a ray, times the root of the steps: 0.65 % of the
# light of a narrow jet that passes through a nucleus' shadow at 96 steps (test_a_jets_shadow_has_no_ripples).
_SHADOW_STEP_ERROR = 0.066
# A ray that starts at a camera off the nucleus by an angle lacks that share of the half circle, which has a kink
# at the nucleus: of the light there, angle / pi at most.
_VIEW_ERROR = 0.15
# Costs in steps (6.5 ns on llvmpipe): a node's besides its steps, and a pixel's column.
_NODE_STEPS, _PIXEL_STEPS = 6.0, 5.0


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """A frame's nodes for one field: off the body, before it, and far from it; 0 if nothing is far."""

    steps: int
    front_steps: int
    pixels_per_node: int
    front_pixels_per_node: int
    predicted_error: float
    far_pixels_per_node: int = 0


def choose(errors: FieldErrors, footprint_m: float, body_m: float, image_px: float, tolerance: float,
           has_shadow: bool = False, pixel_rad: float = 0.0, per_node: Sequence[int] = PIXELS_PER_NODE,
           per_far: Sequence[int] = FAR_PIXELS_PER_NODE) -> Sampling:
    """The cheapest steps and nodes that take their share of the tolerance, or the finest there are.

    Parameters
    ----------
    errors : FieldErrors
    footprint_m : float [m]
        Footprint of a pixel at the body.
    body_m : float [m]
        Typical distance of the surface from the origin.
    image_px : float [px]
        Half of the image's side.
    tolerance : float [1]
    has_shadow : bool
        Whether the body's shadow, whose edges no table of errors knows, is drawn too.
    pixel_rad : float [rad]
        Angle of a pixel.
    per_node, per_far : sequence of int
        Pixels from node to node that there may be, rising; those far from the body, if anything may be far.
    """
    # Rings of the image: the column is the sum over rho, and nodes subtend less farther out.
    outer = max(image_px * footprint_m, 1.5 * body_m, footprint_m)
    rho = np.geomspace(max(min(errors.edges_m[0], 0.3 * body_m), 0.3 * footprint_m), outer, 64)
    ring = rho**2 / np.sum(rho**2)
    zone = np.clip(np.searchsorted(errors.edges_m, rho) - 1, 0, len(errors.level_m) - 1)
    mean = float(np.sum(ring * errors.level_m[zone] / rho))
    if not mean > 0.0:
        return Sampling(steps=STEPS[0], front_steps=STEPS[0], pixels_per_node=per_node[-1],
                        front_pixels_per_node=per_node[-1], predicted_error=0.0,
                        far_pixels_per_node=per_far[-1] if len(per_far) else 0)
    weight, node, far = ring / (rho * mean) ** 2, np.array(per_node), np.array([0, *per_far])
    near_px = np.where(far > 0, np.maximum(NEAR_NODES * far, NEAR_RADII * body_m / footprint_m), np.inf)
    is_near = rho < near_px[:, None] * footprint_m
    # A node for every pixel leaves nothing between.
    between = lambda table, n: np.where(  # noqa: E731
        n[:, None] > 1, _between(table, zone, np.maximum(n, 1)[:, None] * footprint_m / rho), 0.0)
    curved = (far[:, None] * footprint_m / rho) ** 2 / 12.0 * errors.level_m[zone]
    of_steps = [table[:, zone] ** 2 @ weight for table in (errors.steps_m, errors.front_steps_m)]
    of_nodes = between(errors.nodes_m, node) ** 2 @ np.where(is_near, weight, 0.0).T
    of_far = np.where(is_near, 0.0, between(errors.nodes_m, far) ** 2 + curved**2) @ weight
    of_front = between(errors.fronts_m, node) ** 2 @ weight
    steps = np.array(STEPS)
    # Along axes: steps off the body and before it, nodes off it, before it and far from it.
    s, t, n, f, g = np.ix_(*(np.arange(len(axis)) for axis in (steps, steps, node, node, far)))
    squared = sum(margin**2 * part for margin, part in zip(
        _MARGINS, (of_steps[0][s] + of_steps[1][t], of_nodes[n, g] + of_far[g], of_front[f]), strict=True))
    squared = squared + (_VIEW_ERROR * node[n] * pixel_rad) ** 2
    if has_shadow:
        widest = np.maximum(np.maximum(node[n], node[f]), far[g])
        squared = squared + _SHADOW_STEP_ERROR**2 / np.minimum(steps[s], steps[t])
        squared = squared + np.where(widest > 1, _SHADOW_ERROR**2 * widest * footprint_m / body_m, 0.0)
        squared = np.where(np.minimum(steps[s], steps[t]) < _SHADOW_STEPS, np.inf, squared)
    area, front_area = 4.0 * image_px**2, np.pi * (body_m / footprint_m) ** 2
    near_area = np.minimum(4.0 * near_px**2, area)
    far_area = np.where(far > 0, area / np.maximum(far, 1) ** 2, 0.0)
    # A ray that ends at the body takes a third of the half circle.
    cost = ((steps[s] + _NODE_STEPS) * (near_area[g] / node[n] ** 2 + far_area[g]) + _PIXEL_STEPS * near_area[g]
            + (steps[t] / 3.0 + _NODE_STEPS) * min(front_area, area) / node[f] ** 2)
    cost, squared = np.broadcast_arrays(cost, squared)
    fits = squared <= (_SHARE * tolerance) ** 2
    best = np.argmin(np.where(fits, cost, np.inf)) if fits.any() else np.argmin(squared)
    s, t, n, f, g = np.unravel_index(best, cost.shape)
    return Sampling(steps=int(steps[s]), front_steps=int(steps[t]), pixels_per_node=int(node[n]),
                    front_pixels_per_node=int(node[f]), far_pixels_per_node=int(far[g]),
                    predicted_error=math.sqrt(squared.flat[best]))


def surface_samples(size_px: float, footprint_m: float, body_m: float, tolerance: float) -> int:
    """Samples along a pixel's side that find where bodies are: 1, 2 or 4.

    A body below 256 px is cheap to draw with 4. A larger one has the fewest that leave `edge_error` its share of the
    tolerance, and no more than 2048 across it.
    """
    if size_px < _SMALL_PX:
        return 4
    return next((n for n in (1, 2, 4) if edge_error(footprint_m, body_m, n) <= _EDGE_SHARE * tolerance
                 or 2 * n * size_px > _MOST_SAMPLES), 4)


def edge_error(footprint_m: float, body_m: float, samples: int) -> float:
    """Error of the image [1] where pixels at the body's edge have the columns that n x n samples see.

    Around an even coma of column pi K / rho, 8 R pixels (R px the body's radius) see half of pi K / R more or less,
    and middles miss the mean by the root of 1/12 of that: 0.116 / sqrt(R) of the image's mean. Outlines that are
    no circles have more edge: 0.23 on 67P, whose 2 x 2 and 4 x 4 samples leave n^-1.5 of the error (an outline crosses
    cells at all angles; measured against area means, benchmarks/bench_coma.py).
    """
    return 0.24 * math.sqrt(footprint_m / body_m) / samples**1.5


def _between(table_m: np.ndarray, zone: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """Errors (..., N) [m] at angles between nodes: linear in the angle below those measured, the largest's beyond."""
    known = np.array(NODE_ANGLES)
    at = np.clip(np.log(angle_rad / known[0]) / np.log(known[1] / known[0]), 0.0, len(known) - 1.0)
    first = np.minimum(at.astype(int), len(known) - 2)
    part = at - first
    value = (1.0 - part) * table_m[first, zone] + part * table_m[first + 1, zone]
    return value * np.minimum(angle_rad / known[0], 1.0)
