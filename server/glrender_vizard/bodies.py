"""From Basilisk's names to bodies and cameras of a scene: the map, a TOML file, and spheres where it is silent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
from glrender import Body, ConfigError, PinholeCamera, Shape, generate
from glrender.brdf import Lambert
from glrender.scene.scene_file import Files, body, camera, read_toml, tables
from glrender.scene.tolerance import checked_max_error
from glrender_camera import MosaicModel
from glrender_camera.errors import error_path
from glrender_camera.validate import integer, known_keys, text, unit_vectors, vector, within

from .messages import Camera as SentCamera
from .messages import CelestialBody, CustomModel

_MAP_KEYS = ("bodies", "cameras", "models", "max_error", "white_radf", "sun_direction_inertial")
_CAMERA_KEYS = ("id", "white_radf", "principal_point_px", "model", "distortion")
_PRIMITIVES = ("CUBE", "CYLINDER", "CAPSULE", "SPHERE", "HI_DEF_SPHERE")
# Normal albedo of bodies that the map does not name, between the Moon's and Venus': bright enough for thresholds.
_NORMAL_ALBEDO = 0.5
# A sphere's facets leave its outline by 8e-5 of its radius on average.
_SUBDIVISIONS = 5
# A smaller ratio of radii is no flat body but a field that was left out.
_MIN_POLAR_RATIO = 0.1


@dataclass(frozen=True, kw_only=True)
class MappedCamera:
    """Settings of a camera, by its id, that no message of Basilisk's carries: fields of a scene file's camera."""

    white_radf: float | str
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyMap:
    """Bodies, cameras and settings of a map file; without one everything has its default.

    Parameters
    ----------
    bodies : mapping of str to Body
        Celestial bodies and spacecraft by Basilisk's name.
    cameras : mapping of int to MappedCamera
    models : path, optional
        The only folder in which custom models of messages are looked up.
    max_error : float
        As of `Scene`.
    white_radf : float or "auto"
        I/F that is white, 255, in pictures of cameras without a model; "auto" makes the brightest pixel 204.
    sun_direction_inertial : (3,) float
        Towards the Sun, where a simulation has none.
    """

    bodies: Mapping[str, Body] = field(default_factory=dict)
    cameras: Mapping[int, MappedCamera] = field(default_factory=dict)
    models: Path | None = None
    max_error: float = 0.02
    white_radf: float | str = 1.0
    sun_direction_inertial: tuple[float, float, float] = (1.0, 0.0, 0.0)

    @classmethod
    def load(cls, path: Path) -> BodyMap:
        """The map of a TOML file; names of files are relative to it.

        Raises
        ------
        ConfigError, ShapeError
        """
        table = read_toml(path)
        with error_path(path.name):
            return cls.from_dict(table, path.parent)

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], folder: Path) -> BodyMap:
        """The map of plain data, whose names of files are relative to a folder.

        Raises
        ------
        ConfigError, ShapeError
        """
        known_keys("", table, _MAP_KEYS)
        made: dict[str, Any] = {"white_radf": _white("white_radf", table.get("white_radf", 1.0))}
        bodies = [body(entry, f"bodies[{k}]", Files(folder, False))
                  for k, entry in enumerate(tables("bodies", table["bodies"]) if "bodies" in table else ())]
        made["bodies"] = {each.name: each for each in bodies}
        if len(made["bodies"]) < len(bodies):
            raise ConfigError("bodies", "must have each name once", sorted(each.name for each in bodies))
        cameras = [_camera_entry(f"cameras[{k}]", entry, made["white_radf"]) for k, entry in enumerate(
            tables("cameras", table["cameras"]) if "cameras" in table else ())]
        made["cameras"] = dict(cameras)
        if len(made["cameras"]) < len(cameras):
            raise ConfigError("cameras", "must have each id once", sorted(number for number, _ in cameras))
        if "models" in table:
            made["models"] = folder / text("models", table["models"])
            if not made["models"].is_dir():
                raise ConfigError("models", "must be a folder", str(made["models"]))
        if "max_error" in table:
            made["max_error"] = checked_max_error(table["max_error"])
        if "sun_direction_inertial" in table:
            direction = vector("sun_direction_inertial", table["sun_direction_inertial"])
            made["sun_direction_inertial"] = tuple(unit_vectors(
                "sun_direction_inertial", direction, "divide it by its length").tolist())
        return cls(**made)

    def white_radf_of(self, camera_id: int) -> float | str:
        """I/F that is white in a camera's pictures."""
        return self.cameras[camera_id].white_radf if camera_id in self.cameras else self.white_radf

    def camera(self, sent: SentCamera) -> PinholeCamera:
        """The camera of a message and its entry in the map.

        It looks from the pose that a state gives: its mounting is in the state already.

        Raises
        ------
        ConfigError
        """
        path = f"camera {sent.id}"
        if sent.mode:
            raise ConfigError(f"{path}.renderMode", "must be 0, an image: depth maps are not drawn", sent.mode)
        with error_path(path):
            fov_deg = within("fieldOfView", sent.fov_deg, 1e-6, 179.0)
            # Basilisk's own camera model (pixelLineConverter, horizonOpNav): pixels are counted, centres at integers,
            # and the boresight is at half the resolution.
            table = {"name": str(sent.id), "width_px": sent.width_px, "height_px": sent.height_px,
                     "focal_length_px": 0.5 * sent.height_px / math.tan(0.5 * math.radians(fov_deg)),
                     "principal_point_px": [0.5 * sent.width_px, 0.5 * sent.height_px]}
        return camera({**table, **(self.cameras[sent.id].fields if sent.id in self.cameras else {})}, path)

    def model_file(self, model: CustomModel) -> Path:
        """The file of a custom model: of its path the last name, in the folder of models alone.

        Raises
        ------
        ConfigError
        """
        name = PureWindowsPath(model.path).name
        path = Files(self.models, True).path(f"custom model {name!r}", name)
        if not path.is_file():
            raise ConfigError(f"custom model {name!r}", "must be in the folder of models",
                              hint="put it there, or give the body an entry in the map")
        return path


