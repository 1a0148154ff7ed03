"""Solids whose light has a closed form."""

from __future__ import annotations

import numpy as np
from glrender import Shape


def box(low, high):
    """(vertices, facets) of a box between two corners [m], counter-clockwise from outside."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    facets = np.array([[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
                       [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]])
    return low + corners * (high - low), facets


def slab(half_m=100.0, thickness_m=20.0, pillar_m=None):
    """A square slab, its top at z = 0, and on it a pillar of square base and height `pillar_m` = (side, height)."""
    vertices, facets = box((-half_m, -half_m, -thickness_m), (half_m, half_m, 0.0))
    if pillar_m is not None:
        side, height = pillar_m
        more, more_facets = box((-0.5 * side, -0.5 * side, -0.5 * thickness_m), (0.5 * side, 0.5 * side, height))
        vertices, facets = np.concatenate([vertices, more]), np.concatenate([facets, more_facets + len(vertices)])
    return Shape.from_arrays(vertices, facets)


def slab_flux(incidence, emission, half_m, pillar_m, range_m, solar_irradiance, normal_albedo):
    """Irradiance [W/m2] of the slab seen against the Sun, from far: phase = incidence + emission.

    The pillar hides a strip behind it and shades one before it; its top is as bright as what it stands on,
    and the sides that face the camera are dark.
    """
    side, height = pillar_m
    area = (2.0 * half_m) ** 2 - side * height * (np.tan(incidence) + np.tan(emission))
    return solar_irradiance * normal_albedo / np.pi * np.cos(incidence) * np.cos(emission) * area / range_m**2
