"""Random eclipses, annuli and binaries: a body in the penumbra of a sphere, and the closed form of what it takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from glrender import Body, Pose, Scene, State, generate
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.base.rotations import sun_from_body
from glrender.brdf import Lambert
from glrender.engines.rays.engine import RayEngine
from glrender.view.view import between, view_bodies

from .random_scenes import Draw, draw

KINDS = ("eclipse", "annulus", "binary")
# Bodies in penumbras: convex and not, of 3,000 to 20,000 facets.
_BODIES = ("sphere 20k", "sphere 20k", "gaussian 20k", "binary 20k", "itokawa 3k", "67p 4k")


def draw_eclipse(seed: int, kind: str | None = None, sides_px: tuple[int, ...] = (64, 96, 128)) -> Draw:
    """A random body of 3 px to a frame, and a sphere sunward of it whose penumbra it meets, with a tolerance.

    The penumbra is 0.05 to 5 radii wide. An eclipse's sphere has 0.5 to 3 radii, an annulus's is smaller than the
    Sun's disc behind it, and a binary's is 2 to 12 radii off.
    """
    rng = np.random.default_rng([31, seed])
    kind = kind or str(rng.choice(KINDS))
    frame_px = int(rng.choice(sides_px))
    case = draw(seed, list(_BODIES), frame_px=frame_px, sizes_px=(3.0, 0.8 * frame_px), budgets=(0.005, 0.1))
    receiver, r_sun = case.scene.bodies[0], case.state.r_sun_inertial_m
    radius_m, sun_m = receiver.shape.radius_m, float(np.linalg.norm(r_sun))
    sun_rad = SUN_RADIUS_M / sun_m
    half_m = 0.5 * radius_m * 0.05 * 100.0 ** rng.random()
    size_m = radius_m * (0.5 * 6.0 ** rng.random() if kind != "annulus" else 0.0)
    away_m = half_m / sun_rad
    if kind == "binary":
        away_m = radius_m * (2.0 + 10.0 * rng.random()) + size_m
        half_m = sun_rad * away_m
    if kind == "annulus":
        size_m = half_m * (0.1 + 0.8 * rng.random())
    away_m = max(away_m, 1.5 * (radius_m + size_m))
    x, y, z = sun_from_body(r_sun / sun_m)
    place = r_camera = case.state.spacecraft.r_inertial_m
    while np.linalg.norm(place - r_camera) < 1.1 * size_m:
        off_m, turn = (size_m + half_m + 0.6 * radius_m) * rng.random(), rng.uniform(0.0, 2.0 * np.pi)
        place = away_m * z + off_m * (np.cos(turn) * x + np.sin(turn) * y)
    sphere = Body(name="sphere", shape=generate.icosphere(radius_m=size_m, subdivisions=5),
                  brdf=Lambert(normal_albedo=0.3))
    scene = Scene(bodies=[receiver, sphere], cameras=list(case.scene.cameras))
    state = replace(case.state, bodies={**case.state.bodies, "sphere": Pose(r_inertial_m=place)})
    return replace(case, scene=scene, state=state, body=f"{kind}, {case.body}")


class SpheresBefore:
    """Light of a scene whose last body, a sphere, alone shades others: `units.dense_truth` asks it.

    Parameters
    ----------
    scene : Scene
    state : State
    """

    def __init__(self, scene: Scene, state: State):
        self._scene, self._engine = scene, RayEngine(scene)
        self._views = view_bodies(state, scene.cameras[0], scene.hulls)
        shape = scene.bodies[-1].shape
        corners = shape.vertices_m[shape.facets]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = 0.5 * np.linalg.norm(across, axis=1).sum()
        # Cauchy: the mean outline of a convex body has a quarter of its area.
        self._radius_m = float(np.sqrt(0.25 * area / np.pi))

    def __call__(self, pixel: np.ndarray, draw: np.ndarray) -> np.ndarray:
        """Irradiance (N,) [W/m2 per pixel] of places (N, 2) [px] by draws (N,) of the Sun's disc."""
        camera, found = self._scene.cameras[0], np.zeros(len(pixel))
        seen = self._engine.products(pixel, camera, self._views)
        for index, view in enumerate(self._views):
            here = np.flatnonzero(seen["body_id"] == index)
            if not len(here):
                continue
            found[here] = self._engine.irradiance(pixel[here], camera, [view], draw[here])
            if index < len(self._views) - 1:
                found[here] *= 1.0 - self._hidden(seen["r_body"][here] - view.centre_m, index)
        return found

    def _hidden(self, r_body_m: np.ndarray, index: int) -> np.ndarray:
        """Share (N,) of the Sun's disc that the sphere hides from points (N, 3) of a body."""
        view, sphere = self._views[index], self._views[-1]
        rotation, shift_m = between(sphere, view)
        to_sun = view.sun_direction_body * view.sun_distance_au * AU_M - r_body_m
        to_sphere = shift_m - r_body_m
        sun_m, sphere_m = (np.linalg.norm(each, axis=1) for each in (to_sun, to_sphere))
        apart = np.arctan2(np.linalg.norm(np.cross(to_sun, to_sphere), axis=1), (to_sun * to_sphere).sum(axis=1))
        return hidden_share(np.arcsin(self._radius_m / sphere_m), np.arcsin(SUN_RADIUS_M / sun_m), apart)


def hidden_share(radius: np.ndarray, disc: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """Share (N,) of a disc that another one hides, by their radii and the distance of their middles (N,) [rad].

    Source: the area that two circles share.
    """
    found = np.where(apart <= np.abs(radius - disc), np.minimum(radius, disc) ** 2 / disc**2, 0.0)
    part = (apart < radius + disc) & (apart > np.abs(radius - disc))
    d, a, s = apart[part], radius[part], disc[part]
    lens = (a**2 * np.arccos((d**2 + a**2 - s**2) / (2.0 * d * a))
            + s**2 * np.arccos((d**2 + s**2 - a**2) / (2.0 * d * s))
            - 0.5 * np.sqrt((-d + a + s) * (d + a - s) * (d - a + s) * (d + a + s)))
    found[part] = lens / (np.pi * s**2)
    return found
