"""Trajectories and attitudes out of SPICE's kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import text

from ...base.attitude import from_spice
from ..attitude import Geometry
from ..epochs import Epoch, needed
from .kernels import SPACECRAFT, SUN, Spice


@dataclass(frozen=True, kw_only=True, eq=False)
class SpiceTrajectory:
    """Positions out of kernels.

    Parameters
    ----------
    spice : Spice
    target, about : str
        Names of the scenario. Where one is "spacecraft" the other is seen from it, with the aberration; the Sun is
        seen from the body, when its light left it; between others the geometry is instantaneous.
    """

    spice: Spice
    target: str
    about: str

    def at(self, start: Epoch, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them; ConfigError, with the coverage, where there is none."""
        et = needed(start).et_s + np.asarray(t_s, float)
        states = np.array([self._state(float(moment)) for moment in et]).reshape(-1, 6)
        return states[:, :3], states[:, 3:]

    def _state(self, et_s: float) -> np.ndarray:
        spice = self.spice
        if self.target == SPACECRAFT and self.about != SUN:
            return -spice.seen(self.about, SPACECRAFT, et_s)[0]
        if self.about == SPACECRAFT:
            return spice.seen(self.target, SPACECRAFT, et_s)[0]
        if self.target == SUN:
            return spice.seen(SUN, self.about, et_s - spice.light_time_s(self.about, et_s))[0]
        return spice.seen(self.target, self.about, et_s, "NONE")[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class SpiceAttitude:
    """Attitudes of a frame of SPICE.

    Parameters
    ----------
    spice : Spice
    frame : str
        Name of the frame; of a body it is taken when its light left it.
    """

    spice: Spice
    frame: str

    def __post_init__(self):
        text("frame", self.frame)

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray | None]:
        """Attitudes and rates, as `Attitude` has them; no rates where a CK has none."""
        turned = []
        for moment in needed(geometry.start).et_s + geometry.t_s:
            ago = 0.0 if owner == SPACECRAFT else self.spice.light_time_s(owner, float(moment))
            turned.append(self.spice.turned(self.frame, float(moment) - ago))
        rates = None if any(rate is None for _, rate in turned) else np.array([rate for _, rate in turned])
        return from_spice(np.array([rotation for rotation, _ in turned])), rates
