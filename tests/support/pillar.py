"""A slab with a pillar that shades and hides part of it: the shape, a state, and its image by exact polygons."""

from __future__ import annotations

import numpy as np
import views
from glrender import Body, Pose, Shape, State, frames
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from moved_states import from_its_camera
from scipy.spatial import ConvexHull

HALF_M, SIDE_M, HEIGHT_M, RANGE_M, ALBEDO = 100.0, 40.0, 60.0, 4000.0, 0.3
CAMERA = views.camera(80, 1100.0)
X, Y = np.meshgrid(*2 * [(np.arange(80) - 39.5) / 25.0])
MOMENTS = (np.ones_like(X), X, Y, X * X, X * Y, Y * Y)


def state(sun_deg=40.0, emission_deg=35.0):
    """Camera and Sun on either side of the pillar, across its corners: what it hides and shades overlap in its base."""
    to_sun, to_camera = (np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
                         for angle, azimuth in np.radians([(sun_deg, 20.0), (emission_deg, 205.0)]))
    r_camera_m = RANGE_M * to_camera
    return State(r_sun_inertial_m=AU_M * to_sun,
                 spacecraft=Pose(r_inertial_m=r_camera_m, q_from_inertial=frames.look_at(r_camera_m, np.zeros(3))),
                 bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=(1.0, 0.0, 0.0, 0.0))})


STATE = state()


def square(half_m, height_m):
    corners = half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.column_stack([corners, np.full(4, height_m)])


def hull(points_m):
    return points_m[ConvexHull(points_m[:, :2]).vertices]


def covered(places):
    """The share (rows, columns) of each pixel that a polygon (N, 2) [px] covers, without a sign: by its sides alone."""
    image = np.zeros((CAMERA.height_px, CAMERA.width_px + 1))
    for (x0, y0), (x1, y1) in zip(places, np.roll(places, -1, axis=0), strict=True):
        # The side's parts in each row, and in each column of it.
        cuts = [0.0, 1.0]
        for begin, end in ((x0, x1), (y0, y1)):
            borders = np.arange(np.ceil(min(begin, end) - 0.5), np.floor(max(begin, end) + 0.5)) + 0.5
            cuts += ((borders - begin) / (end - begin)).tolist() if begin != end else []
        for one, other in zip(sorted(cuts), sorted(cuts)[1:], strict=False):
            x, y = (begin + 0.5 * (one + other) * (end - begin) for begin, end in ((x0, x1), (y0, y1)))
            row, column, height = int(np.floor(y + 0.5)), int(np.floor(x + 0.5)), (other - one) * (y1 - y0)
            image[row, column] += height * (column + 0.5 - x)
            image[row, column + 1] += height * (x - column + 0.5)
    return np.abs(np.cumsum(image, axis=1)[:, :-1])


def truth(state, camera, half_m=HALF_M, height_m=HEIGHT_M, top_m=(0.0, 0.0)):
    """Irradiance (rows, columns) float64 [W/m2] by polygons: the slab's top, less shadow and what the pillar hides.

    The pillar's top may be moved.
    """
    state = from_its_camera(state, camera)
    to_sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    r_camera_m, camera_axes = state.spacecraft.r_inertial_m, frames.dcm(state.spacecraft.q_from_inertial)
    base, top = square(0.5 * SIDE_M, 0.0), square(0.5 * SIDE_M, height_m) + (*top_m, 0.0)
    shadow = hull(np.concatenate([base, top - height_m * to_sun / to_sun[2]]))
    behind = r_camera_m + (top - r_camera_m) * (r_camera_m[2] / (r_camera_m[2] - height_m))
    areas = [(1.0, square(half_m, 0.0)), (-1.0, shadow), (-1.0, hull(np.concatenate([base, behind]))), (1.0, base),
             (1.0, top)]
    image = sum(sign * covered(camera.project((polygon - r_camera_m) @ camera_axes.T)) for sign, polygon in areas)
    x, y = np.meshgrid(*2 * [(np.arange(80) - 39.5) / camera.focal_length_px])
    solid_angle = camera.focal_length_px**-2 * (1.0 + x**2 + y**2) ** -1.5
    return image * solid_angle * views.SOLAR_IRRADIANCE_W_M2 * ALBEDO / np.pi * to_sun[2]


def slab():
    """Of one shell: rings of four corners, from the slab's bottom up to the pillar's top."""
    rings = [square(HALF_M, -20.0), square(HALF_M, 0.0), square(0.5 * SIDE_M, 0.0), square(0.5 * SIDE_M, HEIGHT_M)]
    facets = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for low in (0, 4, 8):
        for here, there in ((0, 1), (1, 2), (2, 3), (3, 0)):
            facets += [[low + here, low + there, low + 4 + there], [low + here, low + 4 + there, low + 4 + here]]
    return Shape.from_arrays(np.concatenate(rings), np.array(facets))


BODY = Body(name="body", shape=slab(), brdf=Lambert(normal_albedo=ALBEDO))


def moments(image):
    """Sums (6,) of an image, of it times the places, and times their squares: what places edges, to a pixel."""
    return np.array([(image * weight).sum() for weight in MOMENTS])
