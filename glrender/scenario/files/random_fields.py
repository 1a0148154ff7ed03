"""Random states of a scenario file, of its [random]."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from glrender_camera.validate import known_keys, one_of

from ...base.errors import ConfigError, error_path
from ..attitude import Spin
from ..distributions import KINDS, distribution
from ..paths import AtRest
from ..random_states import NUMBERS, SAMPLERS, RandomStates
from ..scenario import Scenario
from .fields import Known, a_table

_TEXTS = {"sampler": SAMPLERS, "attitude": ("uniform", "own"), "in_field": ("part", "whole")}
_OTHERS = ("camera", "body", "sun_direction", "up", "frames", "seed")


def place_of_craft(known: Known, value: object) -> AtRest:
    """Where the setting's spacecraft stands: at the body of [random]."""
    table = a_table(value)
    known_keys("", table, (*NUMBERS, *_TEXTS, *_OTHERS))
    return AtRest(r_m=np.zeros(3), about=one_of("body", table.get("body", known.names[0]), known.names))


def read_random(setting: Scenario, value: object, has_sun: bool) -> RandomStates:
    """The random states of [random]; `has_sun` says whether the file gives the Sun's place."""
    table = a_table(value)
    body, attitude = setting.origin, setting.attitudes.get(setting.origin)
    given: dict[str, Any] = {"attitude": "uniform" if attitude is None else "own",
                             "sun_direction": "own" if has_sun else "uniform"}
    if isinstance(attitude, Spin):
        rate = float(np.linalg.norm(attitude.angular_velocity_rad_s))
        given["time_s"] = distribution([0.0, 2.0 * np.pi / rate if rate > 0.0 else 0.0], *NUMBERS["time_s"][:2])
    if "range_m" not in table:
        raise ConfigError("range_m", "missing", hint="give [nearest, farthest] from the body's origin")
    for name, entry in table.items():
        with error_path(name):
            if name in NUMBERS:
                if isinstance(entry, Mapping):
                    known_keys("", entry, KINDS)
                given[name] = distribution(entry, *NUMBERS[name][:2])
            elif name in _TEXTS:
                given[name] = one_of("", entry, _TEXTS[name])
            elif name != "camera":
                given[name] = entry
    if given["sun_direction"] == "own" and not has_sun:
        raise ConfigError("sun_direction", "needs an orbit about the Sun, [sun] or [spice]", "own")
    if given["sun_direction"] == "own" and "sun_distance_au" in table:
        raise ConfigError("sun_distance_au", "is given by the orbit or [sun]",
                          hint='leave it out, or give sun_direction = "uniform"')
    if given["attitude"] == "own" and attitude is None:
        raise ConfigError("attitude", f"needs the spin or the attitude of {body!r}", "own", "give bodies.spin")
    camera = setting.scene.camera(table.get("camera", setting.scene.cameras[0].name))
    return RandomStates(setting=setting, camera=camera, **{**given, "body": body})


def with_changes(states: RandomStates, **changes: Any) -> RandomStates:
    """Random states with other frames, seed or camera; None changes nothing."""
    return dataclasses.replace(states, **{name: value for name, value in changes.items() if value is not None})
