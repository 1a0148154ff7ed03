"""Loops over places behind a lens that distorts, compiled by Numba when this is imported, once on a machine.

A lens is a row of ten numbers: k1 to k6, p1 and p2 of `BrownConrady`, the largest undistorted radius that is a solution
of the inverse, and the rim: the radius beyond which the map goes on straight. Vectors are in columns.
"""

from __future__ import annotations

import math

import numpy as np
from numba.types import float64, void

from .numba_loops import POINTS, VECTOR, compiled_when_called, inlined, write

# Largest residual of the distorted coordinates [1]: 1e-8 px at a focal length of 1e4 px.
_TOLERANCE = 1e-12
# Most steps of Newton's method, and most halvings of one.
_STEPS, _HALVINGS = 50, 30


@inlined
def _image(x, y, lens):
    """The image of a place, and the three distinct derivatives there: the Jacobian is symmetric."""
    rr = x * x + y * y
    top = 1.0 + rr * (lens[0] + rr * (lens[1] + rr * lens[2]))
    bottom = 1.0 + rr * (lens[3] + rr * (lens[4] + rr * lens[5]))
    ratio = top / bottom
    slope = 2.0 * (lens[0] + rr * (2.0 * lens[1] + rr * 3.0 * lens[2])
                   - ratio * (lens[3] + rr * (2.0 * lens[4] + rr * 3.0 * lens[5]))) / bottom
    p1, p2 = lens[6], lens[7]
    return (x * ratio + 2.0 * p1 * x * y + p2 * (rr + 2.0 * x * x), y * ratio + p1 * (rr + 2.0 * y * y)
            + 2.0 * p2 * x * y, ratio + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            x * y * slope + 2.0 * (p1 * x + p2 * y), ratio + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x)


@compiled_when_called(void(POINTS, VECTOR, write(float64, 2)))
def distort(xy, lens, image):
    """Write the images (2, N) [1] of places (2, N) [1]; beyond the rim along the derivative across it."""
    for i in range(xy.shape[1]):
        x, y = xy[0, i], xy[1, i]
        radius = math.sqrt(x * x + y * y)
        inwards = lens[9] / radius if radius > lens[9] else 1.0
        u, v, a, b, c = _image(inwards * x, inwards * y, lens)
        beyond = 1.0 - inwards
        image[0, i] = u + beyond * (a * x + b * y)
        image[1, i] = v + beyond * (b * x + c * y)


@compiled_when_called(void(POINTS, VECTOR, write(float64, 1)))
def area_scales(xy, lens, scale):
    """Write the area (N,) [1] that the lens makes of an area 1 at each place (2, N) [1]; beyond the rim that on it."""
    for i in range(xy.shape[1]):
        x, y = xy[0, i], xy[1, i]
        radius = math.sqrt(x * x + y * y)
        inwards = lens[9] / radius if radius > lens[9] else 1.0
        _, _, a, b, c = _image(inwards * x, inwards * y, lens)
        scale[i] = a * c - b * b


@compiled_when_called(void(POINTS, VECTOR, write(float64, 2)))
def undistort(image, lens, xy):
    """Write the places (2, N) [1] that have images (2, N) [1], by Newton's method; NaN where none is near enough."""
    limit = lens[8]
    for i in range(image.shape[1]):
        u, v = image[0, i], image[1, i]
        xy[0, i], xy[1, i] = np.nan, np.nan
        length = math.sqrt(u * u + v * v)
        if not length < math.inf:
            continue
        # A start inside the domain: the distorted point itself, where distortion is small.
        inwards = min(1.0, 0.9 * limit / max(length, 1e-300))
        x, y = inwards * u, inwards * v
        here_u, here_v, a, b, c = _image(x, y, lens)
        error = math.hypot(here_u - u, here_v - v)
        for _ in range(_STEPS):
            if error <= _TOLERANCE * max(1.0, length):
                xy[0, i], xy[1, i] = x, y
                break
            area = a * c - b * b
            step_x = (c * (here_u - u) - b * (here_v - v)) / area
            step_y = (a * (here_v - v) - b * (here_u - u)) / area
            # Each step is halved until it stays in the domain and comes nearer.
            scale, is_nearer = 1.0, False
            for _ in range(_HALVINGS):
                next_x, next_y = x - scale * step_x, y - scale * step_y
                if next_x * next_x + next_y * next_y < limit * limit:
                    there_u, there_v, next_a, next_b, next_c = _image(next_x, next_y, lens)
                    missed = math.hypot(there_u - u, there_v - v)
                    if missed < error:
                        is_nearer = True
                        break
                scale *= 0.5
            if not is_nearer:
                break
            x, y, here_u, here_v, a, b, c, error = next_x, next_y, there_u, there_v, next_a, next_b, next_c, missed
