"""A scene's tables of sources, by model: `docs/coma.md` lists their keys."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.validate import finite, integer, known_keys, one_of, positive, vector, within

from ..base.errors import ConfigError, error_path
from ..scene.scene import Body
from .dust import Dust
from .grid_files import CHANNELS, read_grid
from .sources.activity import Activity
from .sources.facets import Facets, noise_strength
from .sources.haser import Haser
from .sources.jets import Jet, Jets, surface_point
from .sources.tail import Tail
from .sources.volume import Volume

Resolve = Callable[[str, object], Path]
_STRENGTH = ("afrho_m", "cross_section_rate_m2_s", "speed_m_s")


def strength_m(table: Mapping[str, Any], dust: Dust) -> float:
    """Mean K [m] of a source: from `afrho_m`, or from `cross_section_rate_m2_s` and `speed_m_s`."""
    if "afrho_m" in table:
        if "cross_section_rate_m2_s" in table:
            raise ConfigError("afrho_m", "excludes cross_section_rate_m2_s")
        return dust.weight_m(positive("afrho_m", table["afrho_m"]))
    if "cross_section_rate_m2_s" not in table or "speed_m_s" not in table:
        raise ConfigError("afrho_m", "missing", hint="or give cross_section_rate_m2_s and speed_m_s")
    rate = positive("cross_section_rate_m2_s", table["cross_section_rate_m2_s"])
    # Density on a sphere at a distance r: rate / (4 pi r^2 v), and K is that times r^2.
    return rate / (4.0 * math.pi * positive("speed_m_s", table["speed_m_s"]))


def _given(table: Mapping[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    return {key: table[key] for key in keys if key in table}


def _activity(table: Mapping[str, Any]) -> Activity:
    with error_path("activity"):
        return Activity(**known_keys("", table.get("activity", {}), ("exponent", "night", "lag_deg")))


def _haser(table: Mapping[str, Any], body: Body, dust: Dust, resolve: Resolve) -> Haser:
    keys = ("exponent", "reference_radius_m", "scale_length_m", "parent_length_m", "reach_m")
    known_keys("", table, (*_STRENGTH, *keys))
    return Haser(weight_m=strength_m(table, dust), **_given(table, keys))


def _jets(table: Mapping[str, Any], body: Body, dust: Dust, resolve: Resolve) -> Jets:
    known_keys("", table, ("jets", "activity"), required=("jets",))
    entries = table["jets"]
    if not isinstance(entries, list | tuple) or not 1 <= len(entries) <= 64:
        raise ConfigError("jets", "must be a list of 1 to 64 tables", entries)
    made = []
    for index, entry in enumerate(entries):
        with error_path(f"jets[{index}]"):
            made.append(_jet(entry, body, dust))
    return Jets(jets=tuple(made), activity_law=_activity(table))


def _jet(table: Mapping[str, Any], body: Body, dust: Dust) -> Jet:
    known_keys("", table, (*_STRENGTH, "latitude_deg", "longitude_deg", "half_width_deg", "collimation", "axis_body",
                           "vent_radius_m"), required=("latitude_deg", "longitude_deg", "half_width_deg"))
    latitude = math.radians(within("latitude_deg", table["latitude_deg"], -90.0, 90.0))
    longitude = math.radians(finite("longitude_deg", table["longitude_deg"]))
    direction = np.array([math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude),
                          math.sin(latitude)])
    vent, normal = surface_point(body.shape, direction)
    return Jet(vent_m=vent, normal=normal, axis=vector("axis_body", table.get("axis_body", normal)),
               weight_m=strength_m(table, dust), half_width_deg=finite("half_width_deg", table["half_width_deg"]),
               collimation=finite("collimation", table.get("collimation", 1.0)),
               vent_radius_m=positive("vent_radius_m", table.get("vent_radius_m", 0.05 * body.hull.radius_m)))


def _facets(table: Mapping[str, Any], body: Body, dust: Dust, resolve: Resolve) -> Facets:
    known_keys("", table, (*_STRENGTH, "noise", "table", "spread", "activity"))
    if "noise" in table and "table" in table:
        raise ConfigError("table", "excludes noise")
    if "table" in table:
        strength = _facet_table(resolve("table", table["table"]))
    elif "noise" in table:
        with error_path("noise"):
            given = known_keys("", table["noise"], ("seed", "roughness", "contrast"), required=("seed",))
            strength = noise_strength(body.shape, **given)
    else:
        strength = np.ones(len(body.shape.facets))
    return Facets(shape=body.shape, strength=strength, weight_m=strength_m(table, dust),
                  spread=finite("spread", table.get("spread", 1.0)), activity_law=_activity(table))


def _facet_table(path: Path) -> np.ndarray:
    """Strengths (F,): a `.npy`, or text with one number a line."""
    try:
        if path.suffix == ".npy":
            # Mapped: a header that promises more than the file holds is refused before memory is taken.
            values = np.load(path, allow_pickle=False, mmap_mode="r")
        else:
            # Lines, not a name: by a name NumPy would unpack compressed files.
            values = np.loadtxt(path.read_text(encoding="utf-8").splitlines(), delimiter=",")
    except Exception as error:  # a broken file raises anything
        raise ConfigError("table", f"cannot be read: {error}", str(path)) from None
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise ConfigError("table", "must hold numbers", str(path))
    return np.array(values)


def _tail(table: Mapping[str, Any], body: Body, dust: Dust, resolve: Resolve) -> Tail:
    needed = ("perihelion_au", "eccentricity", "true_anomaly_deg", "pole_inertial", "oldest_s", "length_m")
    keys = (*needed, "smallest_m", "largest_m", "size_exponent", "density_kg_m3", "pressure_efficiency", "speed_m_s",
            "speed_exponent", "rate_exponent", "particles", "cells", "seed")
    known_keys("", table, ("afrho_m", *keys), required=("afrho_m", *needed))
    return Tail(weight_m=dust.weight_m(positive("afrho_m", table["afrho_m"])), **_given(table, keys))


def _grid(table: Mapping[str, Any], body: Body, dust: Dust, resolve: Resolve) -> Volume:
    known_keys("", table, ("file", "channel", "particle_cross_section_m2", "cross_section_per_m", "frame", "refine"),
               required=("file",))
    if ("particle_cross_section_m2" in table) == ("cross_section_per_m" in table):
        raise ConfigError("particle_cross_section_m2", "give it for densities in 1/m3, or else cross_section_per_m")
    if "channel" in table:
        one_of("channel", table["channel"], CHANNELS)
    name = "particle_cross_section_m2" if "particle_cross_section_m2" in table else "cross_section_per_m"
    scale = positive(name, table[name])
    path = resolve("file", table["file"])
    with error_path("file"):
        grid = read_grid(path, table.get("channel", "dust"), partial(resolve, "tiles_file"))
    return Volume(cross_section_per_m=grid.density.astype(np.float64) * scale, low_m=grid.low_m, high_m=grid.high_m,
                  frame=table.get("frame", "body"), refine=integer("refine", table.get("refine", 1), 1, 8))


MODELS: dict[str, Callable[[Mapping[str, Any], Body, Dust, Resolve], Any]] = {
    "haser": _haser, "jets": _jets, "facets": _facets, "tail": _tail, "grid": _grid}
"""Names that `model` may have."""
