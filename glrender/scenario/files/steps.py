"""Steps of a table in which smooth interpolation is not to be trusted: holds, manoeuvres, rows of uneven distance."""

from __future__ import annotations

import numpy as np

LARGEST_DEPARTURE = 0.1
"""By how much of a step's own motion smooth interpolation may leave that between its two rows [1]. Of an arc between
two rows the chord is off by an eighth of its angle: circles of eight rows and more are smooth."""
LARGEST_RATIO = 5.0
"""Ratio of the lengths of two successive steps [1] beyond which polynomials through both swing in the longer one."""
# Rows are equal, but for their rounding, of which the distance is less [1] of what both neighbours moved.
_EQUAL = 1e-9
PLACES = np.array([0.25, 0.5, 0.75])
"""Places in a step where both interpolations are compared [1]."""


def even_runs(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last rows (N - 1,), (N - 1,) of the run that each step of rows at times (N,) [s] is of.

    Within a run no step is `LARGEST_RATIO` times as long as the next; two runs share a row.
    """
    step = np.diff(times_s)
    jumps = np.flatnonzero(np.maximum(step[1:], step[:-1]) > LARGEST_RATIO * np.minimum(step[1:], step[:-1])) + 1
    ends = np.concatenate([[0], jumps, [len(step)]])
    run = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    return ends[run], ends[run + 1]


def own_motion(moved: np.ndarray) -> np.ndarray:
    """The motion of steps (N - 1,) of how far the rows at their ends are apart, in the same unit.

    Where a motion turns round, rows are close to each other though nothing holds: two thirds of what both neighbours
    moved counts, if that is more. On a smooth turn the chord is off by a tenth of that, on a hold after a slew a spline
    by a sixth. Between equal rows there is no motion.
    """
    padded = np.concatenate([moved[:1], moved, moved[-1:]])
    beside = padded[:-2] + padded[2:]
    return np.where(moved > _EQUAL * beside, np.maximum(moved, beside * 2.0 / 3.0), moved)


def runs(steps: np.ndarray) -> list[tuple[int, int]]:
    """First and last numbers of runs of steps, of ascending numbers (M,)."""
    breaks = np.flatnonzero(np.diff(steps) > 1) + 1
    return [(int(run[0]), int(run[-1])) for run in np.split(steps, breaks) if run.size]
