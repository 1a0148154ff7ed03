"""Polynomials through rows of tables, many at a time."""

from __future__ import annotations

import numpy as np


def through_rows(x: np.ndarray, y: np.ndarray, slopes: np.ndarray | None, of: np.ndarray,
                 at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of polynomials through the values, and the slopes, of rows.

    Newton's form. SciPy's `KroghInterpolator` makes one at a time: of thousands that takes a hundred times as long.

    Parameters
    ----------
    x : (W, K) float64
        Where the rows of W polynomials are, different within each; within about +-1, as high powers lose digits.
    y : (W, K, D) float64
    slopes : (W, K, D) float64 or None
        None: the polynomials go through the values alone.
    of : (M,) int
        Which polynomial is asked for.
    at : (M,) float64
        Where.

    Returns
    -------
    values, slopes : (M, D) float64, (M, D) float64

    Source: Stoer and Bulirsch (2002), Introduction to Numerical Analysis, section 2.1.5: divided differences, of a row
    that is given twice the slope.
    """
    twice = 1 if slopes is None else 2
    x, difference = np.repeat(x, twice, axis=1), np.repeat(y, twice, axis=1)
    coefficients = [difference[:, 0]]
    for order in range(1, x.shape[1]):
        apart = (x[:, order:] - x[:, :-order])[..., None]
        rise = np.diff(difference, axis=1)
        if order == 1 and slopes is not None:
            rise[:, ::2], apart[:, ::2] = slopes, 1.0
        difference = rise / apart
        coefficients.append(difference[:, 0])
    # Horner's rule, and its derivative.
    value, slope = coefficients[-1][of], np.zeros((len(of), y.shape[2]))
    for k in range(x.shape[1] - 2, -1, -1):
        off = (at - x[of, k])[:, None]
        slope = slope * off + value
        value = value * off + coefficients[k][of]
    return value, slope
