"""How finely a coma is drawn: the cheapest steps and resolution that meet the budget, from errors measured on it.

When a field is made, columns along some rays are summed in float64 with few and with many steps, and beside each
other: what steps and coarse nodes do to this very coma is then known, and each frame looks it up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .column import angles
from .fields import Field

STEPS = (8, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384)
"""Steps along a ray, of the half circle that it makes around the origin."""
PIXELS_PER_NODE = (1, 2, 4, 8, 16, 32)
# Angles between nodes as the body's origin sees them.
_NODE_ANGLES = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
_RAYS, _FINE_STEPS = 192, 1024
# Of a body's budget, what steps and resolution may take; float32 and the ends' interpolation have the rest.
_SHARE = 0.5
# A node's cost whatever its steps, in steps.
_NODE_STEPS = 6.0


@dataclass(frozen=True, kw_only=True)
class FieldErrors:
    """What was measured of one field, all RMS over the mean of the columns times rho.

    Attributes
    ----------
    steps : dict of int to float
        By number of steps.
    nodes : dict of float to float
        By the angle [rad] between nodes.
    """

    steps: dict[int, float]
    nodes: dict[float, float]

    def of_nodes(self, angle_rad: np.ndarray) -> np.ndarray:
        """Error at angles between nodes: a power law between those measured, the largest's beyond."""
        known = np.log(list(self.nodes))
        errors = np.log(np.maximum(list(self.nodes.values()), 1e-12))
        slope = min(max((errors[1] - errors[0]) / (known[1] - known[0]), 0.0), 2.0)
        place = np.log(np.maximum(angle_rad, 1e-300))
        return np.exp(np.interp(place, known, errors) + slope * np.minimum(place - known[0], 0.0))


