"""Attitudes of rows that have rates, and of segments that follow each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...base.errors import ConfigError
from ..attitude import Attitude, Geometry
from ..epochs import DATE_STEP_S, Epoch, needed

# Rates that miss the next row by more are of another unit or frame.
_MAX_MISS_DEG = 90.0


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudesWithRates:
    """Attitudes between rows that have rates: whole turns between rows count.

    From row to row the frame turns at the mean of both rates, and a correction that is cubic in time makes attitudes
    and rates those of the rows.

    Parameters
    ----------
    times_s : (N,) float64 [s]
        Strictly ascending, N >= 2; from `epoch`.
    q_from_inertial : (N, 4) float64
        Unit quaternions [w, x, y, z].
    rates_rad_s : (N, 3) float64 [rad/s]
        In the frame.
    epoch : Epoch
    lines : (N,) sequence of int
        Lines of the file, for messages.
    is_spin : bool
        Whether the rates are those about the spin axis alone: the correction is then linear.

    Raises
    ------
    ConfigError
        Rates that do not lead from row to row within 90 deg.
    """

    times_s: np.ndarray
    q_from_inertial: np.ndarray
    rates_rad_s: np.ndarray
    epoch: Epoch
    lines: Sequence[int]
    is_spin: bool = False

    if TYPE_CHECKING:  # made in __post_init__
        _axes: Any = field(init=False)
        _misses: Any = field(init=False)

    def __post_init__(self):
        axes = Rotation.from_quat(self.q_from_inertial, scalar_first=True).inv()
        mean = 0.5 * (self.rates_rad_s[:-1] + self.rates_rad_s[1:])
        turned = Rotation.from_rotvec(mean * np.diff(self.times_s)[:, None])
        misses = (turned.inv() * axes[:-1].inv() * axes[1:]).as_rotvec()
        miss_deg = np.degrees(np.linalg.norm(misses, axis=1))
        if (wrong := miss_deg > _MAX_MISS_DEG).any():
            row = int(np.argmax(wrong))
            raise ConfigError(f"line {self.lines[row + 1]}", f"must be where the rates lead within {_MAX_MISS_DEG:g} "
                              "deg from the row before", round(float(miss_deg[row]), 1),
                              "rates are in deg/s; check their frame")
        object.__setattr__(self, "_axes", axes)
        object.__setattr__(self, "_misses", misses)

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them; times are within the rows."""
        t = geometry.t_s + (needed(geometry.start) - self.epoch)
        row = np.clip(np.searchsorted(self.times_s, t, side="right") - 1, 0, len(self.times_s) - 2)
        step_s = np.diff(self.times_s)[row]
        x, step_s = ((t - self.times_s[row]) / step_s)[:, None], step_s[:, None]
        begin, end, miss = self.rates_rad_s[row], self.rates_rad_s[row + 1], self._misses[row]
        mean = 0.5 * (begin + end)
        if self.is_spin:
            correction, slope = miss * x, miss
        else:
            left = (begin - mean) * step_s
            right = _slope(miss, (end - Rotation.from_rotvec(miss).inv().apply(mean)) * step_s)
            correction = left * x * (1.0 - x)**2 + miss * x * x * (3.0 - 2.0 * x) - right * x * x * (1.0 - x)
            slope = (left * (1.0 - x) * (1.0 - 3.0 * x) + 6.0 * miss * x * (1.0 - x)
                     - right * x * (2.0 - 3.0 * x))
        back = Rotation.from_rotvec(correction).inv()
        axes = self._axes[row] * Rotation.from_rotvec(mean * step_s * x) * back.inv()
        return axes.inv().as_quat(scalar_first=True), back.apply(mean) + _rate(correction, slope) / step_s


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudeSegments:
    """Attitudes that follow each other; at a time the first counts whose useable span has it.

    Parameters
    ----------
    parts : sequence of Attitude
    useable : sequence of (Epoch, Epoch)
        First and last epoch of each part.
    """

    parts: Sequence[Attitude]
    useable: Sequence[tuple[Epoch, Epoch]]

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them; ConfigError, with the spans, outside of all."""
        start, t_s = needed(geometry.start), geometry.t_s
        q, rates, left = np.empty((len(t_s), 4)), np.empty((len(t_s), 3)), np.ones(len(t_s), bool)
        for part, (first, last) in zip(self.parts, self.useable, strict=True):
            here = left & (t_s >= first - start - DATE_STEP_S) & (t_s <= last - start + DATE_STEP_S)
            within = Geometry(start=start, t_s=t_s[here], r_m={}, v_m_s={})
            q[here], rates[here] = part.at(within, owner)
            left &= ~here
        if left.any():
            spans = ", ".join(f"{first.tdb} to {last.tdb} TDB" for first, last in self.useable)
            raise ConfigError("time", f"must be within the table: {spans}",
                              f"{start.after(float(t_s[left][0])).tdb} TDB")
        return q, rates


def _rate(rotvec: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Rates (N, 3) in the turned frame of rotation vectors (N, 3) and their slopes: the right Jacobian of SO(3)."""
    angle2 = np.sum(rotvec**2, axis=1, keepdims=True)
    angle, small = np.sqrt(angle2), angle2 < 1e-8
    safe = np.where(small, 1.0, angle)
    half = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    sixth = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    once = np.cross(rotvec, slope)
    return slope - half * once + sixth * np.cross(rotvec, once)


def _slope(rotvec: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """The inverse of `_rate`: slopes (N, 3) of rotation vectors, of angles below 2 pi, that have a rate.

    Source: Sola, Deray and Atchuthan (2018), arXiv:1812.01537, equation 144.
    """
    angle2 = np.sum(rotvec**2, axis=1, keepdims=True)
    angle, small = np.sqrt(angle2), angle2 < 1e-8
    safe = np.where(small, 1.0, angle)
    twelfth = np.where(small, 1.0 / 12.0, 1.0 / safe**2 - (1.0 + np.cos(safe)) / (2.0 * safe * np.sin(safe)))
    once = np.cross(rotvec, rate)
    return rate + 0.5 * once + twelfth * np.cross(rotvec, once)
