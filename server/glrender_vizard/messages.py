"""Basilisk's messages to Vizard, as far as a picture needs them: bodies, spacecraft, cameras, custom models.

Source: Basilisk 2.12, vizMessage.proto (field numbers) and vizInterface.cpp (units and frames).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from glrender import ProtocolError

from . import limits, wire

_NAME = wire.Text(limits.MAX_NAME_CHARACTERS)
_BODY = {1: ("name", _NAME), 2: ("position", "doubles"), 4: ("rotation", "doubles"), 6: ("radius_km", "double"),
         7: ("polar_ratio", "double")}
_SPACECRAFT = {1: ("name", _NAME), 2: ("position", "doubles"), 4: ("rotation", "doubles")}
_CAMERA = {1: ("id", "int"), 2: ("parent", _NAME), 3: ("fov_deg", "double"), 4: ("resolution", "ints"),
           7: ("position", "doubles"), 8: ("direction", "doubles"), 9: ("render_rate_ns", "int"), 16: ("mode", "int")}
_MODEL = {1: ("path", wire.Text(limits.MAX_PATH_CHARACTERS)),
          2: ("bodies", wire.Many(_NAME, limits.MAX_BODIES + limits.MAX_SPACECRAFT)),
          3: ("offset", "doubles"), 4: ("rotation", "doubles"),
          5: ("scale", "doubles")}
_UPDATE = {1: ("time", {1: ("frame", "int"), 2: ("elapsed_ns", "double")}),
           2: ("bodies", wire.Many(_BODY, limits.MAX_BODIES)),
           3: ("spacecraft", wire.Many(_SPACECRAFT, limits.MAX_SPACECRAFT)),
           4: ("cameras", wire.Many(_CAMERA, limits.MAX_SCENE_CAMERAS)),
           7: ("settings", {12: ("models", wire.Many(_MODEL, limits.MAX_MODELS))}),
           10: ("live", {3: ("terminate", "int")})}
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class CelestialBody:
    """A planet, moon or small body: place [m] and rows of the matrix from inertial to body-fixed components."""

    name: str
    r_inertial_m: tuple[float, ...]
    dcm_body_from_inertial: tuple[float, ...]
    radius_m: float
    polar_ratio: float


@dataclass(frozen=True, slots=True)
class Spacecraft:
    """A spacecraft: place [m] and attitude, modified Rodrigues parameters of its frame against the inertial one."""

    name: str
    r_inertial_m: tuple[float, ...]
    sigma_BN: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera: its vertical field of view [deg], edge to edge; its place [m] and attitude in its spacecraft's frame.

    `sigma_CuB` is of Vizard's camera axes (-x the boresight, z up).
    """

    id: int
    parent: str
    fov_deg: float
    width_px: int
    height_px: int
    r_camera_body_m: tuple[float, ...]
    sigma_CuB: tuple[float, ...]
    render_rate_ns: int
    mode: int

    def is_due(self, t_ns: int) -> bool:
        """Whether Basilisk asks for an image at this time."""
        return not self.render_rate_ns or t_ns % self.render_rate_ns == 0


@dataclass(frozen=True, slots=True)
class CustomModel:
    """A shape file that Basilisk names for bodies."""

    path: str
    bodies: tuple[str, ...]
    offset_m: tuple[float, ...]
    rotation_deg: tuple[float, ...]
    scale: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Update:
    """One epoch of a simulation. `models` is None where the message brings no settings: then the last ones hold."""

    frame: int
    t_ns: int
    bodies: tuple[CelestialBody, ...]
    spacecraft: tuple[Spacecraft, ...]
    cameras: tuple[Camera, ...]
    models: tuple[CustomModel, ...] | None
    is_last: bool


def read_update(data: bytes) -> Update:
    """The update of a `VizMessage`.

    Raises
    ------
    ProtocolError
        No such message, or a number that is not finite, with its place.
    """
    found = wire.read(data, _UPDATE)
    time, settings = found.get("time", {}), found.get("settings")
    elapsed_ns, = _finite("time", [time.get("elapsed_ns", 0.0)])
    if not abs(elapsed_ns) < 2.0**63:
        raise ProtocolError("time", "must be nanoseconds of 64 bits", elapsed_ns)
    return Update(
        frame=time.get("frame", 0), t_ns=round(elapsed_ns),
        bodies=tuple(_body(f"celestialBodies[{k}]", each) for k, each in enumerate(found["bodies"])),
        spacecraft=tuple(_spacecraft(f"spacecraft[{k}]", each) for k, each in enumerate(found["spacecraft"])),
        cameras=tuple(_camera(f"cameras[{k}]", each) for k, each in enumerate(found["cameras"])),
        models=None if settings is None else tuple(
            _model(f"settings.customModels[{k}]", each) for k, each in enumerate(settings["models"])),
        is_last=bool(found.get("live", {}).get("terminate")))


def _body(path: str, found: dict[str, Any]) -> CelestialBody:
    dcm = _numbers(f"{path}.rotation", found["rotation"], _IDENTITY)
    return CelestialBody(
        name=found.get("name", ""), r_inertial_m=_numbers(f"{path}.position", found["position"], (0.0, 0.0, 0.0)),
        # A body without an orientation has none but zeros.
        dcm_body_from_inertial=dcm if any(dcm) else _IDENTITY,
        radius_m=1e3 * _finite(f"{path}.radiusEq", [found.get("radius_km", 0.0)])[0],
        polar_ratio=_finite(f"{path}.radiusRatio", [found.get("polar_ratio", 1.0)])[0])


def _spacecraft(path: str, found: dict[str, Any]) -> Spacecraft:
    zero = (0.0, 0.0, 0.0)
    return Spacecraft(found.get("name", ""), _numbers(f"{path}.position", found["position"], zero),
                      _numbers(f"{path}.rotation", found["rotation"], zero))


def _camera(path: str, found: dict[str, Any]) -> Camera:
    width_px, height_px = _numbers(f"{path}.resolution", found["resolution"], (512, 512))
    zero = (0.0, 0.0, 0.0)
    return Camera(id=found.get("id", 0), parent=found.get("parent", ""),
                  fov_deg=_finite(f"{path}.fieldOfView", [found.get("fov_deg", 0.0)])[0],
                  width_px=width_px, height_px=height_px,
                  r_camera_body_m=_numbers(f"{path}.cameraPos_B", found["position"], zero),
                  sigma_CuB=_numbers(f"{path}.cameraDir_B", found["direction"], zero),
                  render_rate_ns=max(found.get("render_rate_ns", 0), 0), mode=found.get("mode", 0))


def _model(path: str, found: dict[str, Any]) -> CustomModel:
    zero = (0.0, 0.0, 0.0)
    return CustomModel(found.get("path", ""), tuple(found["bodies"]),
                       _numbers(f"{path}.offset", found["offset"], zero),
                       _numbers(f"{path}.rotation", found["rotation"], zero),
                       _numbers(f"{path}.scale", found["scale"], (1.0, 1.0, 1.0)))


def _numbers(path: str, given: Sequence[float], default: tuple[float, ...]) -> tuple[float, ...]:
    if not given:
        return default
    if len(given) != len(default):
        raise ProtocolError(path, f"must have {len(default)} numbers", len(given))
    return _finite(path, given)


def _finite(path: str, numbers: Iterable[float]) -> tuple[float, ...]:
    numbers = tuple(numbers)
    if not all(map(math.isfinite, numbers)):
        raise ProtocolError(path, "must be finite", numbers)
    return numbers
