"""An independent truth for images: float64 rays with Embree, area-sampled.

Shares nothing with the renderer but the laws' float64 side: its own projection, its own
shadow rays, its own normals. Embree finds the facet in float32; the point of intersection
is worked out again in float64 from the facet's plane.
"""

from __future__ import annotations

import itertools

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from scipy.spatial.transform import Rotation

AU_M, SUN_RADIUS_M = 149_597_870_700.0, 695_700_000.0


def trace(bodies, camera, state, solar_irradiance_1au_W_m2, samples=4, sun_disc=False):
    """Irradiance of each pixel, and the facet at its centre.

    Parameters
    ----------
    bodies : list of (name, vertices_m, facets, law)
    camera : PinholeCamera
    state : State
    samples : int
        Along a pixel's side, on a regular grid.
    sun_disc : bool
        Whether each of them has its own point of the Sun's disc.

    Returns
    -------
    irradiance_W_m2 : (H, W) float64
    facet : (H, W) int64
        Index into the concatenated facets at the pixel's centre, -1 beside; only for odd `samples`.
    range_m : (H, W) float64
        At the pixel's centre; only for odd `samples`.
    """
    return Tracer(bodies, camera, state).irradiance(solar_irradiance_1au_W_m2, samples, sun_disc)


class Tracer:
    """The acceleration structure of one state; `trace` makes and uses one."""

    def __init__(self, bodies, camera, state):
        self._bodies, self._camera = bodies, camera
        corners, owner = [], []
        for index, (name, vertices, facets, _) in enumerate(bodies):
            pose = state.bodies[name]
            rotation = Rotation.from_quat(pose.q_from_inertial, scalar_first=True)
            corners.append((vertices @ rotation.as_matrix() + pose.r_inertial_m)[facets])
            owner += [index] * len(facets)
        corners, self._owner = np.concatenate(corners), np.array(owner)
        spacecraft = Rotation.from_quat(state.spacecraft.q_from_inertial, scalar_first=True).as_matrix()
        mounting = Rotation.from_quat(camera.q_camera_from_spacecraft, scalar_first=True).as_matrix()
        self._inertial_from_camera = (mounting @ spacecraft).T
        corners = corners - (state.spacecraft.r_inertial_m + spacecraft.T @ camera.r_camera_spacecraft_m)
        self._corners, self._scale = corners, np.abs(corners).max()
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, (corners / self._scale).astype(np.float32))
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        sun = np.array([state.r_sun_inertial_m - state.bodies[name].r_inertial_m for name, *_ in bodies])
        self._sun_distance_au = np.linalg.norm(sun, axis=1) / AU_M
        self._sun = sun / np.linalg.norm(sun, axis=1, keepdims=True)

    def irradiance(self, solar_irradiance_1au_W_m2, samples, sun_disc=False):
        """Irradiance as of `trace`."""
        on_disc = self._on_disc(samples**2) if sun_disc else itertools.repeat(self._sun)
        camera, scene, scale = self._camera, self._scene, self._scale
        height, width = camera.height_px, camera.width_px
        total = np.zeros(height * width)
        centre_facet, centre_range = np.full(height * width, -1), np.full(height * width, np.nan)
        offsets = (np.arange(samples) + 0.5) / samples - 0.5
        y, x = np.mgrid[0:height, 0:width]
        cx, cy = camera.principal_point_px
        for (dx, dy), sun in zip(itertools.product(offsets, offsets), on_disc):  # noqa: B905 - the Sun goes on
            ray = np.stack([(x + dx - cx).ravel(), (y + dy - cy).ravel(),
                            np.full(height * width, camera.focal_length_px)], axis=1)
            length = np.linalg.norm(ray, axis=1, keepdims=True)
            cos_boresight = camera.focal_length_px / length[:, 0]
            ray = (ray / length) @ self._inertial_from_camera.T
            facet = _first_hit(scene, np.zeros_like(ray), ray)
            hit = np.flatnonzero(facet >= 0)
            f, d = facet[hit], ray[hit]
            n = self._normals[f]
            distance = np.einsum("ij,ij->i", self._corners[f, 0], n) / np.einsum("ij,ij->i", d, n)
            point = d * distance[:, None]
            to_sun = sun[self._owner[f]]
            lit = np.flatnonzero((np.einsum("ij,ij->i", n, to_sun) > 0.0)
                                 & (np.einsum("ij,ij->i", n, d) < 0.0))
            # Float32 about the camera puts a facet off by its farthest corner's rounding.
            lift = 1e-7 * np.abs(self._corners[f]).max(axis=(1, 2))
            start = (point + n * lift[:, None])[lit] / scale
            lit = lit[_first_hit(scene, start, to_sun[lit]) < 0]
            value = np.zeros(len(hit))
            for index, (*_, law) in enumerate(self._bodies):
                mine = lit[self._owner[f[lit]] == index]
                mu0 = np.einsum("ij,ij->i", n[mine], to_sun[mine])
                value[mine] = (law.brdf(to_sun[mine], -d[mine], n[mine]) * mu0 * solar_irradiance_1au_W_m2
                               / self._sun_distance_au[index] ** 2)
            total[hit] += value * cos_boresight[hit] ** 3 / camera.focal_length_px**2
            if abs(dx) < 1e-12 and abs(dy) < 1e-12:
                centre_facet[hit], centre_range[hit] = f, distance
        return ((total / samples**2).reshape(height, width), centre_facet.reshape(height, width),
                centre_range.reshape(height, width))


    def _on_disc(self, count):
        """Directions (bodies, 3) of points that fill the Sun's disc, in an order at random."""
        across = np.cross(self._sun[0], np.eye(3)[np.abs(self._sun[0]).argmin()])
        across /= np.linalg.norm(across)
        along = np.cross(self._sun[0], across)
        for k in np.random.default_rng(0).permutation(count):
            radius, angle = np.sqrt((k + 0.5) / count), k * np.pi * (3.0 - np.sqrt(5.0))
            aside = SUN_RADIUS_M / AU_M * radius * (np.cos(angle) * across + np.sin(angle) * along)
            sun = self._sun + aside / self._sun_distance_au[:, None]
            yield sun / np.linalg.norm(sun, axis=1, keepdims=True)


def _first_hit(scene, origins, directions):
    found = np.full(len(origins), -1)
    for start in range(0, len(origins), 1 << 20):
        part = slice(start, start + (1 << 20))
        found[part] = scene.run(np.ascontiguousarray(origins[part], np.float32),
                                np.ascontiguousarray(directions[part], np.float32))
    return found
