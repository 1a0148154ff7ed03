"""From the tables of a scene file, or of the wire, to bodies, cameras and stars."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera import BrownConrady, CameraModel, MosaicModel, PinholeCamera, lens_of
from glrender_camera.validate import known_keys, one_of, positive, text

from ..base.errors import ConfigError, PluginError, error_path
from ..brdf import Law
from ..brdf.presets import PRESETS
from .body import NO_COORDINATES, Body
from .detail.config import Detail
from .lamp import Lamp
from .plugins.checks import blamed_on, is_foreign, named, try_law
from .plugins.registry import emissions, laws, shape_readers
from .shape import generate
from .shape.regions import OF_WHOLE_BODY, Region
from .shape.shape import SIDES, Shape, file_scale
from .shape.textures import read_texture
from .stars import Stars

# Sources of a body's shape, and the fields of files.
_SHAPES, _OF_FILES = ("shape", "generated", "terrain"), ("length_unit", "sides", "surface", "inside")
SHAPE_KEYS = _SHAPES + _OF_FILES
_BODY_KEYS = ("name", *SHAPE_KEYS, "brdf", "albedo_texture", "albedo_texture_gain", "smooth_normals", "detail",
              "albedo_projection", "materials", "regions")
_REGION_KEYS = (*SHAPE_KEYS, "brdf", "r_region_body_m", "q_body_from_region")
_CAMERA_KEYS = ("name", "width_px", "height_px", "focal_length_px", "principal_point_px",
                "q_camera_from_spacecraft", "r_camera_spacecraft_m", "model", "distortion")
# Longest name of a file on all file systems in use.
_MAX_NAME_BYTES = 255
_GENERATORS = ("icosphere", "contact_binary", "gaussian_random_sphere", "three_lobes")


@dataclass(frozen=True)
class Files:
    """The folder that names of files are relative to, and whether they may lead elsewhere."""

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
                raise ConfigError(field_path, f"must be a file name of at most {_MAX_NAME_BYTES} bytes without a 0",
                                  name)
            path = self.directory / name
            # A link inside the directory must not lead out.
            if path.exists() and path.resolve().parent != self.directory.resolve():
                raise ConfigError(field_path, "must be a file in the server's shape directory", name)
            return path
        return (self.directory or Path()) / name


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises
    ------
    ConfigError
        The file is missing, or is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(path), f"cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(str(path), f"is not TOML: {error}") from None


def tables(path: str, value: object) -> Sequence[Mapping[str, Any]]:
    """A list of tables that is not empty."""
    if not isinstance(value, Sequence) or isinstance(value, str) or not value:
        raise ConfigError(path, "must be a list of tables that is not empty", value,
                          f"in a file write [[{path.rpartition('.')[2]}]]" if isinstance(value, Mapping) else "")
    return value


def body(table: Mapping[str, Any], path: str, files: Files) -> Body:
    """A body of its table in a scene file."""
    known_keys(path, table, _BODY_KEYS, required=("name",))
    gain = positive(f"{path}.albedo_texture_gain", table.get("albedo_texture_gain", 1.0))
    with error_path(path):
        shape = shape_of(table, files)
    if "terrain" in table and "albedo_projection" in table and {"site_deg", "orthophoto"} & set(table["terrain"]):
        raise ConfigError(f"{path}.albedo_projection", "goes with ground about its planet's centre, without an "
                          "orthophoto", table["albedo_projection"], "say orthophoto in `terrain`: a GeoTIFF")
    if (albedo_map := getattr(shape, "albedo_map", None)) is not None:
        if "regions" in table:
            raise ConfigError(f"{path}.terrain.orthophoto", "goes with ground without regions",
                              hint=f"leave it or the regions out, or {OF_WHOLE_BODY}")
        albedo_map = albedo_map * np.float32(gain)
    if "albedo_texture" in table:
        if albedo_map is not None:
            raise ConfigError(f"{path}.albedo_texture", "goes with ground without an orthophoto",
                              table["albedo_texture"], "leave one out")
        with error_path(f"{path}.albedo_texture"):
            albedo_map = read_texture(files.path("", table["albedo_texture"])) * np.float32(gain)
        if shape.uv is None and "albedo_projection" not in table:
            raise ConfigError(f"{path}.albedo_texture", "needs a shape with texture coordinates, and this one has none",
                              table["albedo_texture"], NO_COORDINATES)
    law = read_law(table["brdf"], f"{path}.brdf") if "brdf" in table else None
    detail, materials = None, table.get("materials")
    if isinstance(materials, Mapping):
        materials = {name: read_law(each, f"{path}.materials.{name}") for name, each in materials.items()}
    if "detail" in table:
        with error_path(f"{path}.detail"):
            detail = Detail.from_table(table["detail"])
    regions = [_region(each, f"{path}.regions[{index}]", files) for index, each in enumerate(
        tables(f"{path}.regions", table["regions"]) if "regions" in table else ())]
    with error_path(path):
        return Body(name=table["name"], shape=shape, brdf=law, albedo_map=albedo_map, detail=detail,
                    smooth_normals=table.get("smooth_normals", False), albedo_projection=table.get("albedo_projection"),
                    materials=materials, regions=regions)


def _region(table: Mapping[str, Any], path: str, files: Files) -> Region:
    """A region of its table in a body's."""
    known_keys(path, table, _REGION_KEYS)
    law = read_law(table["brdf"], f"{path}.brdf") if "brdf" in table else None
    with error_path(path):
        return Region(shape=shape_of(table, files), brdf=law, r_region_body_m=table.get("r_region_body_m"),
                      q_body_from_region=table.get("q_body_from_region"))


