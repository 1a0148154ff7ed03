"""Motion blur and the rolling shutter, averaged in irradiance."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .errors import ConfigError
from .validate import finite, positive

# Share of the exposure by which a window may miss the samples' span: its own rounding.
_SPAN_TOLERANCE = 1e-9


def time_average(sub_frames: Iterable[np.ndarray], times_s: np.ndarray, *, start_s: float, exposure_s: float,
                 line_time_s: float = 0.0) -> np.ndarray:
    """Mean irradiance over each row's exposure.

    Row k is exposed from start + k line_time for exposure_s. Between the samples the irradiance
    is taken as linear in time, which is exact to second order while nothing moves by more than a
    pixel from sample to sample.

    Parameters
    ----------
    sub_frames : iterable of (H, W) float32 [W/m2]
        Irradiance images at `times_s`, one at a time: a generator that renders them will do.
    times_s : (N,) float [s], rising
        Must span the exposures of all rows; one sample stands for all times.
    start_s : float [s]
        When row 0 starts.
    exposure_s : float [s], > 0
    line_time_s : float [s]
        Delay from row to row; 0 is a global shutter, negative reads upwards.

    Returns
    -------
    (H, W) float32 [W/m2]

    Raises
    ------
    ConfigError
    """
    times_s = np.array(times_s, dtype=np.float64)
    if times_s.ndim != 1 or times_s.size == 0 or not (np.diff(times_s) > 0.0).all():
        raise ConfigError("times_s", "must be a list of rising times", times_s)
    start_s, exposure_s = finite("start_s", start_s), positive("exposure_s", exposure_s)
    line_time_s = finite("line_time_s", line_time_s)
    total: np.ndarray | None = None
    n_frames = 0
    for n_frames, frame in enumerate(sub_frames, start=1):
        if n_frames > times_s.size:
            break
        if total is None:
            total = np.zeros(frame.shape, np.float32)
            weights = row_weights(times_s, start_s + line_time_s * np.arange(frame.shape[0]), exposure_s)
        elif frame.shape != total.shape:
            raise ConfigError("sub_frames", f"must all have shape {total.shape}", frame.shape)
        lit = np.flatnonzero(weights[:, n_frames - 1])
        total[lit] += frame[lit] * weights[lit, n_frames - 1, None].astype(np.float32)
    if total is None or n_frames != times_s.size:
        raise ConfigError("sub_frames", f"must be as many as times_s, {times_s.size}")
    return total


def row_weights(times_s: np.ndarray, starts_s: np.ndarray, exposure_s: float) -> np.ndarray:
    """(rows, N) float64 [1]: what each sample counts in each row; rows sum to 1.

    The mean of the sample's hat function over the row's exposure, which begins at `starts_s` (rows,) [s]. Arguments
    as of `time_average`.
    """
    if times_s.size == 1:
        return np.ones((starts_s.size, 1))
    slack = _SPAN_TOLERANCE * exposure_s
    if starts_s.min() < times_s[0] - slack or starts_s.max() + exposure_s > times_s[-1] + slack:
        raise ConfigError("times_s", f"must span {starts_s.min():.9g} to {starts_s.max() + exposure_s:.9g} s, the "
                          "exposures of all rows", (float(times_s[0]), float(times_s[-1])))
    steps = np.diff(times_s)

    def integral(t: np.ndarray) -> np.ndarray:
        """Integrals of all hat functions from the first sample to t."""
        x = np.clip((t[:, None] - times_s[:-1]) / steps, 0.0, 1.0)
        out = np.zeros((t.size, times_s.size))
        out[:, :-1] += steps * (x - 0.5 * x * x)
        out[:, 1:] += steps * 0.5 * x * x
        return out

    weights = (integral(starts_s + exposure_s) - integral(starts_s)) / exposure_s
    return weights / weights.sum(axis=1, keepdims=True)
