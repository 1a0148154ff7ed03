"""The belief: differences between the true scene and the one that an on-board estimator has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np
from glrender_camera import BrownConrady, PinholeCamera
from glrender_camera.validate import known_keys, position, positive, vector
from scipy.spatial.transform import Rotation

from ...base.errors import ConfigError, error_path
from ...scene.body import Body
from ...scene.scene import Scene
from ...scene.shape.shape import Shape
from ...view.state import Pose, State
from ..checks import angle_deg
from .decimation import checked_share, decimated

_ALBEDOS = ("normal_albedo", "single_scattering_albedo", "base_albedo")

# Lists of numbers go in, arrays come out.
_NOWHERE: Any = (0.0, 0.0, 0.0)
_NO_OFFSET: Any = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyBelief:
    """How a body is believed to be; fields that are not given are as in truth.

    Parameters
    ----------
    facets : float [1], 0..1, optional
        Share of the true shape's facets, or of `shape`'s, that the believed one has. Texture and detail are lost.
    shape : Shape, optional
        Another shape, without the true one's texture and detail.
    brdf : Law of glrender.brdf, optional
        Another law.
    albedo_factor : float [1], > 0
        On the law's albedo.
    pole_offset_deg : (2,) float [deg]
        Arcs that the believed pole, +Z of the body, is off: along rising right ascension, along rising declination.
    spin_phase_offset_deg : float [deg]
        How far the body is believed to have turned about its +Z more than it has.
    r_offset_m : (3,) float [m]
        Offset of the believed place from the true one, `inertial`.
    """

    facets: float | None = None
    shape: Shape | None = None
    brdf: Any = None
    albedo_factor: float = 1.0
    pole_offset_deg: np.ndarray = field(default=_NO_OFFSET)
    spin_phase_offset_deg: float = 0.0
    r_offset_m: np.ndarray = field(default=_NOWHERE)

    def __post_init__(self):
        if self.facets is not None:
            checked_share("facets", self.facets)
        _of_type("shape", self.shape, Shape, "leave out for the true one", is_optional=True)
        positive("albedo_factor", self.albedo_factor)
        pole = vector("pole_offset_deg", self.pole_offset_deg, 2)
        if not np.hypot(*pole) <= 180.0:
            raise ConfigError("pole_offset_deg", "must be within 180 degrees", pole.tolist())
        object.__setattr__(self, "pole_offset_deg", pole)
        object.__setattr__(self, "spin_phase_offset_deg", angle_deg("spin_phase_offset_deg",
                                                                    self.spin_phase_offset_deg))
        object.__setattr__(self, "r_offset_m", position("r_offset_m", self.r_offset_m))

    def body(self, truth: Body) -> Body:
        """The believed body of a true one."""
        has_shape = self.shape is None and self.facets in (None, 1.0)
        if self.brdf is None and truth.materials is not None:
            if not has_shape:
                raise ConfigError("brdf", "missing: the believed shape has none of the true one's materials")
            return replace(truth, materials={name: _scaled(law, self.albedo_factor)
                                             for name, law in truth.materials.items()})
        brdf = _scaled(self.brdf or truth.brdf, self.albedo_factor)
        if has_shape:
            return replace(truth, brdf=brdf, materials=None)
        shape = self.shape or truth.shape
        return Body(name=truth.name, shape=shape if self.facets is None else decimated(shape, self.facets), brdf=brdf,
                    smooth_normals=truth.smooth_normals)

    def pose(self, truth: Pose) -> Pose:
        """The believed pose of a true one."""
        body = Rotation.from_quat(truth.q_from_inertial, scalar_first=True)
        pole = body.inv().apply([0.0, 0.0, 1.0])
        right_ascension = np.arctan2(pole[1], pole[0])
        east = np.array([-np.sin(right_ascension), np.cos(right_ascension), 0.0])
        arc = np.radians(self.pole_offset_deg) @ np.stack([east, np.cross(pole, east)])
        # Components in a frame that turns one way turn the other.
        tilt = Rotation.from_rotvec(-np.cross(pole, arc))
        spin = Rotation.from_rotvec([0.0, 0.0, -np.radians(self.spin_phase_offset_deg)])
        return replace(truth, r_inertial_m=truth.r_inertial_m + self.r_offset_m,
                       q_from_inertial=(spin * body * tilt).as_quat(scalar_first=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraBelief:
    """How a camera is believed to be calibrated; fields that are not given are as in truth.

    Parameters
    ----------
    focal_length_factor : float [1], > 0
    principal_point_offset_px : (2,) float [px]
        Offset of the believed principal point from the true one.
    distortion : BrownConrady, optional
        Another one; `BrownConrady()` has none.
    """

    focal_length_factor: float = 1.0
    principal_point_offset_px: np.ndarray = field(default=_NO_OFFSET)
    distortion: BrownConrady | None = None

    def __post_init__(self):
        positive("focal_length_factor", self.focal_length_factor)
        _of_type("distortion", self.distortion, BrownConrady, "`BrownConrady()` has none; leave out for the true one",
                 is_optional=True)
        object.__setattr__(self, "principal_point_offset_px",
                           vector("principal_point_offset_px", self.principal_point_offset_px, 2))

    def camera(self, truth: PinholeCamera) -> PinholeCamera:
        """The believed camera of a true one."""
        return replace(truth, focal_length_px=truth.focal_length_px * self.focal_length_factor,
                       principal_point_px=np.add(truth.principal_point_px, self.principal_point_offset_px),
                       distortion=truth.distortion if self.distortion is None else self.distortion)


@dataclass(frozen=True, kw_only=True, eq=False)
class SpacecraftBelief:
    """How the spacecraft is believed to be placed and turned before a frame is measured.

    Parameters
    ----------
    r_offset_m, v_offset_m_s : (3,) float [m], [m/s]
        Offsets of the first estimate, `inertial`.
    attitude_offset_deg : (3,) float [deg]
        Error of the star tracker's attitude, about the spacecraft's axes, as a rotation vector.
    """

    r_offset_m: np.ndarray = field(default=_NOWHERE)
    v_offset_m_s: np.ndarray = field(default=_NOWHERE)
    attitude_offset_deg: np.ndarray = field(default=_NOWHERE)

    def __post_init__(self):
        object.__setattr__(self, "r_offset_m", position("r_offset_m", self.r_offset_m))
        object.__setattr__(self, "v_offset_m_s", vector("v_offset_m_s", self.v_offset_m_s))
        object.__setattr__(self, "attitude_offset_deg", vector("attitude_offset_deg", self.attitude_offset_deg))
        if not np.linalg.norm(self.attitude_offset_deg) <= 180.0:
            raise ConfigError("attitude_offset_deg", "must be within 180 degrees", self.attitude_offset_deg.tolist())

    def attitude(self, q_from_inertial: np.ndarray) -> np.ndarray:
        """The believed attitude [w, x, y, z] of a true one."""
        offset = Rotation.from_rotvec(-np.radians(self.attitude_offset_deg))
        return (offset * Rotation.from_quat(q_from_inertial, scalar_first=True)).as_quat(scalar_first=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """Differences of a believed scene from the true one; without any it is the true one.

    Parameters
    ----------
    bodies : mapping of name to BodyBelief
    cameras : mapping of name to CameraBelief
    spacecraft : SpacecraftBelief

    Raises
    ------
    ConfigError
        A member of another type, with its path.
    """

    bodies: Mapping[str, BodyBelief] = field(default_factory=dict)
    cameras: Mapping[str, CameraBelief] = field(default_factory=dict)
    spacecraft: SpacecraftBelief = field(default_factory=SpacecraftBelief)

    def __post_init__(self):
        for kind, of in (("bodies", BodyBelief), ("cameras", CameraBelief)):
            _of_type(kind, getattr(self, kind), Mapping, f"give names, each with its {of.__name__}")
            for name, belief in getattr(self, kind).items():
                _of_type(f"{kind}.{name}", belief, of, "leave out for the true one")
        _of_type("spacecraft", self.spacecraft, SpacecraftBelief, "leave out for the true one")

    def scene(self, truth: Scene) -> Scene:
        """The believed scene of a true one; faults of its cameras' frames are the truth's alone.

        Raises
        ------
        ConfigError
            A body or a camera that is not there, or one that cannot be as it is believed, with its path.
        """
        for kind in ("bodies", "cameras"):
            known_keys(kind, getattr(self, kind), [member.name for member in getattr(truth, kind)])
        bodies, cameras = [], []
        for body in truth.bodies:
            with error_path(f"bodies.{body.name}"):
                bodies.append(self.bodies[body.name].body(body) if body.name in self.bodies else body)
        for camera in truth.cameras:
            with error_path(f"cameras.{camera.name}"):
                cameras.append(_faultless(self.cameras.get(camera.name, CameraBelief()).camera(camera)))
        return replace(truth, bodies=bodies, cameras=cameras)

    def state(self, truth: State, spacecraft: Pose) -> State:
        """The believed state at a true one: bodies and Sun by the believed ephemerides, the spacecraft as estimated.

        Parameters
        ----------
        truth : State
            Its spacecraft is not looked at.
        spacecraft : Pose
            The estimate.
        """
        bodies = {name: self.bodies[name].pose(pose) if name in self.bodies else pose
                  for name, pose in truth.bodies.items()}
        return replace(truth, spacecraft=spacecraft, bodies=bodies)

    def told(self, truth: Scene) -> list[str]:
        """One sentence for each member of a scene that is believed to differ, for a person."""
        sentences = []
        for kind, believed in (("body", self.bodies), ("camera", self.cameras), ("", {"spacecraft": self.spacecraft})):
            for name, belief in believed.items():
                if differences := _differences(belief):
                    sentences.append(f"{kind} {name}: {', '.join(differences)}".strip())
        return sentences


def _of_type(path: str, value: object, of: type, hint: str, *, is_optional: bool = False) -> None:
    if not isinstance(value, of) and not (is_optional and value is None):
        raise ConfigError(path, f"must be a {of.__name__}", value, hint)


def _faultless(camera: PinholeCamera) -> PinholeCamera:
    return replace(camera, model=replace(camera.model, faults=())) if camera.model is not None else camera


def _differences(belief: Any) -> list[str]:
    """The fields of a belief that are not as by default, with their values."""
    found, plain = [], type(belief)()
    for entry in fields(belief):
        value = getattr(belief, entry.name)
        if not np.array_equal(value, getattr(plain, entry.name)):
            if isinstance(value, Shape):
                value = f"another of {len(value.facets)} facets"
            elif is_dataclass(value):
                value = type(value).__name__
            found.append(f"{entry.name} {value.tolist() if isinstance(value, np.ndarray) else value}")
    return found


def _scaled(law: Any, factor: float) -> Any:
    if factor == 1.0:
        return law
    for name in _ALBEDOS:
        if hasattr(law, name):
            return replace(law, **{name: factor * getattr(law, name)})
    raise ConfigError("albedo_factor", f"goes with a law that has one of {', '.join(_ALBEDOS)}", type(law).__name__,
                      "give another `brdf`")
