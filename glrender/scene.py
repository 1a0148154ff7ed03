"""The scene: bodies, cameras, the Sun and the error budget, validated once."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera import CameraModel, PinholeCamera
from glrender_camera.validate import finite, known_keys, one_of, positive, text, within

from . import generate
from .brdf import Law
from .brdf.presets import PRESETS
from .constants import TOTAL_SOLAR_IRRADIANCE_W_M2
from .errors import ConfigError, SceneError, ShapeError, error_path
from .hull import Hull
from .plugins import emissions, laws
from .radiometry import Band
from .shape import Shape, metres_per_unit

_SCENE_KEYS = ("bodies", "cameras", "solar_irradiance_1au_W_m2", "max_error", "emission")
_BODY_KEYS = ("name", "shape", "generated", "length_unit", "brdf", "albedo_texture", "albedo_texture_gain",
              "smooth_normals")
_CAMERA_KEYS = ("name", "width_px", "height_px", "focal_length_px", "principal_point_px",
                "q_camera_from_spacecraft", "r_camera_spacecraft_m", "model")
# Of one name on all file systems in use.
_MAX_NAME_BYTES = 255
_GENERATORS = ("icosphere", "contact_binary", "gaussian_random_sphere", "three_lobes")


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """A shape with its reflectance.

    Parameters
    ----------
    name : str
    shape : Shape
        Body-fixed, about the origin that a state's pose moves.
    brdf : Law
    albedo_map : (H, W) float, optional
        Factor on the law's albedo, row 0 on top; needs a shape with texture coordinates.
    smooth_normals : bool
        Interpolated normals; by default each facet has its own, as a shape model is a polyhedron.
    """

    name: str
    shape: Shape
    brdf: Law
    albedo_map: np.ndarray | None = None
    smooth_normals: bool = False

    def __post_init__(self):
        text("name", self.name)
        if not isinstance(self.shape, Shape):
            raise ConfigError("shape", "must be a glrender.Shape", self.shape)
        if not isinstance(self.brdf, Law):
            raise ConfigError("brdf", "must be a law of glrender.brdf", self.brdf)
        if not isinstance(self.smooth_normals, bool):
            raise ConfigError("smooth_normals", "must be true or false", self.smooth_normals)
        if self.albedo_map is not None:
            if self.shape.uv is None:
                raise ConfigError("albedo_map", "needs a shape with texture coordinates")
            try:
                albedo_map = np.array(self.albedo_map, dtype=np.float32)
            except (TypeError, ValueError):
                raise ConfigError("albedo_map", "must be a 2-D array of numbers", self.albedo_map) from None
            fits = albedo_map.ndim == 2 and albedo_map.size
            if not fits or not np.isfinite(albedo_map).all() or albedo_map.min() < 0.0:
                raise ConfigError("albedo_map", "must be a 2-D array of finite numbers >= 0, not empty")
            albedo_map.setflags(write=False)
            object.__setattr__(self, "albedo_map", albedo_map)

    @classmethod
    def from_file(cls, path: str | Path, *, name: str, length_unit: str | float, brdf: Law,
                  albedo_texture: str | Path | None = None, albedo_texture_gain: float = 1.0,
                  smooth_normals: bool = False) -> Body:
        """A body from a shape file.

        Parameters
        ----------
        path : path
            OBJ, PLY, STL, PDS plate model (.tab) or ICQ.
        length_unit : "m", "km" or float
            Of the file; metres per unit when a number.
        albedo_texture : path, optional
            Image whose grey value over its full scale, times `albedo_texture_gain`, scales the albedo.

        Raises
        ------
        ShapeError
        """
        albedo_map = None
        if albedo_texture is not None:
            gain = positive("albedo_texture_gain", albedo_texture_gain)
            with error_path("albedo_texture"):
                albedo_map = _read_texture(Path(albedo_texture)) * np.float32(gain)
        return cls(name=name, shape=Shape.from_file(path, length_unit=length_unit), brdf=brdf,
                   albedo_map=albedo_map, smooth_normals=smooth_normals)

    @cached_property
    def hull(self) -> Hull:
        """Convex hull of the shape."""
        return Hull(self.shape.vertices_m, self.shape.facets)


# A frozen dataclass with slots could not cache; the hull is derived and never compared.
@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What does not change from frame to frame.

    Parameters
    ----------
    bodies : sequence of Body
    cameras : sequence of PinholeCamera
    solar_irradiance_1au_W_m2 : float [W/m2], 1e-6..1e9, optional
        In the cameras' band, at 1 au. By default each camera has its own: that of its optics' `band_nm`
        (ASTM E490-00a), or the total solar irradiance, 1360.8 W/m2, of a camera without a model.
    max_error : float [1], 0..1
        Budget: RMS irradiance error over the mean of the lit pixels.
    emission : sequence
        Light that no surface scatters, as `emission_frame.Emission`: none unless asked for.
    """

    bodies: Sequence[Body]
    cameras: Sequence[PinholeCamera]
    solar_irradiance_1au_W_m2: float | None = None
    max_error: float = field(default=0.02)
    emission: Sequence[Any] = ()

    def __post_init__(self):
        for label, kind in (("bodies", Body), ("cameras", PinholeCamera)):
            members = getattr(self, label)
            if not isinstance(members, Iterable):
                raise ConfigError(label, f"must be a sequence of {kind.__name__}", members)
            members = tuple(members)
            if not members:
                raise ConfigError(label, "must have at least one member")
            names = set()
            for index, member in enumerate(members):
                if not isinstance(member, kind):
                    raise ConfigError(f"{label}[{index}]", f"must be a {kind.__name__}", member)
                if member.name in names:
                    raise ConfigError(f"{label}[{index}].name", "must be unique", member.name)
                names.add(member.name)
            object.__setattr__(self, label, members)
        if self.solar_irradiance_1au_W_m2 is not None:
            object.__setattr__(self, "solar_irradiance_1au_W_m2",
                               within("solar_irradiance_1au_W_m2", self.solar_irradiance_1au_W_m2, 1e-6, 1e9))
        object.__setattr__(self, "max_error", checked_max_error(self.max_error))
        object.__setattr__(self, "emission", tuple(self.emission))
        for index, emission in enumerate(self.emission):
            if emission.body not in {body.name for body in self.bodies}:
                raise ConfigError(f"emission[{index}].body", "must be a body of the scene", emission.body)

    def solar_irradiance_of(self, camera: PinholeCamera) -> float:
        """Solar irradiance in a camera's band at 1 au [W/m2]."""
        if self.solar_irradiance_1au_W_m2 is not None:
            return self.solar_irradiance_1au_W_m2
        return TOTAL_SOLAR_IRRADIANCE_W_M2 if camera.model is None else _band_irradiance(camera.model.optics.band_nm)

    def camera(self, name: str | None) -> PinholeCamera:
        """The camera of a name; None is the only one."""
        if name is None and len(self.cameras) == 1:
            return self.cameras[0]
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise SceneError("camera", "unknown camera", name,
                         f"the scene has {', '.join(camera.name for camera in self.cameras)}")

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], *, shape_dir: str | Path | None = None, path: str = "scene",
                  restricted: bool = False) -> Scene:
        """A scene from plain data: a TOML file's, or the wire's.

        Parameters
        ----------
        table : mapping
            Keys as in `docs/scene.md`.
        shape_dir : path, optional
            Where relative shape and texture names are looked up.
        restricted : bool
            Only bare file names inside `shape_dir`: for what comes over the wire.

        Raises
        ------
        ConfigError
            With the path of the field.
        """
        known_keys(path, table, _SCENE_KEYS, required=("bodies", "cameras"))
        files = _Files(Path(shape_dir) if shape_dir is not None else None, restricted)
        bodies = [_body(entry, f"{path}.bodies[{i}]", files)
                  for i, entry in enumerate(_tables(f"{path}.bodies", table["bodies"]))]
        cameras = [_camera(entry, f"{path}.cameras[{i}]")
                   for i, entry in enumerate(_tables(f"{path}.cameras", table["cameras"]))]
        rest = {key: table[key] for key in ("solar_irradiance_1au_W_m2", "max_error") if key in table}
        if "emission" in table:
            named = {body.name: body for body in bodies}
            rest["emission"] = [_emission(entry, f"{path}.emission[{i}]", files, named)
                                for i, entry in enumerate(_tables(f"{path}.emission", table["emission"]))]
        with error_path(path):
            return cls(bodies=bodies, cameras=cameras, **rest)


