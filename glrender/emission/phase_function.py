"""Scattering phase functions of dust, 1 at zero phase angle; the phase angle is 180 deg at forward scattering."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender_camera.validate import known_keys, one_of, within

from ..base.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Isotropic:
    """The same at every phase angle."""

    def __call__(self, phase_rad: np.ndarray) -> np.ndarray:
        return np.ones_like(np.asarray(phase_rad, np.float64))


@dataclass(frozen=True, kw_only=True)
class HenyeyGreenstein:
    """Two Henyey-Greenstein lobes, each scaled to 1 at a scattering angle of 90 deg, and their sum to 1 at zero phase.

    Parameters
    ----------
    forward, backward : float [1], 0..0.99 and -0.99..0
        Asymmetry of the lobes.
    forward_weight : float [1], 0..1

    Source: Marcus (2007), International Comet Quarterly 29, 39, compound Henyey-Greenstein function; his
    values for dust are the defaults.
    """

    forward: float = 0.9
    backward: float = -0.6
    forward_weight: float = 0.95

    def __post_init__(self):
        for name, low, high in (("forward", 0.0, 0.99), ("backward", -0.99, 0.0), ("forward_weight", 0.0, 1.0)):
            object.__setattr__(self, name, within(name, getattr(self, name), low, high))

    def __call__(self, phase_rad: np.ndarray) -> np.ndarray:
        cos_scattering = -np.cos(np.asarray(phase_rad, np.float64))
        return self._lobes(cos_scattering) / self._lobes(-1.0)

    def _lobes(self, cos_scattering: np.ndarray) -> np.ndarray:
        lobe = lambda g: ((1.0 + g * g) / (1.0 + g * g - 2.0 * g * cos_scattering)) ** 1.5  # noqa: E731
        return self.forward_weight * lobe(self.forward) + (1.0 - self.forward_weight) * lobe(self.backward)


@dataclass(frozen=True, kw_only=True)
class PhaseTable:
    """Linear between given values, scaled to 1 at zero phase.

    Parameters
    ----------
    phase_deg : (N,) float [deg]
        Rising from 0 to 180.
    value : (N,) float [1]
        All > 0.
    """

    phase_deg: Sequence[float]
    value: Sequence[float]

    def __post_init__(self):
        for name in ("phase_deg", "value"):
            try:
                numbers = tuple(float(x) for x in getattr(self, name))
            except (TypeError, ValueError, OverflowError):
                raise ConfigError(name, "must be numbers", getattr(self, name)) from None
            object.__setattr__(self, name, numbers)
        angles, values = np.array(self.phase_deg), np.array(self.value)
        if len(angles) < 2 or not (np.diff(angles) > 0.0).all() or angles[0] != 0.0 or angles[-1] != 180.0:
            raise ConfigError("phase_deg", "must rise from 0 to 180", self.phase_deg)
        if len(values) != len(angles) or not (np.isfinite(values) & (values > 0.0)).all():
            raise ConfigError("value", "must be as many finite numbers > 0 as phase_deg has", self.value)

    def __call__(self, phase_rad: np.ndarray) -> np.ndarray:
        return np.interp(np.degrees(phase_rad), self.phase_deg, self.value) / self.value[0]


PhaseFunction = Isotropic | HenyeyGreenstein | PhaseTable
_KINDS = {"isotropic": Isotropic, "henyey_greenstein": HenyeyGreenstein, "table": PhaseTable}


def phase_function(entry: str | Mapping[str, Any]) -> PhaseFunction:
    """A phase function from a scene's `"marcus"`, `"isotropic"`, or a table with a `kind`."""
    if entry == "marcus":
        return HenyeyGreenstein()
    if isinstance(entry, str):
        entry = {"kind": entry}
    if not isinstance(entry, Mapping) or "kind" not in entry:
        raise ConfigError("kind", f"missing; one of {', '.join(_KINDS)}, or \"marcus\" for all", entry)
    kind = _KINDS[one_of("kind", entry["kind"], _KINDS)]
    arguments = {key: value for key, value in entry.items() if key != "kind"}
    known_keys("", arguments, kind.__dataclass_fields__)
    return kind(**arguments) if kind is not PhaseTable else _table(arguments)


def _table(arguments: Mapping[str, Any]) -> PhaseTable:
    known_keys("", arguments, ("phase_deg", "value"), required=("phase_deg", "value"))
    return PhaseTable(**arguments)