def measured_errors(field: Field, reach_m: tuple[float, float], corners_m: np.ndarray, seed: int = 0) -> FieldErrors:
    """Errors of a field, from parallel rays past the origin, log-uniform in their distance from it.

    Parameters
    ----------
    field : Field
    reach_m : (float, float) [m]
        Least and greatest distance.
    corners_m : (F, 3, 3) float64 [m]
        Of the body's facets, at which rays end; a coarse shape will do.
    """
    rng = np.random.default_rng(seed)
    direction = _unit(rng.normal(size=(_RAYS, 3)))
    aside = _unit(np.cross(direction, rng.normal(size=(_RAYS, 3))))
    rho = np.exp(rng.uniform(*np.log(reach_m), _RAYS))[:, None]
    turn = rng.uniform(0.0, 2.0 * np.pi, _RAYS)[:, None]
    way = np.cos(turn) * aside + np.sin(turn) * np.cross(direction, aside)
    far = np.full(_RAYS, -1e4 * reach_m[1])
    end = first_hits(rho * aside, direction, corners_m)

    def integrals(place_m: np.ndarray, steps: int, end_m: np.ndarray | float) -> np.ndarray:
        closest = place_m - np.einsum("ij,ij->i", place_m, direction)[:, None] * direction
        a = np.maximum(np.linalg.norm(closest, axis=1), field.least_m)
        return _integrals(field, closest, direction, a, far, steps, end_m)

    truth = integrals(rho * aside, _FINE_STEPS, end)
    level = float(np.mean(truth))
    if not level > 0.0:
        return FieldErrors(steps=dict.fromkeys(STEPS, 0.0), nodes=dict.fromkeys(_NODE_ANGLES, 0.0))
    rms = lambda x: float(np.sqrt(np.mean(np.square(x)))) / level  # noqa: E731
    steps = {count: rms(integrals(rho * aside, count, end) - truth) for count in STEPS}
    # A pixel beside the body lies between nodes whose rays may have gone through it.
    free, nodes = np.isinf(end), {}
    middle = integrals(rho * aside, _FINE_STEPS // 8, np.inf)
    for angle in _NODE_ANGLES:
        beside = [integrals(rho * (aside + 0.5 * sign * angle * way), _FINE_STEPS // 8, np.inf) for sign in (-1.0, 1.0)]
        nodes[angle] = rms((0.5 * (beside[0] + beside[1]) - middle)[free]) if free.any() else 0.0
    return FieldErrors(steps=steps, nodes=nodes)


def first_hits(place_m: np.ndarray, direction: np.ndarray, corners_m: np.ndarray) -> np.ndarray:
    """Where rays (N, 3), from far before places (N, 3) [m], first meet facets (F, 3, 3) [m]: (N,) [m] or infinity.

    Source: Moeller and Trumbore (1997).
    """
    a, u, v = corners_m[:, 0], corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]
    nearest = np.full(len(place_m), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for index, (place, ray) in enumerate(zip(place_m, direction, strict=True)):
            p, offset = np.cross(ray, v), place - a
            determinant = np.einsum("ij,ij->i", u, p)
            first = np.einsum("ij,ij->i", offset, p) / determinant
            q = np.cross(offset, u)
            second = q @ ray / determinant
            hit = (first >= 0.0) & (second >= 0.0) & (first + second <= 1.0)
            if hit.any():
                nearest[index] = (np.einsum("ij,ij->i", v, q) / determinant)[hit].min()
    return nearest


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _integrals(field: Field, closest: np.ndarray, direction: np.ndarray, a: np.ndarray, along: np.ndarray, steps: int,
               end_m: np.ndarray | float) -> np.ndarray:
    """Columns times a (N,) [m], all steps of a ray at once; `steps` as the shader counts them."""
    low, high = angles(field, closest, direction, a, along, end_m - along)
    count = np.maximum(np.ceil(steps * (high - low) / np.pi), 2.0)
    index = np.arange(steps)
    theta = low[:, None] + (index + 0.5) * ((high - low) / count)[:, None]
    # Rays that need fewer steps have theirs within the span; the rest counts for nothing.
    valid = index < count[:, None]
    s = a[:, None] * np.tan(np.where(valid, theta, low[:, None]))
    r = closest[:, None] + s[..., None] * direction[:, None]
    squared = np.sum(closest**2, axis=1)[:, None] + s**2
    value = field.weight(r) * (a[:, None] ** 2 + s**2) / np.maximum(squared, a[:, None] ** 2)
    return np.sum(value * valid, axis=1) * (high - low) / count


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """What a frame uses for one field."""

    steps: int
    pixels_per_node: int
    predicted_error: float


def choose(errors: FieldErrors, footprint_m: float, body_m: float, image_px: float, budget: float) -> Sampling:
    """The cheapest steps and nodes that take half of the budget, or the finest there are.

    Parameters
    ----------
    errors : FieldErrors
    footprint_m : float [m]
        Of a pixel at the body.
    body_m : float [m]
        Least distance of the surface from the origin.
    image_px : float [px]
        Half of the image's side.
    budget : float [1]
    """
    # The error of the image: light falls as 1 / rho, rings grow as rho, nodes subtend less farther out.
    rho = np.geomspace(max(body_m, 0.5 * footprint_m), max(image_px * footprint_m, 2.0 * body_m, footprint_m), 48)
    best, finest = None, None
    for per_node in PIXELS_PER_NODE:
        each = errors.of_nodes(per_node * footprint_m / rho)
        ring = rho**2
        squared, mean = (float(np.sum(x * ring) / np.sum(ring)) for x in ((each / rho) ** 2, 1.0 / rho))
        # A node for every pixel needs nothing between.
        nodes = 0.0 if per_node == 1 else math.sqrt(squared) / mean
        for steps in STEPS:
            predicted = math.hypot(nodes, errors.steps[steps])
            made = Sampling(steps=steps, pixels_per_node=per_node, predicted_error=predicted)
            cost = (steps + _NODE_STEPS) / per_node**2
            if predicted <= _SHARE * budget and (best is None or cost < best[0]):
                best = (cost, made)
            if finest is None or predicted < finest.predicted_error:
                finest = made
    return finest if best is None else best[1]