def load_scene(path: str | Path) -> Scene:
    """A scene from a TOML file; names of shapes and textures are relative to it.

    Raises
    ------
    ConfigError
        The file is missing, is not TOML, or a field breaks a rule.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(path), f"cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(str(path), f"is not TOML: {error}") from None
    return Scene.from_dict(table, shape_dir=path.parent, path=path.name)


def checked_max_error(value: float, name: str = "max_error") -> float:
    """An error budget in (0, 1]."""
    number = finite(name, value)
    if not 0.0 < number <= 1.0:
        raise ConfigError(name, "must be > 0 and <= 1", value)
    return number


@cache
def _band_irradiance(band_nm: tuple[float, float]) -> float:
    return Band.box(*band_nm).irradiance_1au_W_m2


@dataclass(frozen=True)
class _Files:
    """Where names of files lead, and whether they may lead anywhere."""

    directory: Path | None
    restricted: bool

    def path(self, field_path: str, name: object) -> Path:
        name = text(field_path, name)
        if self.restricted:
            if self.directory is None:
                raise ConfigError(field_path, "this server serves no files; start it with --shape-dir", name)
            if Path(name).name != name or name in (".", ".."):
                raise ConfigError(field_path, "must be a bare file name in the server's shape directory", name)
            if "\0" in name or len(name.encode("utf-8", "surrogatepass")) > _MAX_NAME_BYTES:
                raise ConfigError(field_path, f"must be a file name of at most {_MAX_NAME_BYTES} bytes, none of them 0",
                                  name)
            path = self.directory / name
            # A link inside the directory must not lead out of it.
            if path.exists() and path.resolve().parent != self.directory.resolve():
                raise ConfigError(field_path, "must be a file in the server's shape directory", name)
            return path
        return (self.directory or Path()) / name


def _tables(path: str, value: object) -> Sequence[Mapping[str, Any]]:
    if not isinstance(value, Sequence) or isinstance(value, str) or not value:
        raise ConfigError(path, "must be a list of tables that is not empty", value)
    return value


def _body(table: Mapping[str, Any], path: str, files: _Files) -> Body:
    known_keys(path, table, _BODY_KEYS, required=("name", "brdf"))
    if ("shape" in table) == ("generated" in table):
        raise ConfigError(path, "needs exactly one of `shape` (a file) and `generated` (a table)")
    albedo_map = None
    if "generated" in table:
        shape = _generated(table["generated"], f"{path}.generated")
    else:
        if "length_unit" not in table:
            raise ConfigError(f"{path}.length_unit", "missing", hint='shape files carry no unit: "m" or "km"')
        with error_path(path):
            length_unit = metres_per_unit(table["length_unit"])
        with error_path(f"{path}.shape"):
            shape = Shape.from_file(files.path("", table["shape"]), length_unit=length_unit)
    if "albedo_texture" in table:
        gain = positive(f"{path}.albedo_texture_gain", table.get("albedo_texture_gain", 1.0))
        with error_path(f"{path}.albedo_texture"):
            albedo_map = _read_texture(files.path("", table["albedo_texture"])) * np.float32(gain)
    law = _law(table["brdf"], f"{path}.brdf")
    with error_path(path):
        return Body(name=table["name"], shape=shape, brdf=law, albedo_map=albedo_map,
                    smooth_normals=table.get("smooth_normals", False))


def _generated(table: object, path: str) -> Shape:
    if not isinstance(table, Mapping) or "kind" not in table:
        raise ConfigError(f"{path}.kind", "missing", hint=f"one of {', '.join(_GENERATORS)}")
    kind = one_of(f"{path}.kind", table["kind"], _GENERATORS)
    arguments = {key: value for key, value in table.items() if key != "kind"}
    with error_path(path):
        return _call(getattr(generate, kind), arguments)


def _law(table: object, path: str) -> Law:
    if isinstance(table, Mapping) and "preset" in table:
        known_keys(path, table, ("preset",))
        return PRESETS[one_of(f"{path}.preset", table["preset"], sorted(PRESETS))].law
    if not isinstance(table, Mapping) or "law" not in table:
        raise ConfigError(f"{path}.law", "missing", hint=f"one of {', '.join(sorted(laws()))}, or a `preset`")
    law = laws()[one_of(f"{path}.law", table["law"], sorted(laws()))]
    arguments = {key: tuple(value) if isinstance(value, list) else value
                 for key, value in table.items() if key != "law"}
    with error_path(path):
        return _call(law, arguments)


def _emission(table: object, path: str, files: _Files, bodies: Mapping[str, Body]) -> Any:
    if not isinstance(table, Mapping) or table.get("kind") not in emissions():
        kind = table.get("kind") if isinstance(table, Mapping) else table
        raise ConfigError(f"{path}.kind", f"must be one of {', '.join(sorted(emissions()))}", kind)
    arguments = {key: value for key, value in table.items() if key != "kind"}
    with error_path(path):
        return emissions()[table["kind"]].from_table(arguments, files.path, bodies)


def _camera(table: Mapping[str, Any], path: str) -> PinholeCamera:
    known_keys(path, table, _CAMERA_KEYS, required=_CAMERA_KEYS[:4])
    arguments = dict(table)
    if "model" in arguments:
        with error_path(f"{path}.model"):
            arguments["model"] = CameraModel.from_dict(arguments["model"])
    with error_path(path):
        return PinholeCamera(**arguments)


def _call(function, arguments: dict[str, Any]):
    """Call with keyword arguments out of a file; a wrong name is the file's fault, told by name."""
    import inspect

    parameters = inspect.signature(function).parameters
    known_keys("", arguments, parameters,
               required=[name for name, p in parameters.items() if p.default is inspect.Parameter.empty])
    return function(**arguments)


def _read_texture(path: Path) -> np.ndarray:
    from PIL import Image

    # Planetary maps are large; a decompression bomb is larger.
    Image.MAX_IMAGE_PIXELS = 2**29
    try:
        with Image.open(path) as image:
            values = np.asarray(image if image.mode in ("L", "I;16", "I", "F") else image.convert("L"))
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise ShapeError("", f"texture cannot be read: {error}", str(path)) from None
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    full_scale = 65535.0 if values.dtype.itemsize > 1 else 255.0
    return values.astype(np.float32) / np.float32(full_scale)