def shape_of(table: Mapping[str, Any], files: Files) -> Shape:
    """The shape that `SHAPE_KEYS` of a body's table make; the paths of errors begin in the table."""
    if "shape" not in table and (of_files := next((key for key in _OF_FILES if key in table), None)):
        raise ConfigError(of_files, "goes with `shape`, a file", table[of_files],
                          "leave it out, or name a shape's file")
    if sum(key in table for key in _SHAPES) != 1:
        raise ConfigError("", "needs exactly one of `shape` (a file), `generated` and `terrain` (tables)")
    if "generated" in table:
        with error_path("generated"):
            arguments = dict(table["generated"]) if isinstance(table["generated"], Mapping) else {}
            if "kind" not in arguments:
                raise ConfigError("kind", "missing", hint=f"one of {', '.join(_GENERATORS)}")
            return _call(getattr(generate, one_of("kind", arguments.pop("kind"), _GENERATORS)), arguments)
    if "terrain" in table:
        with error_path("terrain"):
            return shape_readers()["tif"].from_table(table["terrain"], files.path)
    with error_path("shape"):
        file = files.path("", table["shape"])
    scale, sides = file_scale(file, table.get("length_unit")), one_of("sides", table.get("sides", "file"), SIDES)
    with error_path("shape"):
        return Shape.from_file(file, length_unit=scale, sides=sides, surface=table.get("surface"),
                               inside=table.get("inside", False))


def read_law(table: object, path: str) -> Law:
    """A reflectance law of its table in a scene file, or of a preset."""
    if isinstance(table, Mapping) and "preset" in table:
        known_keys(path, table, ("preset",))
        return PRESETS[one_of(f"{path}.preset", table["preset"], sorted(PRESETS))].law
    if not isinstance(table, Mapping):
        raise ConfigError(path, "must be a table", table, 'as { law = "lambert", normal_albedo = 0.1 }')
    if "law" not in table:
        raise ConfigError(f"{path}.law", "missing", hint=f"one of {', '.join(sorted(laws()))}, or a `preset`")
    law = laws()[one_of(f"{path}.law", table["law"], sorted(laws()))]
    arguments = {key: tuple(value) if isinstance(value, list) else value
                 for key, value in table.items() if key != "law"}
    with error_path(path), blamed_on(law):
        made = _call(law, arguments)
    try_law(made)
    return made


def emission(table: object, path: str, files: Files, bodies: Mapping[str, Body]) -> Any:
    """A source of light other than surfaces, by the plug-in of its `kind`."""
    if not isinstance(table, Mapping) or table.get("kind") not in emissions():
        kind = table.get("kind") if isinstance(table, Mapping) else table
        raise ConfigError(f"{path}.kind", f"must be one of {', '.join(sorted(emissions()))}", kind)
    arguments = {key: value for key, value in table.items() if key != "kind"}
    kind = emissions()[table["kind"]]
    with error_path(path), blamed_on(kind):
        made = kind.from_table(arguments, files.path, bodies)
    if is_foreign(kind) and not (hasattr(made, "body") and hasattr(made, "open")):
        raise PluginError(named(kind), "must return something with body and open from from_table", made)
    return made


def camera(table: Mapping[str, Any], path: str) -> PinholeCamera:
    """A camera of its table in a scene file."""
    known_keys(path, table, _CAMERA_KEYS, required=_CAMERA_KEYS[:4])
    arguments = dict(table)
    if "model" in arguments:
        with error_path(f"{path}.model"):
            is_mosaic = isinstance(arguments["model"], Mapping) and "pattern" in arguments["model"]
            arguments["model"] = (MosaicModel if is_mosaic else CameraModel).from_dict(arguments["model"])
    if "distortion" in arguments:
        with error_path(f"{path}.distortion"):
            arguments["distortion"] = BrownConrady.from_dict(arguments["distortion"])
    with error_path(path):
        made = PinholeCamera(**arguments)
        # The lens asks more of the field than the camera: a rim, and cells that are not stretched too far.
        lens_of(made)
    return made


def lamp(table: Mapping[str, Any], path: str) -> Lamp:
    """A lamp of its table in a scene file."""
    with error_path(path):
        return _call(Lamp, table)


def stars(table: Mapping[str, Any], path: str) -> Stars:
    """The sky of its table in a scene file."""
    with error_path(path):
        return _call(Stars, table)


def _call(function, arguments: Mapping[str, Any]):
    """Call with keyword arguments out of a file; a wrong name is the file's fault, and the error has it."""
    import inspect

    parameters = inspect.signature(function).parameters
    known_keys("", arguments, parameters,
               required=[name for name, p in parameters.items() if p.default is inspect.Parameter.empty])
    return function(**arguments)
