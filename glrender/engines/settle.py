"""Cells of an image that exact areas are unsure of, settled by rays: as few as bring its expected error within bounds.

Each cell has a squared error to expect. Rays on a grid in the cell tell by their contrast how far they are off
themselves; they stay where they err less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..planner.adaptive_samples import ERROR_PER_CONTRAST, contrast
from ..planner.small_body_grid import SAMPLE_COUNTS

MOST_RAYS = 2**20
"""Rays that settle an image at most, of each round: half a second."""
SETTLING_SAMPLES = 4
"""Rays along a cell's side by which it is mostly settled."""
# Rounds: what the first one finds may ask for more.
_ROUNDS = 3
# Part of the squared error that is allowed for which rays are planned [1]: what they find scatters.
_AIM = 0.8
# Most samples along a cell's side.
_MOST_SAMPLES = 16
# Squared error by rays over that by areas from which rays are surer [1]: half of the areas' errors are below a fifth of
# what is expected, half of the rays' below 0.6.
_SURER = 0.1
# Cells with less than this share of the mean squared error that is allowed are never settled [1].
_NEGLIGIBLE = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Settled:
    """An image of which some cells are drawn by rays.

    Attributes
    ----------
    means : (rows, columns) float64 [W/m2 per pixel]
    squared : float [(W/m2)^2]
        The sum of the cells' squared errors.
    samples : int
        Most rays along a cell's side; 0 for none.
    share : float [1]
        Cells by rays, of all.
    """

    means: np.ndarray
    squared: float
    samples: int
    share: float


def settle(means: np.ndarray, squared: np.ndarray, most_squared: Callable[[np.ndarray], float],
           cast: Callable[[np.ndarray, int], np.ndarray], gain: float, power: float) -> Settled:
    """Draw by rays the cells that hold most of the error to expect.

    Parameters
    ----------
    means : (R, C) float64 [W/m2 per pixel]
    squared : (R, C) float64 [(W/m2)^2]
        Errors to expect of the cells.
    most_squared : callable
        (means (R, C)) gives the sum [(W/m2)^2] that is allowed.
    cast : callable
        (cells (K,) int, n) gives the light (K, n, n) [W/m2 per pixel] of n x n rays in each cell.
    gain : float [1]
        Error of rays over that of an edge of the same contrast.
    power : float [1]
        n x n rays leave n^-power of one ray's squared error.
    """
    means, left = means.copy(), squared.flatten()
    light = means.ravel()
    chosen = np.flatnonzero(left > _NEGLIGIBLE * most_squared(means) / max(np.count_nonzero(left), 1))
    chosen = chosen[np.argsort(-left[chosen], kind="stable")]
    # Squared error of one ray in a cell, and rays along its side.
    one = np.maximum((gain * ERROR_PER_CONTRAST * contrast(means).ravel()[chosen]) ** 2, left[chosen])
    # The squared error from which rays are surer than areas; whether they were; and rays along a side that were cast.
    surer, is_settled, count = _SURER * left[chosen], np.zeros(len(chosen), bool), np.zeros(len(chosen), int)
    for _ in range(_ROUNDS):
        total, most = float(left.sum()), most_squared(means)
        if total <= most:
            break
        plan = _plan(left[chosen], np.where(is_settled, np.inf, surer), one, count, total - _AIM * most, power)
        if plan is None:
            break
        some, n = plan
        cells, samples = chosen[some], cast(chosen[some], n)
        error = np.maximum(_squared_error(samples, gain), squared.ravel()[cells] * float(n) ** -power)
        better = np.flatnonzero(error < np.where(is_settled[some], left[cells], surer[some]))
        light[cells[better]], left[cells[better]] = samples.mean(axis=(1, 2))[better], error[better]
        count[some], one[some], is_settled[some[better]] = n, error * float(n) ** power, True
    return Settled(means=means, squared=float(left.sum()), samples=int(count[is_settled].max(initial=0)),
                   share=float(np.count_nonzero(is_settled) / light.size))


def _plan(left: np.ndarray, surer: np.ndarray, one: np.ndarray, count: np.ndarray, too_much: float, power: float
          ) -> tuple[np.ndarray, int] | None:
    """Cells (K,), by their numbers, and rays along a side by which the error falls by as much as is too much.

    The cheapest ones; those of the most gain where none are enough. None where nothing is gained.
    """
    choices = []
    for n in SAMPLE_COUNTS:
        if n > _MOST_SAMPLES:
            break
        after = one * float(n) ** -power
        able = np.flatnonzero((count < n) & (after < np.minimum(left, surer)))[:MOST_RAYS // n**2]
        if not len(able):
            continue
        gained = np.cumsum((left - after)[able])
        is_enough = bool(gained[-1] >= too_much)
        n_cells = int(np.searchsorted(gained, too_much)) + 1 if is_enough else len(able)
        choices.append((not is_enough, n**2 * n_cells if is_enough else -float(gained[-1]), n, able[:n_cells]))
    if not choices:
        return None
    *_, n, some = min(choices, key=lambda choice: choice[:3])
    return some, n


def _squared_error(samples: np.ndarray, gain: float) -> np.ndarray:
    """Squared errors (K,) of the means of samples (K, n, n) by their contrast: `adaptive_samples.pixel_errors`."""
    n = samples.shape[1]
    high, low = _around(samples, np.maximum), _around(samples, np.minimum)
    # A step between two cells is within neither: of n steps along a side n - 1 are seen.
    return (gain * ERROR_PER_CONTRAST / n) ** 2 * np.square(high - low).mean(axis=(1, 2)) * n / (n - 1.0)


def _around(samples: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """The extreme of 3 x 3 samples around each (K, n, n), of those in its cell."""
    for _ in range(2):
        found = samples.copy()
        extreme(found[:, 1:], samples[:, :-1], out=found[:, 1:])
        extreme(found[:, :-1], samples[:, 1:], out=found[:, :-1])
        samples = found.swapaxes(1, 2)
    return samples
