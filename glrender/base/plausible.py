"""Fields whose values are allowed and yet improbable, most often for their unit: one table of bounds. Pure.

A new field is a line of `RULES`. Who has an object or a table of a kind asks `improbable`; what two fields together
tell stands where both are known: `scene/plausible.py`, `view/plausible.py`, `scenario/plausible.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .constants import AU_M, SUN_RADIUS_M

SUN_DISTANCES_AU = (0.04, 200.0)
"""Likely distances of the Sun [au]: beyond Parker Solar Probe's perihelion of 0.046 au, within the heliopause."""
SHORTEST_PERIOD_S = 100.0
"""Shortest likely period of rotation [s]: 2025 MN45, the fastest above 500 m, takes 113 s (Greenstreet et al. 2026)."""
FAST_ROTATOR_RADIUS_M = 50.0
"""Radius [m] up to which bodies may be whole rocks that turn faster: 2000 WH10, of some 94 m, takes 80 s (LCDB)."""
SHORTEST_PERIOD_OF_ROCKS_S = 1.0
"""Shortest likely period of those [s]: 2020 HS7 takes 3.0 s (LCDB)."""
FASTEST_CRAFT_RAD_S = 0.1
"""Largest likely rate of a spacecraft [rad/s]: CubeSats tumble at 5 deg/s after their release; spinners are faster."""


@dataclass(frozen=True, slots=True)
class Advice:
    """A warning: its kind, the field to look at, and a sentence with the observation and the way out."""

    code: str
    path: str
    message: str

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True, slots=True)
class Rule:
    """The likely values of a field.

    Parameters
    ----------
    of : str
        Kind of the table or object that has the field.
    field : str
    low, high : float
        Bounds of what `size` gives.
    unit : str
        Of the field.
    source : str
        Where the bounds are from, in a few words.
    others : tuple of (str, float)
        Units that the field is given in by mistake, and their size in the field's unit.
    size : callable
        From the value to the numbers that must be within the bounds.
    """

    of: str
    field: str
    low: float
    high: float
    unit: str
    source: str
    others: tuple[tuple[str, float], ...]
    size: Callable[[Any], Any] = abs

    def is_likely(self, value: Any, scale: float = 1.0) -> bool:
        """Whether a value, times a scale, is within the bounds."""
        size = np.asarray(self.size(value), float) * scale
        return bool(((size >= self.low) & (size <= self.high)).all())

    def way_out(self, value: Any) -> str:
        """The first two units in which the value would be likely, with what to write then; else the field's own."""
        numbers = np.asarray(value, float)
        meant = [f"in {unit}? then write {_text(numbers * factor)}" for unit, factor in self.others
                 if self.is_likely(value, factor)]
        return ", ".join(meant[:2]) or f"check its unit, {self.unit}"


def _length(value: Any) -> float:
    return math.hypot(*value)


def _unless_0(value: Any) -> Any:
    return value or math.inf


_LENGTHS = (("mm", 1e-3), ("cm", 1e-2), ("um", 1e-6), ("km", 1e3))
_FAR = (("km", 1e3), ("au", AU_M))
_TURNS = (("deg/s", math.pi / 180.0), ("rpm", math.pi / 30.0))
_TIMES = (("h", 3600.0), ("min", 60.0))
_SUN = tuple(AU_M * au for au in SUN_DISTANCES_AU)
_TURN = 2.0 * math.pi
_ROCK, _STEADY = SHORTEST_PERIOD_OF_ROCKS_S, SHORTEST_PERIOD_S
_FAST = "of bodies larger than 100 m the fastest takes 113 s"

