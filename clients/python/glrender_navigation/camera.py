"""On-board knowledge of a camera, and where it sees a body by a believed state."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from .checks import array, member, number, quaternion, refuse, whole


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
        Width of its point spread function, which rendered irradiance lacks.

    A lens that distorts is not modelled: undistort frames first (`cv2.undistort`).

    Raises
    ------
    ValueError
        With the field: a size below 1, a length that is not above zero, or a value that is no number.
    """

    width_px: int
    height_px: int
    focal_length_px: float
    principal_point_px: tuple[float, float] | None = None
    q_camera_from_spacecraft: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    r_camera_spacecraft_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    psf_sigma_px: float = 0.0

    def __post_init__(self):
        width_px, height_px = whole("width_px", self.width_px), whole("height_px", self.height_px)
        middle = ((width_px - 1) / 2.0, (height_px - 1) / 2.0)
        middle = middle if self.principal_point_px is None else self.principal_point_px
        checked = {
            "width_px": width_px, "height_px": height_px,
            "focal_length_px": number("focal_length_px", self.focal_length_px, "give it in pixels, as calibrated"),
            "principal_point_px": tuple(array("principal_point_px", middle, (2,), "give x and y").tolist()),
            "q_camera_from_spacecraft": tuple(
                quaternion("q_camera_from_spacecraft", self.q_camera_from_spacecraft).tolist()),
            "r_camera_spacecraft_m": tuple(
                array("r_camera_spacecraft_m", self.r_camera_spacecraft_m, (3,), "give x, y and z").tolist()),
            "psf_sigma_px": number("psf_sigma_px", self.psf_sigma_px, "0 is a sharp image", is_zero_allowed=True)}
        for name, value in checked.items():
            object.__setattr__(self, name, value)

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
    """A body as a camera should see it by a state: the belief before a frame is measured.

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

    @property
    def sunward_px(self) -> np.ndarray:
        """Direction (2,) of the Sun in the image, of length 1, or 0 where it is along the boresight."""
        across = self.sun_direction_camera[:2]
        return across / max(float(np.linalg.norm(across)), 1e-12)


def sight(state: StateLike, camera: Camera, body: str) -> Sight:
    """The place of a body in a camera by a state.

    Raises
    ------
    ValueError
        With the field of the state: no such body, a value that is no number, or two bodies at one place.
    """
    table = plain(state)
    r_craft, spacecraft_from_inertial = _pose("state.spacecraft", member("state", table, "spacecraft"))
    r_body, body_from_inertial = _pose(f"state.bodies.{body}",
                                       member("state.bodies", member("state", table, "bodies"), body))
    camera_from_inertial = _dcm(camera.q_camera_from_spacecraft) @ spacecraft_from_inertial
    to_body = r_body - r_craft - spacecraft_from_inertial.T @ np.asarray(camera.r_camera_spacecraft_m, float)
    if not to_body.any():
        raise refuse("state.spacecraft.r_inertial_m", f"must not put the camera into the origin of {body!r}", r_craft,
                     "the estimate may have diverged")
    r_sun = array("state.r_sun_inertial_m", member("state", table, "r_sun_inertial_m"), (3,), "give metres, inertial")
    to_sun = r_sun - r_body
    if not to_sun.any():
        raise refuse("state.r_sun_inertial_m", f"must not be the place of {body!r}", r_sun, "give metres, inertial")
    return Sight(r_body_camera_m=camera_from_inertial @ to_body,
                 sun_direction_camera=camera_from_inertial @ to_sun / np.linalg.norm(to_sun),
                 camera_from_body=camera_from_inertial @ body_from_inertial.T,
                 camera_from_inertial=camera_from_inertial)


def moved(state: StateLike, camera: Camera, body: str, r_body_camera_m: np.ndarray,
          camera_from_body: np.ndarray | None = None) -> dict[str, Any]:
    """The state with its spacecraft moved so that the body is at a place (3,) [m] in `camera`.

    The spacecraft is turned too where a rotation (3, 3) is given; else attitudes stay.
    """
    table, here = copy.deepcopy(plain(state)), sight(state, camera, body)
    if camera_from_body is not None:
        inertial_from_body = here.camera_from_inertial.T @ here.camera_from_body
        spacecraft_from_inertial = (_dcm(camera.q_camera_from_spacecraft).T @ camera_from_body @ inertial_from_body.T)
        table["spacecraft"]["q_from_inertial"] = Rotation.from_matrix(spacecraft_from_inertial).as_quat(
            scalar_first=True).tolist()
        here = sight(table, camera, body)
    moved_m = here.camera_from_inertial.T @ (here.r_body_camera_m - np.asarray(r_body_camera_m, float))
    table["spacecraft"]["r_inertial_m"] = (np.asarray(table["spacecraft"]["r_inertial_m"], float) + moved_m).tolist()
    return table


def others_px(state: StateLike, camera: Camera, body: str) -> dict[str, np.ndarray]:
    """Pixels (2,) of the other bodies of a state that are before the camera, by name."""
    others = {name: sight(state, camera, name).r_body_camera_m for name in plain(state)["bodies"] if name != body}
    return {name: camera.project(r_m) for name, r_m in others.items() if r_m[2] > 0.0}


def plain(state: StateLike) -> dict[str, Any]:
    """The dictionary of the wire."""
    return state.to_dict() if hasattr(state, "to_dict") else state


def _pose(field: str, table: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Place (3,) [m] and rotation (3, 3) from inertial axes."""
    r_m = array(f"{field}.r_inertial_m", member(field, table, "r_inertial_m"), (3,),
                "give metres; an estimate that is no number has diverged")
    q = table.get("q_from_inertial")
    return r_m, _dcm(None if q is None else quaternion(f"{field}.q_from_inertial", q))


def _dcm(q: np.ndarray | None) -> np.ndarray:
    return np.eye(3) if q is None else Rotation.from_quat(q, scalar_first=True).as_matrix()
