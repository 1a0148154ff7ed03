"""Rows of tables: checked, found by time, and named in notes by theirs."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ...base.errors import ConfigError
from ..checks import numbers
from ..epochs import DATE_STEP_S, Epoch, needed
from .steps import runs

# Spans of time in a sentence, at most.
_TOLD = 3


class Table(Protocol):
    """A table of rows at ascending times (N,) [s] from an epoch, or from the scenario's start; it counts in a span."""

    @property
    def times_s(self) -> np.ndarray: ...

    @property
    def epoch(self) -> Epoch | None: ...

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last of the times from the epoch at which it counts."""


def ascending(times_s: np.ndarray) -> np.ndarray:
    """Times (N,) [s] that ascend, N >= 2; ConfigError if not."""
    times = numbers("times_s", times_s)
    if times.ndim != 1 or len(times) < 2:
        raise ConfigError("times_s", "must be at least two finite numbers", times_s)
    if not (np.diff(times) > 0.0).all():
        row = int(np.argmin(np.diff(times))) + 1
        raise ConfigError(f"times_s[{row}]", "must be later than the one before", float(times[row]))
    return times


def rows_of(name: str, value: np.ndarray, count: int, width: int) -> np.ndarray:
    """Numbers of shape (count, width); ConfigError if not."""
    rows = numbers(name, value)
    if rows.shape != (count, width):
        raise ConfigError(name, f"must be numbers of shape ({count}, {width})", rows.shape)
    return rows


def from_epoch(epoch: Epoch | None, start: Epoch | None, t_s: np.ndarray) -> np.ndarray:
    """Times (N,) [s] from a table's epoch, of those from a scenario's start."""
    return np.asarray(t_s, float) if epoch is None else np.asarray(t_s, float) + (needed(start) - epoch)


def checked_span(span_s: tuple[float, float] | None, times_s: np.ndarray) -> tuple[float, float]:
    """The times at which a table counts: within those of its rows."""
    if span_s is None:
        return float(times_s[0]), float(times_s[-1])
    first, last = numbers("span_s", span_s)
    if not max(first, times_s[0]) < min(last, times_s[-1]):
        raise ConfigError("span_s", "must be two ascending times within those of the rows, "
                          f"{times_s[0]:g} to {times_s[-1]:g} s", span_s)
    return float(max(first, times_s[0])), float(min(last, times_s[-1]))


def steps_of(times_s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Numbers of the steps that times are in."""
    return np.clip(np.searchsorted(times_s, t, side="right") - 1, 0, len(times_s) - 2)


def beyond(table: Table, t: np.ndarray) -> np.ndarray:
    """Whether times (N,) [s] from the table's epoch are not in its span, to the microsecond of dates."""
    first, last = table.span_s
    return (t < first - DATE_STEP_S) | (t > last + DATE_STEP_S)


def covered_times(table: Table, start: Epoch | None, t_s: np.ndarray) -> np.ndarray:
    """Times from the table's epoch [s], within its span."""
    t = from_epoch(table.epoch, start, t_s)
    outside = beyond(table, t)
    if outside.any():
        raise ConfigError("time", f"must be within the table: {span_text(table)}",
                          time_text(start if table.epoch else None, np.asarray(t_s)[outside][0]))
    return np.clip(t, *table.span_s)


def span_text(table: Table) -> str:
    """The times at which a table counts, in words."""
    return " to ".join(time_text(table.epoch, t) for t in table.span_s)


def notes_of(table: Table, steps: np.ndarray, sentence: str) -> list[str]:
    """A sentence about the interpolation of steps (M,), if any, with their times."""
    if not steps.size:
        return []
    times = [f"{time_text(table.epoch, table.times_s[first])} to {time_text(table.epoch, table.times_s[last + 1])}"
             for first, last in runs(steps)]
    where = "; ".join(times[:_TOLD]) + (f"; and {len(times) - _TOLD} more" if len(times) > _TOLD else "")
    return [f"the interpolation {sentence.format(where)}"]


def time_text(epoch: Epoch | None, t_s: float) -> str:
    """A time of a table in words."""
    return f"t_s = {t_s:g}" if epoch is None else f"{epoch.after(float(t_s)).tdb} TDB"
