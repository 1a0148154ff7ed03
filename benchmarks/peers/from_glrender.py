"""A PeerScene of a glrender scene and state: the geometry that every peer is given, in float64."""

from __future__ import annotations

import numpy as np
from glrender import PinholeCamera, Scene, State, frames
from glrender.base.constants import AU_M

from .peer_scene import PeerScene


def peer_scene(scene: Scene, state: State, camera: PinholeCamera) -> PeerScene:
    """Bodies of Lambert's law in the camera's frame; the Sun's direction is that of the first body."""
    spacecraft_from_inertial = frames.dcm(state.spacecraft.q_from_inertial)
    camera_from_inertial = frames.dcm(camera.q_camera_from_spacecraft) @ spacecraft_from_inertial
    r_camera = state.spacecraft.r_inertial_m + spacecraft_from_inertial.T @ camera.r_camera_spacecraft_m
    vertices, facets, albedos, offset = [], [], [], 0
    for body in scene.bodies:
        pose = state.bodies[body.name]
        placed = body.shape.vertices_m @ frames.dcm(pose.q_from_inertial) + (pose.r_inertial_m - r_camera)
        vertices.append(placed @ camera_from_inertial.T)
        facets.append(body.shape.facets + offset)
        albedos.append(np.full(len(body.shape.facets), body.brdf.normal_albedo))
        offset += len(placed)
    vertices = np.concatenate(vertices)
    to_sun = state.r_sun_inertial_m - state.bodies[scene.bodies[0].name].r_inertial_m
    distance = np.linalg.norm(to_sun)
    return PeerScene(
        width_px=camera.width_px, height_px=camera.height_px, focal_length_px=camera.focal_length_px,
        principal_point_px=np.array(camera.principal_point_px, float),
        vertices=vertices / np.linalg.norm(vertices, axis=1).max(),
        facets=np.concatenate(facets).astype(np.int32), normal_albedo=np.concatenate(albedos),
        to_sun=camera_from_inertial @ (to_sun / distance),
        solar_irradiance_W_m2=scene.solar_irradiance_of(camera) / (distance / AU_M) ** 2)
