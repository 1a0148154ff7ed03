"""Random scenes on which engines differ most: few large facets that are seen near, and crescents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from glrender import Body, PinholeCamera, Pose, Scene, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert, LommelSeeliger
from scipy.spatial import ConvexHull

from .random_scenes import Draw, random_quaternion
from .scenes import HAPKE
from .units import draw_small

_LAWS = (Lambert(normal_albedo=0.3), LommelSeeliger(single_scattering_albedo=0.3), HAPKE)


def draw_plain(seed: int) -> Draw:
    """A random scene of boxes, a crystal or a sphere of few facets, from 3 to 100 radii, in 96 x 96 px."""
    rng = np.random.default_rng([20261127, seed])
    kind = str(rng.choice(["boxes", "crystal", "sphere"]))
    if kind == "boxes":
        shape = _boxes(rng)
    elif kind == "crystal":
        points = _units(rng, rng.integers(5, 40)) * 100.0
        shape = Shape.from_arrays(points, _outward(points, ConvexHull(points).simplices))
    else:
        shape = generate.icosphere(radius_m=100.0, subdivisions=int(rng.integers(0, 4)))
    body_px, range_m = float(20.0 * 6.0 ** rng.random()), shape.radius_m * float(3.0 * 33.0 ** rng.random())
    phase_deg, law = float(rng.uniform(10.0, 130.0)), _LAWS[rng.integers(len(_LAWS))]
    direction, up = _units(rng, 2)
    r_camera_m, phase = range_m * direction, np.radians(phase_deg)
    q = frames.look_at(r_camera_m, np.zeros(3), up)
    state = State(r_sun_inertial_m=AU_M * (np.cos(phase) * direction + np.sin(phase) * frames.dcm(q)[0]),
                  spacecraft=Pose(r_inertial_m=r_camera_m, q_from_inertial=q),
                  bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=random_quaternion(rng))})
    camera = PinholeCamera(name="navcam", width_px=96, height_px=96,
                           focal_length_px=body_px * range_m / (2.0 * shape.radius_m))
    return Draw(scene=Scene(bodies=[Body(name="body", shape=shape, brdf=law)], cameras=[camera]), state=state,
                body=kind, law=law.glsl, body_px=body_px, phase_deg=phase_deg, max_error=0.02)


def draw_crescent(seed: int) -> Draw:
    """A scene of `draw_small` at a phase angle of 145 to 175 deg."""
    case, rng = draw_small(seed), np.random.default_rng([19, seed])
    place, phase_deg = case.state.spacecraft, float(rng.uniform(145.0, 175.0))
    direction, phase = place.r_inertial_m / np.linalg.norm(place.r_inertial_m), np.radians(phase_deg)
    sun = case.state.r_sun_inertial_m
    aside = sun / np.linalg.norm(sun) - direction * float(direction @ sun) / np.linalg.norm(sun)
    aside /= np.linalg.norm(aside)
    body, = case.scene.bodies
    if body.brdf.max_phase < phase:
        body = replace(body, brdf=_LAWS[0])
    r_sun_m = np.linalg.norm(sun) * (np.cos(phase) * direction + np.sin(phase) * aside)
    return replace(case, scene=replace(case.scene, bodies=[body]), phase_deg=phase_deg,
                   state=replace(case.state, r_sun_inertial_m=r_sun_m))


def _boxes(rng: np.random.Generator) -> Shape:
    """One to eight boxes of any proportions, apart from each other, turned together."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    sides = np.array([[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
                      [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]])
    count = int(rng.integers(1, 9))
    vertices = [(corners - 0.5) * 10.0 ** rng.uniform(0.5, 2.0, 3) + 120.0 * k * _units(rng, 1)[0]
                for k in range(count)]
    return Shape.from_arrays(np.concatenate(vertices), np.concatenate([sides + 8 * k for k in range(count)]))


def _outward(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Facets (F, 3) of a convex hull around the origin, counter-clockwise from outside."""
    a, b, c = (points[facets[:, k]] for k in range(3))
    is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - points.mean(axis=0)) < 0.0
    return np.where(is_inward[:, None], facets[:, ::-1], facets)


def _units(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]