RULES = (
    Rule("optics", "band_nm", 100.0, 1e5, "nm", "from the far ultraviolet to the far infrared",
         (("um", 1e3), ("m", 1e9), ("pm", 1e-3)), np.asarray),
    Rule("optics", "aperture_diameter_m", 1e-4, 2.0, "m", "of HiRISE 0.5 m, of the smallest lenses 0.5 mm", _LENGTHS),
    Rule("optics", "pixel_pitch_m", 3e-7, 1e-3, "m", "detectors have pixels of 0.5 to 50 um", _LENGTHS),
    Rule("law", "roughness_deg", 1.5, math.inf, "deg", "or 0; fits of small bodies have 5 to 40", (
        ("rad", 180.0 / math.pi),), _unless_0),
    Rule("camera", "r_camera_spacecraft_m", 0.0, 100.0, "m", "the longest boom in space had 60 m", _LENGTHS, _length),
    Rule("body", "rotation_period_s", _STEADY, math.inf, "s", _FAST, _TIMES),
    Rule("body", "rate_deg_day", 0.0, 360.0 * 86400.0 / _STEADY, "deg/day", _FAST, ()),
    Rule("body", "angular_velocity_rad_s", 0.0, _TURN / _STEADY, "rad/s", _FAST, _TURNS, _length),
    Rule("rock", "rotation_period_s", _ROCK, math.inf, "s", "the fastest asteroid known takes 3 s", _TIMES),
    Rule("rock", "rate_deg_day", 0.0, 360.0 * 86400.0 / _ROCK, "deg/day", "the fastest asteroid known takes 3 s", ()),
    Rule("rock", "angular_velocity_rad_s", 0.0, _TURN / _ROCK, "rad/s", "the fastest asteroid known takes 3 s", _TURNS,
         _length),
    Rule("spacecraft", "angular_velocity_rad_s", 0.0, FASTEST_CRAFT_RAD_S, "rad/s",
         "CubeSats tumble at 0.09 rad/s, only spinners turn faster", _TURNS, _length),
    Rule("orbit about the Sun", "semi_major_axis_m", *_SUN, "m", "0.04 to 200 au", _FAR),
    Rule("orbit about the Sun", "periapsis_distance_m", SUN_RADIUS_M, _SUN[1], "m", "to 200 au", _FAR),
    Rule("orbit about the Sun", "r_m", *_SUN, "m", "0.04 to 200 au from the Sun", _FAR, _length),
    Rule("encounter", "relative_velocity_m_s", 0.0, 2e5, "m/s", "Giotto passed Halley at 68 km/s", (("mm/s", 1e-3),)),
)
"""Likely values of fields, by the kind of what has them."""
_OF = {kind: tuple(rule for rule in RULES if rule.of == kind) for kind in {rule.of for rule in RULES}}


def improbable(kind: str, thing: Any, path: str) -> list[Advice]:
    """Warnings of the fields of a table, or of an object, whose values are improbable.

    Parameters
    ----------
    kind : str
        The `of` of rules.
    thing : mapping or object
        With the fields as keys or as attributes; those that it has not, or that are None, are passed over.
    path : str
        Of the thing, as the user wrote it: in front of the field.
    """
    found = []
    for rule in _OF[kind]:
        value = thing.get(rule.field) if isinstance(thing, Mapping) else getattr(thing, rule.field, None)
        if value is not None and not rule.is_likely(value):
            field = f"{path}.{rule.field}" if path else rule.field
            found.append(doubt(field, f"is likely {_bounds(rule)} ({rule.source})", value, rule.way_out(value)))
    return found


def doubt(path: str, rule: str, got: object, way_out: str, code: str = "unit") -> Advice:
    """A warning with field, rule, value and way out."""
    return Advice(code, path, f"{path}: {rule}, got {_text(got)}; {way_out}")


def way_out(kind: str, field: str, value: Any) -> str:
    """The way out of a value that is refused, in the words of a rule's."""
    return next(rule for rule in _OF[kind] if rule.field == field).way_out(value)


def kind_of_body(radius_m: float) -> str:
    """The kind of rule for the rotation of a body: "rock" may turn fast."""
    return "rock" if radius_m <= FAST_ROTATOR_RADIUS_M else "body"


def _bounds(rule: Rule) -> str:
    if rule.low == 0.0:
        return f"at most {rule.high:.4g} {rule.unit}"
    if rule.high == math.inf:
        return f"at least {rule.low:.4g} {rule.unit}"
    return f"between {rule.low:.4g} and {rule.high:.4g} {rule.unit}"


def _text(value: object) -> str:
    """Numbers in short."""
    if isinstance(value, str):
        return value
    numbers = np.asarray(value, float)
    return f"{float(numbers):.6g}" if numbers.ndim == 0 else f"[{', '.join(f'{x:.6g}' for x in numbers.tolist())}]"
