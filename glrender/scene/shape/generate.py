"""Bodies made from a seed, so that a demo or a test needs no download. Equal arguments, equal bodies."""

from __future__ import annotations

import numpy as np
from glrender_camera.validate import integer, within

from .facet_geometry import area_vectors
from .shape import Shape, centre_of_volume

MAX_SUBDIVISIONS = 9
# As far as a Shape goes, with room for relief.
_RADII_M = (1e-3, 1e9)


def icosphere(*, radius_m: float, subdivisions: int = 5) -> Shape:
    """A sphere of 20 * 4**subdivisions facets, its vertices on the sphere.

    Parameters
    ----------
    radius_m : float [m], 1e-3..1e9
    subdivisions : int, 0..9
    """
    directions, facets = _icosphere(subdivisions)
    return Shape.from_arrays(within("radius_m", radius_m, *_RADII_M) * directions, facets)


def three_lobes(*, radius_m: float, subdivisions: int = 5) -> Shape:
    """Three unequal lobes: no rotation and no mirror takes it to itself.

    Parameters
    ----------
    radius_m : float [m], 1e-3..1e9
        Of the bounding sphere.
    subdivisions : int, 0..9
    """
    radius_m = within("radius_m", radius_m, *_RADII_M)
    directions, facets = _icosphere(subdivisions)
    distance = np.full(len(directions), 0.45)
    for height, sharpness, axis in ((0.55, 6.0, (1.0, 0.0, 0.2)), (0.35, 8.0, (-0.3, 1.0, 0.0)),
                                    (0.45, 5.0, (-0.2, -0.3, 1.0))):
        axis = np.array(axis) / np.linalg.norm(axis)
        distance += height * np.exp(-sharpness * (1.0 - directions @ axis))
    return _centred(distance[:, None] * directions, facets, radius_m)


def gaussian_random_sphere(*, radius_m: float, sigma: float = 0.2, correlation_deg: float = 30.0, seed: int = 0,
                           subdivisions: int = 5) -> Shape:
    """A log-normal radius over the sphere.

    Parameters
    ----------
    radius_m : float [m], 1e-3..1e9
        Mean radius.
    sigma : float [1], 0..0.8
        Standard deviation of the radius over its mean.
    correlation_deg : float [deg], 5..90
        Correlation angle: coefficients of degree l fall off as exp(-l (l + 1) L^2 / 2).
    seed : int
    subdivisions : int, 0..9

    Source: Muinonen (1998), Gaussian random sphere.
    """
    radius_m, sigma = within("radius_m", radius_m, *_RADII_M), within("sigma", sigma, 0.0, 0.8)
    width = np.radians(within("correlation_deg", correlation_deg, 5.0, 90.0))
    rng = np.random.default_rng(integer("seed", seed, 0, 2**63 - 1))
    directions, facets = _icosphere(subdivisions)
    degrees = np.arange(1, int(np.ceil(4.0 / width)) + 2)
    share = (2 * degrees + 1) * np.exp(-0.5 * degrees * (degrees + 1) * width**2)
    beta2 = np.log1p(sigma**2)
    field = _random_field(directions, degrees, beta2 * share / share.sum(), rng)
    shape = Shape.from_arrays(radius_m * np.exp(field - 0.5 * beta2)[:, None] * directions, facets)
    return Shape.from_arrays(shape.vertices_m - centre_of_volume(shape.vertices_m, shape.facets), shape.facets)


def contact_binary(*, radius_m: float, seed: int = 0, subdivisions: int = 6, n_craters: int = 60,
                   n_boulders: int = 120) -> Shape:
    """Two lobes that touch, with rolling ground, craters and boulders.

    A radius over the sphere, so that it never cuts itself.

    Parameters
    ----------
    radius_m : float [m], 1e-3..1e9
        Of the bounding sphere.
    seed : int
    subdivisions : int, 0..9
        20 * 4**subdivisions facets.
    n_craters, n_boulders : int, 0..10000
        Their sizes follow power laws; the largest crater spans about a quarter of the body.
    """
    radius_m = within("radius_m", radius_m, *_RADII_M)
    rng = np.random.default_rng(integer("seed", seed, 0, 2**63 - 1))
    n_craters = integer("n_craters", n_craters, 0, 10_000)
    n_boulders = integer("n_boulders", n_boulders, 0, 10_000)
    directions, facets = _icosphere(subdivisions)
    distance = _two_balls(directions, rng)
    degrees = np.arange(2, 15)
    power = degrees**-2.6
    distance *= np.exp(_random_field(directions, degrees, 0.05**2 * power / power.sum(), rng))
    for axis, size in zip(_directions(rng, n_craters), _power_law(rng, n_craters, 0.02, 0.25, 2.2), strict=True):
        # A bowl a fifth as deep as wide, and a rim that falls off outside.
        x = 2.0 * np.arcsin(np.clip(np.linalg.norm(directions - axis, axis=1) / 2.0, 0.0, 1.0)) / size
        bowl = np.where(x < 1.0, 1.25 * (x**2 - 1.0) + 0.25, 0.25 * np.exp(-4.0 * np.clip(x - 1.0, 0.0, 10.0)))
        distance += 0.3 * size * 0.6 * np.where(x < 3.0, bowl, 0.0)
    for axis, size in zip(_directions(rng, n_boulders), _power_law(rng, n_boulders, 0.012, 0.06, 3.0), strict=True):
        x = np.linalg.norm(directions - axis, axis=1) / size
        distance += 0.5 * size * np.sqrt(np.clip(1.0 - x**2, 0.0, None)) * 0.8
    return _centred(distance[:, None] * directions, facets, radius_m)


