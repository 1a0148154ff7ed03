"""On-board knowledge of a camera, and where it sees a body by a believed state."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation


class HasDict(Protocol):
    """A `glrender.State`, or another object with its `to_dict`."""

    def to_dict(self) -> dict[str, Any]: ...


StateLike = Mapping[str, Any] | HasDict


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera as its calibration has it.

    Parameters
    ----------
    width_px, height_px : int
    focal_length_px : float [px]
    principal_point_px : (float, float) [px], optional
        (0, 0) is the centre of the top-left pixel; the middle of the image by default.
    q_camera_from_spacecraft : (4,) float, optional
        Mounting, [w, x, y, z].
    r_camera_spacecraft_m : (3,) float [m], optional
        Place of the camera in the spacecraft's frame.
    psf_sigma_px : float [px], optional
        Of its point spread function, which rendered irradiance lacks.

    A lens that distorts is not modelled: undistort frames first (`cv2.undistort`).
    """

    width_px: int
    height_px: int
    focal_length_px: float
    principal_point_px: tuple[float, float] | None = None
    q_camera_from_spacecraft: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    r_camera_spacecraft_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    psf_sigma_px: float = 0.0

    def __post_init__(self):
        if self.principal_point_px is None:
            object.__setattr__(self, "principal_point_px", ((self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0))

    @classmethod
    def from_hello(cls, table: Mapping[str, Any], psf_sigma_px: float = 0.0) -> Camera:
        """The camera of an entry of `cameras` in a server's `hello`.

        Raises
        ------
        ValueError
            Its lens distorts.
        """
        if table.get("distortion"):
            raise ValueError(f"cameras.{table['name']}.distortion: must be none, got {table['distortion']}; undistort "
                             "frames with cv2.undistort and name an on-board camera without distortion")
        return cls(width_px=table["width_px"], height_px=table["height_px"], focal_length_px=table["focal_length_px"],
                   principal_point_px=tuple(table["principal_point_px"]), psf_sigma_px=psf_sigma_px,
                   q_camera_from_spacecraft=tuple(table["q_camera_from_spacecraft"]),
                   r_camera_spacecraft_m=tuple(table["r_camera_spacecraft_m"]))

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) float64, the camera matrix of OpenCV."""
        (cx, cy), f = self.principal_point_px, self.focal_length_px
        return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])

    def direction(self, pixel: np.ndarray) -> np.ndarray:
        """Unit vectors (..., 3) in `camera` towards pixels (..., 2)."""
        offset = (np.asarray(pixel, float) - self.principal_point_px) / self.focal_length_px
        ray = np.concatenate([offset, np.ones((*offset.shape[:-1], 1))], axis=-1)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    def project(self, r_camera_m: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of places (..., 3) [m] before the camera."""
        r_camera_m = np.asarray(r_camera_m, float)
        return self.focal_length_px * r_camera_m[..., :2] / r_camera_m[..., 2:] + self.principal_point_px


@dataclass(frozen=True, kw_only=True, eq=False)
class Sight:
    """A body as a camera has it by a state: what is believed before a frame is looked at.

    Attributes
    ----------
    r_body_camera_m : (3,) float64 [m]
        The body's origin in `camera`.
    sun_direction_camera : (3,) float64
        Unit vector from the body towards the Sun, in `camera`.
    camera_from_body, camera_from_inertial : (3, 3) float64
        Rotations.
    """

    r_body_camera_m: np.ndarray
    sun_direction_camera: np.ndarray
    camera_from_body: np.ndarray
    camera_from_inertial: np.ndarray

    @property
    def range_m(self) -> float:
        """Distance [m] of the body's origin."""
        return float(np.linalg.norm(self.r_body_camera_m))

    @property
    def phase_rad(self) -> float:
        """Angle [rad] between the directions from the body to the Sun and to the camera."""
        return float(np.arccos(np.clip(-self.r_body_camera_m @ self.sun_direction_camera / self.range_m, -1.0, 1.0)))


def sight(state: StateLike, camera: Camera, body: str) -> Sight:
    """Where a state has a body in a camera; a state without that body is a KeyError."""
    table = plain(state)
    spacecraft, pose = table["spacecraft"], table["bodies"][body]
    spacecraft_from_inertial = _dcm(spacecraft.get("q_from_inertial"))
    camera_from_inertial = _dcm(camera.q_camera_from_spacecraft) @ spacecraft_from_inertial
    r_body = np.asarray(pose["r_inertial_m"], float)
    r_camera = (np.asarray(spacecraft["r_inertial_m"], float)
                + spacecraft_from_inertial.T @ np.asarray(camera.r_camera_spacecraft_m, float))
    to_sun = np.asarray(table["r_sun_inertial_m"], float) - r_body
    return Sight(r_body_camera_m=camera_from_inertial @ (r_body - r_camera),
                 sun_direction_camera=camera_from_inertial @ to_sun / np.linalg.norm(to_sun),
                 camera_from_body=camera_from_inertial @ _dcm(pose.get("q_from_inertial")).T,
                 camera_from_inertial=camera_from_inertial)


def moved(state: StateLike, camera: Camera, body: str, r_body_camera_m: np.ndarray) -> dict[str, Any]:
    """The state with its spacecraft moved so that the body is at a place (3,) [m] in `camera`; attitudes stay."""
    table, here = copy.deepcopy(plain(state)), sight(state, camera, body)
    moved_m = here.camera_from_inertial.T @ (here.r_body_camera_m - np.asarray(r_body_camera_m, float))
    table["spacecraft"]["r_inertial_m"] = (np.asarray(table["spacecraft"]["r_inertial_m"], float) + moved_m).tolist()
    return table


def plain(state: StateLike) -> dict[str, Any]:
    """The dictionary of the wire."""
    return state.to_dict() if hasattr(state, "to_dict") else state


def _dcm(q: np.ndarray | None) -> np.ndarray:
    return np.eye(3) if q is None else Rotation.from_quat(q, scalar_first=True).as_matrix()
