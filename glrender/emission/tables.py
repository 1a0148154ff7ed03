"""A scene's tables of sources, by model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from glrender_camera.validate import known_keys, positive

from ..errors import ConfigError
from ..scene import Body
from .dust import Dust
from .sources.haser import Haser

Resolve = Callable[[str, object], Path]


def strength_m(table: Mapping[str, Any], dust: Dust) -> float:
    """K [m] of a source: from `afrho_m`, or from `cross_section_rate_m2_s` and `speed_m_s`."""
    if "afrho_m" in table:
        if "cross_section_rate_m2_s" in table:
            raise ConfigError("afrho_m", "excludes cross_section_rate_m2_s")
        return dust.weight_m(positive("afrho_m", table["afrho_m"]))
    if "cross_section_rate_m2_s" not in table or "speed_m_s" not in table:
        raise ConfigError("afrho_m", "missing", hint="or give cross_section_rate_m2_s and speed_m_s")
    from math import pi

    # Number density rate / (4 pi v r^2), times each grain's cross-section.
    rate = positive("cross_section_rate_m2_s", table["cross_section_rate_m2_s"])
    return rate / (4.0 * pi * positive("speed_m_s", table["speed_m_s"]))


_STRENGTH = ("afrho_m", "cross_section_rate_m2_s", "speed_m_s")


def _haser(table: Mapping[str, Any], body: Body, dust: Dust, resolve: Resolve) -> Haser:
    keys = ("exponent", "reference_radius_m", "scale_length_m", "parent_length_m", "reach_m")
    known_keys("", table, (*_STRENGTH, *keys))
    return Haser(weight_m=strength_m(table, dust), **{key: table[key] for key in keys if key in table})


MODELS: dict[str, Callable[[Mapping[str, Any], Body, Dust, Resolve], Any]] = {"haser": _haser}
