"""Trajectories and attitudes of tables: interpolated between their rows, refused beyond."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from glrender_camera.validate import one_of, unit_vectors
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from ...base.errors import ConfigError
from ..attitude import Geometry
from ..epochs import Epoch
from .polynomials import through_rows
from .rows import (
    ascending,
    beyond,
    checked_span,
    covered_times,
    from_epoch,
    notes_of,
    rows_of,
    span_text,
    steps_of,
    time_text,
)
from .steps import LARGEST_DEPARTURE, PLACES, even_runs, own_motion

# Rows about a time that its polynomial goes through: degree 7, as CCSDS ephemerides recommend, with velocities or not.
_ROWS_WITH_VELOCITY, _ROWS = 4, 8
# Interpolations differ by their rounding [1], of places, and [rad].
_ROUNDING, _ROUNDING_RAD = 1e-12, 1e-8
_ALL: Any = None
_HOLDS = "Is it a hold or a manoeuvre? Rows at its begin and end make it exact"


@dataclass(frozen=True, kw_only=True, eq=False)
class TrajectoryTable:
    """A trajectory of a table: polynomials of degree 7 through the nearest rows.

    A polynomial is not used in steps where it leaves the rows: where it differs from the cubic Hermite polynomial of
    the two rows next to a time by more than a tenth of the step's own motion, where the mean velocity of the two rows
    differs from their places by as much, or where it goes through a row of such a step. The Hermite polynomial is used
    there; of rows without velocities it is one that does not overshoot (PCHIP). Where one step is five times as long
    as the next, polynomials keep to the rows on their side.

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
    span_s : (first, last) float [s], optional
        Times from `epoch` at which the table counts: rows beyond are there for the interpolation alone. All times of
        its rows by default.

    Source: Fritsch and Butland (1984), the slopes of PCHIP.
    """

    times_s: np.ndarray
    r_m: np.ndarray
    v_m_s: np.ndarray | None = None
    about: str
    epoch: Epoch | None = None
    span_s: tuple[float, float] = _ALL

    def __post_init__(self):
        object.__setattr__(self, "times_s", ascending(self.times_s))
        object.__setattr__(self, "span_s", checked_span(self.span_s, self.times_s))
        for name in ("r_m", "v_m_s"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, rows_of(name, getattr(self, name), len(self.times_s), 3))

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them; ConfigError, with the coverage, outside of the table."""
        t = covered_times(self, start, t_s)
        steps = steps_of(self.times_s, t)
        by_two = self._by_two(steps)
        r, v = np.empty((len(t), 3)), np.empty((len(t), 3))
        for derivative, out in enumerate((r, v)):
            out[by_two] = self._of_two_rows(t[by_two], derivative)
        r[~by_two], v[~by_two] = self._smooth(t[~by_two], steps[~by_two])
        return r, v

    def notes_at(self, start: Epoch | None, t_s: np.ndarray) -> list[str]:
        """Sentences about times (N,) [s] from a start at which two rows count, or those of one side alone."""
        steps = np.unique(steps_of(self.times_s, covered_times(self, start, t_s)))
        by_two = self._by_two(steps)
        rule = ("cubic Hermite polynomials of the two rows next to a time" if self.v_m_s is not None else
                "polynomials that do not overshoot (PCHIP), as the rows have no velocities,")
        count = min(self._most_rows, len(self.times_s))
        is_cut = (self._window(steps)[0] != np.clip(steps + 1 - count // 2, 0, len(self.times_s) - count)) & ~by_two
        return [
            *notes_of(self, steps[by_two], f"by polynomials leaves the rows in {{}}: {rule} are taken there. {_HOLDS}"),
            *notes_of(self, steps[is_cut], "by polynomials goes through rows on one side alone in {}: one step is five "
                      "times as long as the next; rows of even distance are interpolated best")]

    @property
    def _most_rows(self) -> int:
        return _ROWS if self.v_m_s is None else _ROWS_WITH_VELOCITY

    @cached_property
    def _runs(self) -> tuple[np.ndarray, np.ndarray]:
        return even_runs(self.times_s)

    def _window(self, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First rows (M,) of the polynomials of steps, and how many rows (M,) they go through."""
        first, last = (rows[step] for rows in self._runs)
        count = np.minimum(self._most_rows, last - first + 1)
        return np.clip(step + 1 - count // 2, first, last + 1 - count), count

    def _smooth(self, t: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (M, 3) of the polynomials of steps (M,) at times (M,) [s] from the table's epoch."""
        r, v = np.empty((len(t), 3)), np.empty((len(t), 3))
        # A step's first row and number of rows as one number: each polynomial is made once.
        windows, of = np.unique(np.ravel_multi_index(self._window(steps), (len(self.times_s), _ROWS + 1)),
                                return_inverse=True)
        first, counts = np.divmod(windows, _ROWS + 1)
        for count in np.unique(counts):
            here, those = counts[of] == count, np.flatnonzero(counts == count)
            rows = first[those, None] + np.arange(count)
            nodes = self.times_s[rows]
            # In units of half the window, about its middle: high powers of seconds lose digits.
            middle, half = 0.5 * (nodes[:, 0] + nodes[:, -1]), 0.5 * (nodes[:, -1] - nodes[:, 0])
            own = np.searchsorted(those, of[here])
            slopes = None if self.v_m_s is None else self.v_m_s[rows] * half[:, None, None]
            r[here], slope = through_rows((nodes - middle[:, None]) / half[:, None], self.r_m[rows], slopes, own,
                                          (t[here] - middle[own]) / half[own])
            v[here] = slope / half[own, None]
        return r, v

    @cached_property
    def _of_two_rows(self) -> Any:
        if self.v_m_s is None:
            return PchipInterpolator(self.times_s, self.r_m)
        return CubicHermiteSpline(self.times_s, self.r_m, self.v_m_s)

    def _by_two(self, step: np.ndarray) -> np.ndarray:
        """Whether the polynomial of a step (M,) goes through a row next to a step that leaves its rows.

        Or through too few rows: without velocities those of two or three are worse than the neighbours' slopes.
        """
        first, count = self._window(step)
        near = first[:, None] + np.arange(-1, self._most_rows)
        inside = np.clip(np.minimum(near, (first + count - 1)[:, None]), 0, len(self.times_s) - 2)
        asked = np.unique(inside)
        asked = asked[self._leaves[asked] < 0]
        self._leaves[asked] = self._leaves_rows(asked)
        few = (count < 4) & (len(self.times_s) >= 4) & (self.v_m_s is None)
        return (self._leaves[inside] > 0).any(axis=1) | few

    @cached_property
    def _leaves(self) -> np.ndarray:
        """Whether a step leaves its rows; -1 until its polynomial was looked at: large tables are asked about a few."""
        if self.v_m_s is None:
            return np.full(len(self.times_s) - 1, -1)
        mean = 0.5 * (self.v_m_s[1:] + self.v_m_s[:-1]) * np.diff(self.times_s)[:, None]
        off = np.linalg.norm(np.diff(self.r_m, axis=0) - mean, axis=1)
        return np.where(off > self._allowed_m, 1, -1)

    @cached_property
    def _allowed_m(self) -> np.ndarray:
        """By how much interpolations of a step may differ."""
        largest = np.maximum(*(np.abs(rows).max(axis=1) for rows in (self.r_m[1:], self.r_m[:-1])))
        return LARGEST_DEPARTURE * self._motion_m + _ROUNDING * largest

    @cached_property
    def _motion_m(self) -> np.ndarray:
        moved = np.linalg.norm(np.diff(self.r_m, axis=0), axis=1)
        if self.v_m_s is None:
            return own_motion(moved)
        speed = np.linalg.norm(self.v_m_s, axis=1)
        return np.maximum(moved, 0.5 * (speed[1:] + speed[:-1]) * np.diff(self.times_s))

    def _leaves_rows(self, steps: np.ndarray) -> np.ndarray:
        """Whether the polynomials of steps (M,) leave the lines between their rows."""
        t = (self.times_s[steps, None] + np.diff(self.times_s)[steps, None] * PLACES).ravel()
        off = np.linalg.norm(self._smooth(t, np.repeat(steps, len(PLACES)))[0] - self._of_two_rows(t), axis=1)
        return off.reshape(-1, len(PLACES)).max(axis=1) > self._allowed_m[steps]


@dataclass(frozen=True, kw_only=True, eq=False)
class Segments:
    """Trajectories that follow each other; at a time the first that covers it counts."""

    parts: Sequence[TrajectoryTable]

    @property
    def about(self) -> str:
        """Name of the object that all positions are relative to."""
        return self.parts[0].about

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them."""
        r, v, left = np.empty((len(t_s), 3)), np.empty((len(t_s), 3)), np.ones(len(t_s), bool)
        for part in self.parts:
            t = from_epoch(part.epoch, start, t_s)
            here = left & ~beyond(part, t)
            r[here], v[here] = part.at(start, t_s[here])
            left &= ~here
        if left.any():
            covered = ", ".join(span_text(part) for part in self.parts)
            raise ConfigError("time", f"must be in a segment of the table: {covered}", time_text(start, t_s[left][0]))
        return r, v

    def notes_at(self, start: Epoch | None, t_s: np.ndarray) -> list[str]:
        """Sentences of the segments, as `TrajectoryTable` has them."""
        notes, left = [], np.ones(len(t_s), bool)
        for part in self.parts:
            t = from_epoch(part.epoch, start, t_s)
            here = left & ~beyond(part, t)
            notes += part.notes_at(start, t_s[here])
            left &= ~here
        return notes


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
        at a constant rate from row to row (slerp), as AEM files have it. Also in place of a spline there is slerp in
        steps where they differ by more than a tenth of the step's own turn: between equal rows the attitude is theirs.
    """

    times_s: np.ndarray
    q_from_inertial: np.ndarray
    epoch: Epoch | None = None
    interpolation: str = "spline"

    if TYPE_CHECKING:  # made in __post_init__
        _spline: RotationSpline | None = field(init=False)
        _slerp: Slerp = field(init=False)
        _by_two: np.ndarray = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "times_s", ascending(self.times_s))
        q = rows_of("q_from_inertial", self.q_from_inertial, len(self.times_s), 4)
        object.__setattr__(self, "q_from_inertial", unit_vectors("q_from_inertial", q, "normalise [w, x, y, z] first"))
        one_of("interpolation", self.interpolation, ("spline", "linear"))
        # SciPy interpolates where the axes are: inertial from frame.
        axes = Rotation.from_quat(self.q_from_inertial, scalar_first=True).inv()
        object.__setattr__(self, "_slerp", Slerp(self.times_s, axes))
        spline = RotationSpline(self.times_s, axes) if self.interpolation == "spline" else None
        object.__setattr__(self, "_spline", spline)
        object.__setattr__(self, "_by_two", np.ones(len(self.times_s) - 1, bool) if spline is None
                           else self._leaves_rows(spline))

    @property
    def span_s(self) -> tuple[float, float]:
        """Times [s] from the epoch at which the table counts: those of its rows."""
        return float(self.times_s[0]), float(self.times_s[-1])

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes and rates, as `Attitude` has them; ConfigError, with the coverage, outside of the table."""
        t = covered_times(self, geometry.start, geometry.t_s)
        step = steps_of(self.times_s, t)
        q = self._slerp(t).inv().as_quat(scalar_first=True)
        rates = self._slerp.rotvecs[step] / np.diff(self.times_s)[step][:, None]
        smooth = ~self._by_two[step]
        if self._spline is not None and smooth.any():
            q[smooth] = self._spline(t[smooth]).inv().as_quat(scalar_first=True)
            rates[smooth] = self._spline(t[smooth], 1)
        return q, rates

    def notes_at(self, start: Epoch | None, t_s: np.ndarray) -> list[str]:
        """Sentences about times (N,) [s] from a start at which slerp counts in place of a spline."""
        if self._spline is None:
            return []
        steps = np.unique(steps_of(self.times_s, covered_times(self, start, t_s)))
        return notes_of(self, steps[self._by_two[steps]], "by a spline leaves the rows in {}: turns at a constant rate "
                        f"from row to row (slerp) are taken there. {_HOLDS}")

    def _leaves_rows(self, spline: RotationSpline) -> np.ndarray:
        """Whether the spline leaves the rows of a step (N - 1,)."""
        t = (self.times_s[:-1, None] + np.diff(self.times_s)[:, None] * PLACES).ravel()
        off = (spline(t) * self._slerp(t).inv()).magnitude().reshape(-1, len(PLACES)).max(axis=1)
        turned = np.linalg.norm(self._slerp.rotvecs, axis=1)
        return off > LARGEST_DEPARTURE * own_motion(turned) + _ROUNDING_RAD