@cache
def _unit_sphere() -> Shape:
    return generate.icosphere(radius_m=1.0, subdivisions=_SUBDIVISIONS)


def sphere(sent: CelestialBody) -> Body:
    """A Lambert sphere in the place of a body that the map does not name, flattened as Basilisk says.

    Raises
    ------
    ConfigError
    """
    shape = _unit_sphere()
    ratio = sent.polar_ratio if _MIN_POLAR_RATIO <= sent.polar_ratio <= 1.0 else 1.0
    vertices_m = shape.vertices_m * (sent.radius_m * np.array([1.0, 1.0, ratio]))
    with error_path(f"body {sent.name!r}"):
        return Body(name=sent.name, shape=Shape.from_arrays(vertices_m, shape.facets), smooth_normals=True,
                    brdf=Lambert(normal_albedo=_NORMAL_ALBEDO))


def modelled(name: str, radius_m: float, model: CustomModel, path: Path) -> Body:
    """A body of a custom model's file.

    Its farthest vertex is at the radius that Basilisk gives the body, and the model's scale comes on top; of a
    spacecraft, or a body without a radius, the file's unit is the metre.

    Raises
    ------
    ConfigError, ShapeError
    """
    if any(model.rotation_deg):
        raise ConfigError(f"custom model {path.name!r}", "must have no rotation", model.rotation_deg,
                          "turn the file, or give the body an entry in the map")
    shape = Shape.from_file(path, length_unit="m")
    unit_m = radius_m / np.linalg.norm(shape.vertices_m, axis=1).max() if radius_m > 0.0 else 1.0
    with error_path(f"body {name!r}"):
        vertices_m = shape.vertices_m * (unit_m * np.array(model.scale)) + model.offset_m
        return Body(name=name, shape=Shape.from_arrays(vertices_m, shape.facets, uv=shape.uv),
                    brdf=Lambert(normal_albedo=_NORMAL_ALBEDO))


def is_primitive(model: CustomModel) -> bool:
    """Whether a custom model names one of Vizard's own forms, and no file."""
    return model.path.upper() in _PRIMITIVES


def _camera_entry(path: str, table: object, white_radf: float | str) -> tuple[int, MappedCamera]:
    table = known_keys(path, table, _CAMERA_KEYS, required=("id",))
    number = integer(f"{path}.id", table["id"], 0, 2**63 - 1)
    if "model" in table and "white_radf" in table:
        raise ConfigError(f"{path}.white_radf", "must be left out with a model, which has an exposure_s")
    white_radf = _white(f"{path}.white_radf", table.get("white_radf", white_radf))
    fields = {key: value for key, value in table.items() if key not in ("id", "white_radf")}
    # The simulation sends the resolution later; errors in the other fields are found at the start.
    made = camera({"name": str(number), "width_px": 64, "height_px": 64, "focal_length_px": 64.0, **fields}, path)
    if isinstance(made.model, MosaicModel):
        raise ConfigError(f"{path}.model", "must have no mosaic: Basilisk takes grey images of one band here")
    return number, MappedCamera(white_radf=white_radf, fields=fields)


def _white(path: str, value: object) -> float | str:
    return "auto" if value == "auto" else within(path, value, 1e-6, 1e3)
