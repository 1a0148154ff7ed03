"""From the table [belief] of a scenario file to a `Belief`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from glrender_camera import BrownConrady
from glrender_camera.validate import known_keys

from ...base.errors import ConfigError, error_path
from ...scene.scene import Scene
from ...scene.scene_file import SHAPE_KEYS, Files, read_law, shape_of
from ..belief.belief import Belief, BodyBelief, CameraBelief, SpacecraftBelief
from .fields import a_table, made


def read_belief(table: object, scene: Scene, folder: Path) -> Belief:
    """A belief of its table, about the bodies and cameras of a scene; a believed shape is read from its file.

    Raises
    ------
    ConfigError
        A body, a camera or a field that is not there, or one that breaks a rule, with its path.
    """
    table = known_keys("", table, ("bodies", "cameras", "spacecraft"))
    parts: dict[str, Any] = {"bodies": {}, "cameras": {}}
    readers = {"bodies": lambda entry: _body(entry, folder), "cameras": _camera}
    for kind, read in readers.items():
        entries = known_keys(kind, table.get(kind, {}), [member.name for member in getattr(scene, kind)])
        for name, entry in entries.items():
            with error_path(f"{kind}.{name}"):
                parts[kind][name] = read(entry)
    with error_path("spacecraft"):
        return Belief(**parts, spacecraft=made(SpacecraftBelief, table.get("spacecraft", {})))


def _body(entry: object, folder: Path) -> BodyBelief:
    fields = a_table(entry)
    if of_shape := {key: fields.pop(key) for key in SHAPE_KEYS if key in fields}:
        fields["shape"] = shape_of(of_shape, Files(folder, restricted=False))
        if getattr(fields["shape"], "albedo_map", None) is not None:
            raise ConfigError("terrain.orthophoto", "is a texture, and believed shapes have none", None, "leave it out")
    if "brdf" in fields:
        fields["brdf"] = read_law(fields["brdf"], "brdf")
    return made(BodyBelief, fields)


def _camera(entry: object) -> CameraBelief:
    fields = a_table(entry)
    if "distortion" in fields:
        with error_path("distortion"):
            fields["distortion"] = BrownConrady.from_dict(fields["distortion"])
    return made(CameraBelief, fields)
