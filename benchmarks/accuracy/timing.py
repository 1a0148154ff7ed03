"""Times of renders, taken in turn, so that a noisy machine is noisy for all."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

# Times that a job runs in a row: a loop's frames follow each other, and so do peers' here.
_ROW = 3


def interleaved(jobs: dict[str, Callable[[], object]], *, least: int = 5, most: int = 25,
                budget_s: float = 60.0) -> dict[str, dict[str, float]]:
    """Run every job a few times in a row each round, in another order each time.

    Parameters
    ----------
    jobs : dict of name to function
        Each was run before, so that nothing is compiled here.
    least, most : int
        Rounds; beyond `least` only while `budget_s` lasts.

    Returns
    -------
    dict of name to {"p50_ms", "p95_ms", "n"}
    """
    rng, laps, began = np.random.default_rng(0), {name: [] for name in jobs}, time.perf_counter()
    for count in range(most):
        if count >= least and time.perf_counter() - began > budget_s:
            break
        for name in rng.permutation(list(jobs)):
            for _ in range(_ROW):
                start = time.perf_counter()
                jobs[name]()
                laps[name].append(1e3 * (time.perf_counter() - start))
    return {name: percentiles(values) for name, values in laps.items()}


def percentiles(times_ms: list[float]) -> dict[str, float]:
    """p50, p95 and how many."""
    return {"p50_ms": float(np.median(times_ms)), "p95_ms": float(np.percentile(times_ms, 95)), "n": len(times_ms)}
