"""Errors that steps and coarse nodes make in a field: measured on it when it is made, along some rays, in float64."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .column import angles
from .fields import CartesianField, Field

STEPS = (8, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384)
"""Steps along a ray, of the half circle that it makes around the origin."""
NODE_ANGLES = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
"""Angles [rad] between nodes, as the body's origin sees them."""
REACH_RAD = 0.1
"""Angle between the surfaces of a pixel and a node up to which the node speaks for the pixel."""
# Rays past the origin in each zone, steps that are the truth, and steps from which nodes are judged.
_RAYS, _FINE_STEPS, _MIDDLE_STEPS = 96, 768, 128
# Where zones begin: in least distances of the surface, that one, and in typical ones.
_LEAST, _ZONES = 0.1, (1.0, 1.4, 2.5, 6.0)

Hits = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Places (N, 3) [m] of rays and directions (N, 3) to the distance (N,) [m] from there, of either sign, or infinity."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldErrors:
    """RMS errors of a field's integrals of K over theta [m], by zones of the rays' distance from the origin.

    Attributes
    ----------
    edges_m : (B,) float64 [m]
        Where zones begin.
    level_m : (B,) float64 [m]
        Mean of the integrals.
    steps_m, front_steps_m : (S, B) float64 [m]
        By `STEPS`: of rays that miss the body, and of those that it ends. All errors are RMS over all rays of the zone.
    nodes_m, fronts_m : (A, B) float64 [m]
        Of pixels between nodes, by `NODE_ANGLES`: off the body, and before it.
    """

    edges_m: np.ndarray
    level_m: np.ndarray
    steps_m: np.ndarray
    front_steps_m: np.ndarray
    nodes_m: np.ndarray
    fronts_m: np.ndarray


def measured_errors(field: Field, radii_m: tuple[float, float, float], hits: Hits,
                    seed: int = 0) -> tuple[FieldErrors, ...]:
    """Errors of a field, from parallel rays in random directions; one for each of the fields that it holds.

    Parameters
    ----------
    field : Field
    radii_m : (float, float, float) [m]
        Least and typical distance of the surface from the origin, and that up to which rays are measured.
    hits : callable
        Where rays first meet the body.
    """
    nearest, typical, far = radii_m
    inner = nearest * (typical / nearest) ** np.array([0.0, 0.5, 0.8])
    edges = np.array([_LEAST * nearest, *inner, *(x * typical for x in _ZONES if inner[-1] < x * typical < far)])
    rng = np.random.default_rng(seed)
    zones = [_zone(field, low, high, far, hits, rng)
             for low, high in zip(edges, (*edges[1:], far), strict=True)]
    # (B, F), then four of (A, B, F): by angle or steps, by zone, by field.
    level, *tables = (np.stack(part, axis=-2) for part in zip(*zones, strict=True))
    names = ("steps_m", "front_steps_m", "nodes_m", "fronts_m")
    return tuple(FieldErrors(edges_m=edges, level_m=level[:, k],
                             **{name: table[..., k] for name, table in zip(names, tables, strict=True)})
                 for k in range(level.shape[1]))


def worst(errors: Sequence[FieldErrors]) -> FieldErrors:
    """Errors over levels that are at least those of each: of fields of one geometry, dark ones left out."""
    # An image's mean is mostly of what passes far from the origin.
    scales = [float(np.average(each.level_m, weights=each.edges_m)) for each in errors]
    lit = [(each, scale) for each, scale in zip(errors, scales, strict=True) if scale > 0.0]
    if not lit:
        return errors[0]
    of = lambda name, choice: choice([getattr(each, name) / scale for each, scale in lit], axis=0)  # noqa: E731
    return FieldErrors(edges_m=errors[0].edges_m, level_m=of("level_m", np.min), **{
        name: of(name, np.max) for name in ("steps_m", "front_steps_m", "nodes_m", "fronts_m")})


