"""States of one body and one camera with one parameter moved by a little: by words of docs/derivatives.md alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from glrender import frames
from scipy.spatial.transform import Rotation


def moved(state, camera, name, k, step):
    """(State, camera) with the k-th of a parameter's components moved by a step [m, rad, px]."""
    spacecraft = state.spacecraft
    camera_axes = frames.dcm(camera.q_camera_from_spacecraft) @ frames.dcm(spacecraft.q_from_inertial)
    axis = camera_axes[k % 3]
    if name == "focal_length":
        return state, replace(camera, focal_length_px=camera.focal_length_px + step)
    if name == "sun":
        distance_m = np.linalg.norm(state.r_sun_inertial_m)
        to_sun = state.r_sun_inertial_m / distance_m
        across = camera_axes[0] - to_sun * (camera_axes[0] @ to_sun)
        across /= np.linalg.norm(across)
        towards = across if k == 0 else np.cross(to_sun, across)
        turned = np.cos(step) * to_sun + np.sin(step) * towards
        return replace(state, r_sun_inertial_m=distance_m * turned), camera
    pose = spacecraft if name == "spacecraft" else state.bodies[name.removeprefix("bodies.")]
    if k < 3:
        pose = replace(pose, r_inertial_m=pose.r_inertial_m + step * axis)
    else:
        pose = replace(pose, q_from_inertial=frames.quaternion(
            frames.dcm(pose.q_from_inertial) @ Rotation.from_rotvec(-step * axis).as_matrix()))
    if name == "spacecraft":
        return replace(state, spacecraft=pose), camera
    return replace(state, bodies={**state.bodies, name.removeprefix("bodies."): pose}), camera


def from_its_camera(state, camera, name="body"):
    """A State about the body, in its axes, whose spacecraft is the camera: for truths that know no mounting or pose."""
    body, spacecraft = state.bodies[name], state.spacecraft
    body_axes, spacecraft_axes = frames.dcm(body.q_from_inertial), frames.dcm(spacecraft.q_from_inertial)
    r_camera_m = spacecraft.r_inertial_m + spacecraft_axes.T @ camera.r_camera_spacecraft_m
    camera_axes = frames.dcm(camera.q_camera_from_spacecraft) @ spacecraft_axes
    return replace(state, r_sun_inertial_m=body_axes @ (state.r_sun_inertial_m - body.r_inertial_m),
                   spacecraft=replace(spacecraft, r_inertial_m=body_axes @ (r_camera_m - body.r_inertial_m),
                                      q_from_inertial=frames.quaternion(camera_axes @ body_axes.T)),
                   bodies={name: replace(body, r_inertial_m=np.zeros(3), q_from_inertial=(1.0, 0.0, 0.0, 0.0))})
