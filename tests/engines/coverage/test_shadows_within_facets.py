"""Shadows that begin and end between corners that agree, by closed form: of small plates above a floor of facets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import views
from glrender import Body, Renderer, Shape
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.view.view import view_bodies

RANGE_M, SIDE_PX, PITCH, N_CELLS, SIDE, HEIGHT = 1e6, 260, 4.0, 61, 1.0, 8.0
LIGHT = views.SOLAR_IRRADIANCE_W_M2 * 0.3 / np.pi * np.cos(0.25 * np.pi) / RANGE_M**2


def squares(middle, side, height):
    """Vertices (4 N, 3) and facets (2 N, 3) of squares about middles (N, 2), that face -z in the camera's axes."""
    corner = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * side
    place = (middle[:, None] + corner).reshape(-1, 2)
    first = 4 * np.arange(len(middle))[:, None]
    return (np.column_stack([place, np.full(len(place), -height)]),
            np.concatenate([first + [0, 2, 1], first + [0, 3, 2]]))


def test_shadows_far_from_any_boundary_are_found():
    """On the left they cover corners; on the right they lie across sides of facets, whose corners all have light."""
    grid = (np.arange(N_CELLS + 1) - 0.5 * N_CELLS) * PITCH
    x, y = np.meshgrid(grid, grid)
    i = np.arange((N_CELLS + 1)**2).reshape(N_CELLS + 1, -1)
    a, b, c, d = (each.ravel() for each in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    facets = np.concatenate([np.column_stack([a, c, b]), np.column_stack([a, d, c])])
    places = np.array([[grid[4 * k + 2], grid[4 * j + 2]] for k in range(6) for j in range(14)])
    across = np.array([[grid[4 * k + 34] + 0.5 * PITCH, grid[4 * j + 2]] for k in range(6) for j in range(14)])
    shadow = np.concatenate([places, across]) + 0.1
    plates, of_plates = squares(shadow + [HEIGHT, 0.0], SIDE, HEIGHT)
    camera, at = views.camera(SIDE_PX, RANGE_M), views.state(direction=(0.0, 0.0, 1.0), range_m=RANGE_M)
    from_body = view_bodies(at, camera, views.scene([views.sphere(Lambert(normal_albedo=0.3), 0)], [camera]).hulls)[0]
    turn = from_body.camera_from_body
    shape = Shape.from_arrays(np.concatenate([floor, plates]) @ turn, np.concatenate([facets, of_plates + len(floor)]))
    scene = views.scene([Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))], [camera], sun_disc=False)
    state = replace(at, r_sun_inertial_m=AU_M * np.array([1.0, 0.0, -1.0]) / np.sqrt(2.0) @ turn)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.01)
    edge = np.arange(SIDE_PX) - 0.5 * SIDE_PX

    def within(low, high):
        return np.maximum(np.minimum(high[..., None], edge + 1.0) - np.maximum(low[..., None], edge), 0.0)

    half = np.array(0.5 * N_CELLS * PITCH)
    whole = np.outer(within(-half, half), within(-half, half))
    dark = np.einsum("ki,kj->ij", *(within(shadow[:, k] - 0.5 * SIDE, shadow[:, k] + 0.5 * SIDE) for k in (1, 0)))
    found = image.irradiance_W_m2 / LIGHT
    error = views.relative_rms(found, whole - dark)
    assert error <= image.plan.predicted_error <= 0.011
