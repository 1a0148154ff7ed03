"""Surface detail that a shape model does not hold, as a scene asks for it (docs/detail.md).

Nothing here was seen on a body: the scene gives a statistic, and the seed picks one of its cases.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from glrender_camera.validate import integer, known_keys, positive, within

from ...base.errors import ConfigError, error_path

MAX_OCTAVES = 16
"""Most octaves between the longest and the shortest of a kind."""
# Steeper than the angle of repose nothing lies for long.
_STEEPEST = 1.0


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Fractal roughness: sand, hummocks. A wavelength has an amplitude of amplitude_m (wavelength / longest)^exponent.

    Parameters
    ----------
    amplitude_m : float [m]
        Most that the longest wavelength rises or falls.
    longest_m, shortest_m : float [m]
        Wavelengths, in octaves.
    exponent : float [1], 0..2
        Hurst's: 1 is as steep at any scale, more is smoother at small ones.
    """

    amplitude_m: float
    longest_m: float
    shortest_m: float
    exponent: float = 0.8

    def __post_init__(self):
        positive("amplitude_m", self.amplitude_m)
        _checked_sizes("longest_m", self.longest_m, "shortest_m", self.shortest_m)
        within("exponent", self.exponent, 0.0, 2.0)
        if 4.0 * self.amplitude_m > _STEEPEST * self.longest_m:
            raise ConfigError("amplitude_m", f"must be at most a quarter of longest_m, {self.longest_m:g}",
                              self.amplitude_m)


@dataclass(frozen=True, kw_only=True)
class Craters:
    """Bowls with a rim, as many of each octave of sizes as cover an equal share: N(> D) ~ D^-2.

    Parameters
    ----------
    largest_m, smallest_m : float [m]
        Diameters of the rims.
    coverage : float [1], 0..0.25
        Share of the surface within rims, of each octave.
    depth : float [1], 0..0.2
        Depth of the middle below the surface around, over the diameter.
    """

    largest_m: float
    smallest_m: float
    coverage: float
    depth: float = 0.12

    def __post_init__(self):
        _checked_sizes("largest_m", self.largest_m, "smallest_m", self.smallest_m)
        within("coverage", self.coverage, 0.0, 0.25)
        within("depth", self.depth, 0.0, 0.2)


@dataclass(frozen=True, kw_only=True)
class Boulders:
    """Rounded rocks, as many of each octave of sizes as cover an equal share.

    Parameters
    ----------
    largest_m, smallest_m : float [m]
        Diameters.
    coverage : float [1], 0..0.25
        Share of the surface under boulders, of each octave.
    height : float [1], 0..0.3
        Over the diameter.
    """

    largest_m: float
    smallest_m: float
    coverage: float
    height: float = 0.25

    def __post_init__(self):
        _checked_sizes("largest_m", self.largest_m, "smallest_m", self.smallest_m)
        within("coverage", self.coverage, 0.0, 0.25)
        within("height", self.height, 0.0, 0.3)


@dataclass(frozen=True, kw_only=True)
class Detail:
    """Surface detail of a body: the sum of its kinds, each left out unless given.

    Parameters
    ----------
    seed : int, 0..2^31 - 1
        Equal seeds give equal ground.
    noise : Noise, optional
    craters : Craters, optional
    boulders : Boulders, optional
    """

    seed: int = 0
    noise: Noise | None = None
    craters: Craters | None = None
    boulders: Boulders | None = None

    def __post_init__(self):
        object.__setattr__(self, "seed", integer("seed", self.seed, 0, 2**31 - 1))
        for name, kind in _KINDS.items():
            if not isinstance(getattr(self, name), kind | None):
                raise ConfigError(name, f"must be {kind.__name__}", getattr(self, name))
        if not any(getattr(self, name) for name in _KINDS):
            raise ConfigError("", f"must have one of {', '.join(_KINDS)}")

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Detail:
        """From a body's `detail` table in a scene file.

        Raises
        ------
        ConfigError
            With the path of the field.
        """
        known_keys("", table, ("seed", *_KINDS))
        made: dict[str, Any] = {}
        for name, kind in _KINDS.items():
            if name in table:
                with error_path(name):
                    known = [field.name for field in fields(kind)]
                    known_keys("", table[name], known, required=known[:3])
                    made[name] = kind(**table[name])
        return cls(seed=table.get("seed", 0), **made)


_KINDS: dict[str, Any] = {"noise": Noise, "craters": Craters, "boulders": Boulders}


def _checked_sizes(large_name: str, large: float, small_name: str, small: float) -> None:
    positive(large_name, large)
    positive(small_name, small)
    if not large / 2.0**MAX_OCTAVES <= small <= large:
        raise ConfigError(small_name, f"must be between {large_name} / {2**MAX_OCTAVES} and {large_name}, {large:g}",
                          small)