def _zone(field: Field, low_m: float, high_m: float, far_m: float, hits: Hits,
          rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    direction = _unit(rng.normal(size=(_RAYS, 3)))
    if isinstance(field, CartesianField):
        # Seen along an axis, cells' faces are edge-on: lines across the image between which integrals are linear.
        direction[::2] = np.sign(direction[::2]) * (np.abs(direction[::2]) == np.abs(direction[::2]).max(1)[:, None])
    aside = _unit(np.cross(direction, rng.normal(size=(_RAYS, 3))))
    rho = np.exp(rng.uniform(np.log(low_m), np.log(high_m), _RAYS))[:, None]
    turn = rng.uniform(0.0, 2.0 * np.pi, _RAYS)[:, None]
    way = np.cos(turn) * aside + np.sin(turn) * np.cross(direction, aside)

    def integrals(place_m: np.ndarray, steps: int, end_m: np.ndarray, of: np.ndarray) -> np.ndarray:
        place, way = place_m[of], direction[of]
        closest = place - np.einsum("ij,ij->i", place, way)[:, None] * way
        a = np.maximum(np.linalg.norm(closest, axis=1), field.least_m)
        return _integrals(field, closest, way, a, np.full(len(place), -1e4 * far_m), steps, end_m[of])

    rms = lambda x: np.sqrt(np.sum(np.square(x), axis=0) / _RAYS)  # noqa: E731
    end = hits(rho * aside, direction)
    every, is_free = np.ones(_RAYS, bool), np.isinf(end)
    truth = integrals(rho * aside, _FINE_STEPS, end, every)
    of_steps = [integrals(rho * aside, count, end, every) - truth for count in STEPS]
    steps, front_steps = ([rms(error[part]) for error in of_steps] for part in (is_free, ~is_free))
    middle, theta = integrals(rho * aside, _MIDDLE_STEPS, end, every), np.arctan(end / rho[:, 0])
    nodes, fronts, endless = [], [], np.full(_RAYS, np.inf)
    for angle in NODE_ANGLES:
        places = [rho * (aside + 0.5 * sign * angle * way) for sign in (-1.0, 1.0)]
        ends = [hits(place, direction) for place in places]
        apart = [np.where(np.isfinite(at), theta - np.arctan(np.where(np.isfinite(at), at, 0.0) / rho[:, 0]), np.inf)
                 for at in ends]
        # A pixel near the body lies between nodes whose rays may have gone through it.
        through = sum(integrals(place, _MIDDLE_STEPS, endless, is_free) for place in places)
        nodes.append(rms(0.5 * through - middle[is_free]))
        near = ~is_free & (np.abs(apart) < REACH_RAD).all(axis=0)
        k = [_weights(field, place[near] + at[near, None] * direction[near])
             for place, at in zip(places, ends, strict=True)]
        front = sum(integrals(place, _MIDDLE_STEPS, at, near) + k_end * apart_rad[near, None]
                    for place, at, k_end, apart_rad in zip(places, ends, k, apart, strict=True))
        fronts.append(rms(0.5 * front - middle[near]))
    return np.mean(truth, axis=0), *(np.array(table) for table in (steps, front_steps, nodes, fronts))


def _weights(field: Field, r_m: np.ndarray) -> np.ndarray:
    """K (..., F) [m] at points (..., 3) [m]."""
    weight = field.weight(r_m)
    return weight if weight.ndim == r_m.ndim else weight[..., None]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _integrals(field: Field, closest: np.ndarray, direction: np.ndarray, a: np.ndarray, along: np.ndarray, steps: int,
               end_m: np.ndarray) -> np.ndarray:
    """Integrals of K over theta (N, F) [m], all steps of a ray at once, as the shader."""
    low, high = angles(field, closest, direction, a, along, end_m - along)
    count = np.maximum(np.ceil(steps * (high - low) / np.pi), steps / 4.0)
    index = np.arange(steps)
    # Rays that need fewer steps have theirs within the span; the rest counts for nothing.
    valid = index < count[:, None]
    theta = low[:, None] + (index + 0.5) * ((high - low) / count)[:, None]
    s = a[:, None] * np.tan(np.where(valid, theta, low[:, None]))
    r = closest[:, None] + s[..., None] * direction[:, None]
    squared = np.sum(closest**2, axis=1)[:, None] + s**2
    share = valid * (a[:, None] ** 2 + s**2) / np.maximum(squared, a[:, None] ** 2)
    return np.einsum("ijk,ij->ik", _weights(field, r), share) * ((high - low) / count)[:, None]
