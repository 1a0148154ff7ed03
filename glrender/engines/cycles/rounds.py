"""Two halves of a frame's samples, drawn round by round until their difference shows that the error is small."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...planner.adaptive_samples import frame_error, pixel_errors

_FIRST_SAMPLES = 8
MAX_SAMPLES = 1 << 14
"""Most samples of a pixel."""
# The squared error of eight samples may be estimated too large by this factor.
_HOPELESS = 4.0
# A round has at most this many times the samples of all before it.
_GROWTH = 4


class Rounds:
    """Two independent halves of a frame's samples; how they differ is the error of their mean.

    Parameters
    ----------
    draw : callable
        Samples a pixel, seed and progress to the mean of a frame (rows, columns) float64.
    seed : int
    report : callable
        Called with the share done.
    """

    def __init__(self, draw, seed: int, report: Callable[[float], None]):
        self._draw, self._seed, self._tell, self._told = draw, 2048 * seed, report, 0.0
        self._halves: list[Any] = [0.0, 0.0]
        self.n_samples, self._n_rounds = 0, 0

    @property
    def mean(self) -> np.ndarray:
        """Mean of all samples."""
        return 0.5 * (self._halves[0] + self._halves[1])

    def fixed(self, n_samples: int) -> float:
        """Draw this many samples a pixel; the error, that of one sample by its contrast to its neighbours."""
        if n_samples == 1:
            self._halves = [self._draw(1, self._seed, self._report)] * 2
            return frame_error(*pixel_errors(self.mean.astype(np.float32), 1))
        return self._round(n_samples // 2, n_samples - n_samples // 2, 0.0, 1.0)

    def until(self, tolerance: float) -> float:
        """Draw until the error is below the tolerance, or known to stay above it by MAX_SAMPLES; the error."""
        n, done = _FIRST_SAMPLES, 0.0
        while True:
            # Share of all the work, at the pace of n^-1/2, were this round the last.
            error = self._round(n // 2, n // 2, done, 0.5 * (1.0 + done))
            # A tolerance out of reach is not paid for: the samples that it needs go with the error's square.
            is_hopeless = self.n_samples * (error / tolerance) ** 2 > _HOPELESS * MAX_SAMPLES
            if error <= tolerance or is_hopeless or self.n_samples >= MAX_SAMPLES:
                self._report(1.0)
                return error
            done = min((tolerance / error) ** 2, 0.95)
            more = self.n_samples * ((error / tolerance) ** 2 - 1.0)
            n = int(min(max(more, 8.0), _GROWTH * self.n_samples, MAX_SAMPLES - self.n_samples)) // 2 * 2
            if n < 2:
                return error

    def _report(self, share: float) -> None:
        """Report a share that never falls, though guesses may."""
        self._told = max(self._told, min(share, 1.0))
        self._tell(self._told)

    def _round(self, first: int, second: int, begin: float, end: float) -> float:
        n_before = 0.5 * self.n_samples
        for half, n in enumerate((first, second)):
            low, high = begin + 0.5 * half * (end - begin), begin + 0.5 * (half + 1) * (end - begin)
            drawn = self._draw(n, self._seed + 2 * self._n_rounds + half,
                               lambda share, low=low, high=high: self._report(low + share * (high - low)))
            before = n_before / (n_before + n)
            self._halves[half] = before * self._halves[half] + (1.0 - before) * drawn
        self.n_samples, self._n_rounds = self.n_samples + first + second, self._n_rounds + 1
        lit = self.mean > 0.0
        if not lit.any():
            return 0.0
        return float(0.5 * np.sqrt(np.mean((self._halves[0] - self._halves[1])[lit] ** 2)) / self.mean[lit].mean())