def subdivide_with_relief(shape: Shape, *, levels: int, relief: float = 0.05, seed: int = 0) -> Shape:
    """Split each facet into four, `levels` times, and move the new vertices along their normals.

    Parameters
    ----------
    shape : Shape
        Closed.
    levels : int, 1..5
    relief : float [1], 0..0.3
        Standard deviation of the move over the length of the split edge.
    seed : int
    """
    levels, relief = integer("levels", levels, 1, 5), within("relief", relief, 0.0, 0.3)
    rng = np.random.default_rng(integer("seed", seed, 0, 2**63 - 1))
    vertices, facets = shape.vertices_m, shape.facets.astype(np.int64)
    for _ in range(levels):
        vertices, facets = _split(vertices, facets, relief, rng)
    return Shape.from_arrays(vertices, facets)


def _centred(vertices: np.ndarray, facets: np.ndarray, radius_m: float) -> Shape:
    """A shape about its centre of volume, in a bounding sphere of a given radius."""
    vertices = vertices - centre_of_volume(vertices, facets)
    return Shape.from_arrays(vertices * (radius_m / np.linalg.norm(vertices, axis=1).max()), facets)


def _icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    vertices = np.array([[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0],
                         [0, -1, golden], [0, 1, golden], [0, -1, -golden], [0, 1, -golden],
                         [golden, 0, -1], [golden, 0, 1], [-golden, 0, -1], [-golden, 0, 1]], float)
    facets = np.array([[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4],
                       [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8],
                       [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]])
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    for _ in range(integer("subdivisions", subdivisions, 0, MAX_SUBDIVISIONS)):
        vertices, facets = _split(vertices, facets, 0.0, None)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices, facets


def _split(vertices: np.ndarray, facets: np.ndarray, relief: float,
           rng: np.random.Generator | None) -> tuple[np.ndarray, np.ndarray]:
    """Four facets for each, over the edges' midpoints."""
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    key = np.minimum(start, end) * np.int64(len(vertices)) + np.maximum(start, end)
    key, index = np.unique(key, return_inverse=True)
    a, b = vertices[key // len(vertices)], vertices[key % len(vertices)]
    middle = 0.5 * (a + b)
    if relief and rng is not None:
        normal = np.repeat(area_vectors(vertices, facets), 3, axis=0)
        total: np.ndarray = np.stack([np.bincount(index.ravel(), normal[:, k]) for k in range(3)], axis=1)
        total /= np.linalg.norm(total, axis=1, keepdims=True)
        length = np.linalg.norm(a - b, axis=1)
        middle = middle + (relief * length * rng.standard_normal(len(length)))[:, None] * total
    m = index.reshape(-1, 3) + len(vertices)
    a, b, c = facets.T
    return (np.concatenate([vertices, middle]), np.concatenate([
        np.stack([a, m[:, 0], m[:, 2]], axis=1), np.stack([m[:, 0], b, m[:, 1]], axis=1),
        np.stack([m[:, 2], m[:, 1], c], axis=1), m]))


def _two_balls(directions: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Distance from a point near the neck to the blended surface of two balls along x."""
    large, small = 0.55, rng.uniform(0.36, 0.42)
    centre = np.array([large + 0.75 * small, rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05)])
    # Seen from near the neck both lobes have their share of the directions, and so of the facets.
    origin = np.array([0.42, 0.0, 0.0])
    near, far = np.zeros(len(directions)), np.full(len(directions), 2.5)

    def outside(distance: np.ndarray) -> np.ndarray:
        place = origin + distance[:, None] * directions
        first = np.linalg.norm(place / [1.0, 0.9, 0.85], axis=1) - large
        second = np.linalg.norm((place - centre) / [1.1, 1.0, 0.9], axis=1) - small
        # A smooth minimum: the neck is rounded over a tenth of the body.
        return -0.06 * np.logaddexp(-first / 0.06, -second / 0.06) > 0.0

    for _ in range(50):
        middle = 0.5 * (near + far)
        is_outside = outside(middle)
        near, far = np.where(is_outside, near, middle), np.where(is_outside, middle, far)
    return 0.5 * (near + far)


def _random_field(directions: np.ndarray, degrees: np.ndarray, variance: np.ndarray,
                  rng: np.random.Generator) -> np.ndarray:
    """Gaussian field on the sphere with the given variance in each degree of spherical harmonics."""
    from scipy.special import sph_legendre_p_all

    theta, phi = np.arccos(np.clip(directions[:, 2], -1.0, 1.0)), np.arctan2(directions[:, 1], directions[:, 0])
    highest = int(degrees[-1])
    weights = np.zeros((highest + 1, highest + 1), complex)
    for degree, power in zip(degrees, variance, strict=True):
        scale = np.sqrt(4.0 * np.pi * power / (2 * degree + 1))
        weights[degree, 0] = scale * rng.standard_normal()
        for order in range(1, degree + 1):
            real, imaginary = rng.standard_normal(2)
            weights[degree, order] = scale * np.sqrt(2.0) * (real - 1j * imaginary)
    field, orders = np.empty(len(directions)), np.arange(highest + 1)
    # All functions of some thousand places at a time: those of all places would be gigabytes.
    for part in np.split(np.arange(len(directions)), range(1024, len(directions), 1024)):
        legendre = sph_legendre_p_all(highest, highest, theta[part])[0, :, :highest + 1]
        total = np.einsum("lm,lmi->mi", weights, legendre)
        field[part] = (total * np.exp(1j * orders[:, None] * phi[part])).real.sum(axis=0)
    return field


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _power_law(rng: np.random.Generator, count: int, low: float, high: float, exponent: float) -> np.ndarray:
    """Sizes between low and high, cumulative number ~ size^-exponent."""
    return (low**-exponent + rng.random(count) * (high**-exponent - low**-exponent)) ** (-1.0 / exponent)
