"""Keypoints of a scenario file: names and places on a body, in its table or in a CSV file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from glrender_camera.validate import name_of, position

from ...base.errors import ConfigError, error_path
from ...scene.scene import Scene
from ...scene.shape.facet_blocks import FacetBlocks
from .state_files import csv_rows

_COLUMNS = ("name", "r_x_m", "r_y_m", "r_z_m")
# Columns for people, that change no place.
_PASSED_OVER = ("comment", "comments", "description", "id", "note", "notes", "remark", "remarks", "source")
# Distance from the surface over the body's radius [1] beyond which a keypoint is likely another body's, or in km.
_OFF_SURFACE = 1e-3


def read_keypoints(value: object, folder: Path) -> dict[str, np.ndarray]:
    """Places (3,) [m] in the body's frame, by name.

    Parameters
    ----------
    value : table or str
        Names and [x, y, z], or the name of a CSV file with the columns `name`, `r_x_m`, `r_y_m`, `r_z_m`; others
        for people, as `description`, are passed over.
    folder : path
        Where the file's name leads from.

    Raises
    ------
    ConfigError
    """
    if isinstance(value, str):
        return _of_csv(folder / value)
    if not isinstance(value, Mapping) or not value:
        raise ConfigError("", "must be a table of names and places, or a CSV file's name", value)
    return {name_of("", name): position(name, place) for name, place in value.items()}


def off_surface(scene: Scene, keypoints: Mapping[str, Mapping[str, np.ndarray]]) -> list[str]:
    """A warning of each keypoint that is off its body's surface."""
    warnings = []
    for body in scene.bodies:
        if not (places := keypoints.get(body.name, {})):
            continue
        blocks = FacetBlocks(body.shape.vertices_m, body.shape.facets)
        for name, place in places.items():
            distance = blocks.distance_m(np.asarray(place, float))
            if distance > _OFF_SURFACE * body.hull.radius_m:
                warnings.append(f"keypoint {name!r} is {distance:.3g} m off the surface of {body.name!r}: labels say "
                                "that it is seen where the line to it is free; is it in metres, in the body's frame?")
    return warnings


def _of_csv(path: Path) -> dict[str, np.ndarray]:
    names, rows = csv_rows(path)
    if missing := [name for name in _COLUMNS if name not in names]:
        raise ConfigError(path.name, f"has no column {missing[0]!r}", hint=f"columns are {', '.join(_COLUMNS)}")
    if more := [name for name in names if name not in _COLUMNS and name.lower() not in _PASSED_OVER]:
        raise ConfigError(f"{path.name}.{more[0]}", "unknown column", hint=f"columns are {', '.join(_COLUMNS)}; passed "
                          f"over are {', '.join(_PASSED_OVER)}")
    found: dict[str, np.ndarray] = {}
    for line, cells in rows:
        row = dict(zip(names, cells, strict=True))
        with error_path(f"{path.name}, line {line}"):
            name = name_of("name", row["name"])
            if name in found:
                raise ConfigError("name", "must be unique", name)
            try:
                found[name] = position("", [float(row[column]) for column in _COLUMNS[1:]])
            except (TypeError, ValueError) as error:
                if isinstance(error, ConfigError):
                    raise
                raise ConfigError("", "must have three numbers", [row[column] for column in _COLUMNS[1:]]) from None
    if not found:
        raise ConfigError(path.name, "holds no keypoint")
    return found
