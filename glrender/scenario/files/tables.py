"""Trajectories and attitudes of tables: interpolated between their rows, refused beyond."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from glrender_camera.validate import one_of, unit_vectors
from scipy.interpolate import KroghInterpolator
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from ...base.errors import ConfigError
from ..attitude import Geometry
from ..checks import numbers
from ..epochs import Epoch, needed

# Rows about a time that its polynomial goes through: degree 7, as CCSDS ephemerides recommend, with velocities or not.
_ROWS_WITH_VELOCITY, _ROWS = 4, 8


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryTable:
    """A trajectory of a table: polynomials of degree 7 through the nearest rows.

    Parameters
    ----------
    times_s : (N,) float [s]
        Strictly ascending, N >= 2; from `epoch`.
    r_m : (N, 3) float [m]
        ICRF axes.
    v_m_s : (N, 3) float [m/s], optional
    about : str
    epoch : Epoch, optional
        The scenario's start by default.
    """

    times_s: np.ndarray
    r_m: np.ndarray
    v_m_s: np.ndarray | None = None
    about: str
    epoch: Epoch | None = None

    def __post_init__(self):
        object.__setattr__(self, "times_s", _ascending(self.times_s))
        for name in ("r_m", "v_m_s"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _rows(name, getattr(self, name), len(self.times_s), 3))

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them; ConfigError, with the coverage, outside of the table."""
        t = _covered(self.times_s, self.epoch, start, t_s)
        count = min(_ROWS if self.v_m_s is None else _ROWS_WITH_VELOCITY, len(self.times_s))
        first = np.clip(np.searchsorted(self.times_s, t) - count // 2, 0, len(self.times_s) - count)
        r, v = np.empty((len(t), 3)), np.empty((len(t), 3))
        for begin in np.unique(first):
            here, rows = first == begin, slice(begin, begin + count)
            nodes, values = self.times_s[rows], self.r_m[rows]
            # In units of half the window, about its middle: high powers of seconds lose digits.
            middle, half = 0.5 * (nodes[0] + nodes[-1]), 0.5 * (nodes[-1] - nodes[0])
            x = (nodes - middle) / half
            if self.v_m_s is not None:
                # A node that is given twice takes a value and its rate.
                x, values = np.repeat(x, 2), np.stack([values, self.v_m_s[rows] * half], axis=1).reshape(-1, 3)
            polynomial = KroghInterpolator(x, values)
            r[here], v[here] = (part / scale for part, scale in zip(
                polynomial.derivatives((t[here] - middle) / half, 2), (1.0, half), strict=True))
        return r, v


@dataclass(frozen=True, kw_only=True, eq=False)
class Segments:
    """Trajectories that follow each other; at a time the first that covers it counts."""

    parts: Sequence[TrajectoryTable]

    @property
    def about(self) -> str:
        """What all are about."""
        return self.parts[0].about

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them."""
        r, v, left = np.empty((len(t_s), 3)), np.empty((len(t_s), 3)), np.ones(len(t_s), bool)
        for part in self.parts:
            t = _from_epoch(part.epoch, start, t_s)
            here = left & (t >= part.times_s[0]) & (t <= part.times_s[-1])
            r[here], v[here] = part.at(start, t_s[here])
            left &= ~here
        if left.any():
            spans = ", ".join(_span(part.times_s, part.epoch) for part in self.parts)
            raise ConfigError("time", f"must be in a segment of the table: {spans}", _time_text(start, t_s[left][0]))
        return r, v


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudeTable:
    """Attitudes of a table, of a spacecraft or of a body that tumbles.

    Parameters
    ----------
    times_s : (N,) float [s]
        Strictly ascending, N >= 2; from `epoch`.
    q_from_inertial : (N, 4) float
        Unit quaternions [w, x, y, z], either sign.
    epoch : Epoch, optional
        The scenario's start by default.
    interpolation : "spline" or "linear"
        A cubic spline of rotation vectors, smooth in its rates and good to the fourth power of the step; or turns
        at a constant rate from row to row, as AEM files have it.
    """

    times_s: np.ndarray
    q_from_inertial: np.ndarray
    epoch: Epoch | None = None
    interpolation: str = "spline"

    if TYPE_CHECKING:  # made in __post_init__
        _axes: Any = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "times_s", _ascending(self.times_s))
        q = _rows("q_from_inertial", self.q_from_inertial, len(self.times_s), 4)
        object.__setattr__(self, "q_from_inertial", unit_vectors("q_from_inertial", q, "normalise [w, x, y, z] first"))
        one_of("interpolation", self.interpolation, ("spline", "linear"))
        # SciPy interpolates where the axes are: inertial from frame.
        axes = Rotation.from_quat(self.q_from_inertial, scalar_first=True).inv()
        kind = RotationSpline if self.interpolation == "spline" else Slerp
        object.__setattr__(self, "_axes", kind(self.times_s, axes))

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them; ConfigError, with the coverage, outside of the table."""
        t = _covered(self.times_s, self.epoch, geometry.start, geometry.t_s)
        from_inertial = self._axes(t).inv()
        if self.interpolation == "spline":
            rates = self._axes(t, 1)
        else:
            row = np.clip(np.searchsorted(self.times_s, t, side="right") - 1, 0, len(self.times_s) - 2)
            rates = self._axes.rotvecs[row] / np.diff(self.times_s)[row][:, None]
        return from_inertial.as_quat(scalar_first=True), rates


def _ascending(times_s: np.ndarray) -> np.ndarray:
    times = numbers("times_s", times_s)
    if times.ndim != 1 or len(times) < 2:
        raise ConfigError("times_s", "must be at least two finite numbers", times_s)
    if not (np.diff(times) > 0.0).all():
        row = int(np.argmin(np.diff(times))) + 1
        raise ConfigError(f"times_s[{row}]", "must be later than the one before", float(times[row]))
    return times


def _rows(name: str, value: np.ndarray, count: int, width: int) -> np.ndarray:
    rows = numbers(name, value)
    if rows.shape != (count, width):
        raise ConfigError(name, f"must be numbers of shape ({count}, {width})", rows.shape)
    return rows


def _from_epoch(epoch: Epoch | None, start: Epoch | None, t_s: np.ndarray) -> np.ndarray:
    return np.asarray(t_s, float) if epoch is None else np.asarray(t_s, float) + (needed(start) - epoch)


def _covered(times_s: np.ndarray, epoch: Epoch | None, start: Epoch | None, t_s: np.ndarray) -> np.ndarray:
    """Times from the table's epoch [s]. A nanosecond beyond its ends is round-off."""
    t = _from_epoch(epoch, start, t_s)
    outside = (t < times_s[0] - 1e-9) | (t > times_s[-1] + 1e-9)
    if outside.any():
        raise ConfigError("time", f"must be within the table: {_span(times_s, epoch)}",
                          _time_text(start if epoch else None, np.asarray(t_s)[outside][0]))
    return np.clip(t, times_s[0], times_s[-1])


def _span(times_s: np.ndarray, epoch: Epoch | None) -> str:
    return f"{_time_text(epoch, times_s[0])} to {_time_text(epoch, times_s[-1])}"


def _time_text(epoch: Epoch | None, t_s: float) -> str:
    return f"t_s = {t_s:g}" if epoch is None else f"{epoch.after(float(t_s)).tdb} TDB"
