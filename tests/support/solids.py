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


def several(*boxes):
    """Boxes between pairs of corners [m] in one shape."""
    return Shape.from_arrays(*joined(*(box(*ends) for ends in boxes)))


def joined(*meshes):
    """(vertices, facets) of several in one."""
    begins = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return (np.concatenate([vertices for vertices, _ in meshes]),
            np.concatenate([facets + begin for (_, facets), begin in zip(meshes, begins[:-1], strict=True)]))


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


def bowl(radius_m=100.0, n=64, wall=1.25):
    """A hemispherical bowl open to +z, its rim at z = 0: an inner wall, a rim, and an outer hemisphere."""
    across = 4 * n
    angle = np.linspace(0.0, 0.5 * np.pi, n + 1)
    azimuth = 2.0 * np.pi * np.arange(across) / across
    rings = []
    for size in (radius_m, wall * radius_m):
        ring = np.stack(np.broadcast_arrays(
            size * np.cos(azimuth) * np.sin(angle[1:, None]), size * np.sin(azimuth) * np.sin(angle[1:, None]),
            -size * np.cos(angle[1:, None])), axis=-1).reshape(-1, 3)
        rings += [np.array([[0.0, 0.0, -size]]), ring]
    vertices = np.concatenate(rings)

    def cap(first, inwards):
        here, there = np.arange(across), (np.arange(across) + 1) % across
        top = np.stack([np.full(across, first), first + 1 + there, first + 1 + here], axis=1)
        facets = [top]
        for k in range(n - 1):
            a, b = first + 1 + k * across, first + 1 + (k + 1) * across
            facets += [np.stack([a + here, a + there, b + there], axis=1),
                       np.stack([a + here, b + there, b + here], axis=1)]
        facets = np.concatenate(facets)
        return facets[:, ::-1] if inwards else facets

    second = 1 + n * across
    here, there = np.arange(across), (np.arange(across) + 1) % across
    inner, outer = 1 + (n - 1) * across, second + 1 + (n - 1) * across
    rim = np.concatenate([np.stack([inner + here, outer + here, outer + there], axis=1),
                          np.stack([inner + here, outer + there, inner + there], axis=1)])
    return Shape.from_arrays(vertices, np.concatenate([cap(0, True), cap(second, False), rim]))


def bowl_light(incidence, normal_albedo, n_bounces):
    """Irradiance [1] that the bowl's wall gets from itself, everywhere the same, for a Sun of 1.

    Between any two points of a sphere's inside goes the same share, 1 / (4 pi R^2), of what a point sends out.
    """
    first = 0.25 * normal_albedo * np.cos(incidence)
    return first * sum((0.5 * normal_albedo) ** k for k in range(n_bounces))
