"""Cells that exact areas are unsure of, settled by rays: few, in order of their errors, where rays are surer."""

from __future__ import annotations

import numpy as np
import pytest
from glrender.engines.settle import settle

SHAPE = (40, 60)


def edges(cells, n):
    """n x n samples of cells of which a straight edge through the middle lights half."""
    place = (np.arange(n) + 0.5) / n
    return np.broadcast_to((place[:, None] + 0.3 * place > 0.65).astype(float), (len(cells), n, n)).copy()


def unsure(share=0.1, error=0.6):
    """An even image in which a share of the cells has an error."""
    rng = np.random.default_rng(3)
    return np.ones(SHAPE), np.where(rng.random(SHAPE) < share, (error * rng.uniform(0.5, 1.0, SHAPE)) ** 2, 0.0)


@pytest.mark.parametrize("left", [0.9, 0.5, 0.1, 0.02])
def test_the_cells_that_err_most_are_settled_and_no_more_than_it_takes(left):
    means, squared = unsure()
    most = left * squared.sum()
    made = settle(means, squared, lambda _: most, edges, 1.0, 3.0)
    is_settled = made.means != means
    assert made.squared <= most and is_settled.any()
    assert squared[is_settled].min() >= squared[~is_settled].max()
    assert made.share == pytest.approx(is_settled.mean())
    assert made.squared > 0.3 * most, "rays stop at what was asked"


def test_a_tighter_tolerance_settles_the_same_cells_and_more():
    means, squared = unsure()
    settled, last = np.zeros(SHAPE, bool), np.inf
    for left in (0.5, 0.2, 0.05, 0.01):
        made = settle(means, squared, lambda _, left=left: left * squared.sum(), edges, 1.0, 3.0)
        now = made.means != means
        assert np.count_nonzero(settled & ~now) < 0.02 * np.count_nonzero(settled | now) and made.squared <= last
        settled, last = now, made.squared


def test_nothing_is_cast_where_the_tolerance_is_met():
    means, squared = unsure()
    made = settle(means, squared, lambda _: 1.01 * squared.sum(), lambda cells, n: 1 / 0, 1.0, 3.0)
    assert made.share == made.samples == 0 and made.means.tobytes() == means.tobytes()


def test_rays_that_err_more_than_areas_are_not_taken():
    """Noise in every cell: areas are surer, whatever is asked."""
    means, squared = unsure(error=0.01)
    rng = np.random.default_rng(1)
    made = settle(means, squared, lambda _: 1e-3 * squared.sum(),
                  lambda cells, n: rng.uniform(0.0, 2.0, (len(cells), n, n)), 1.0, 2.0)
    assert made.share == 0.0 and made.means.tobytes() == means.tobytes()
    assert made.squared == pytest.approx(squared.sum())


def test_rays_tell_their_own_error():
    """Of an edge in every cell, at any place and angle: its root mean square is within what is told, by less than 3."""
    rng = np.random.default_rng(5)
    angle, place = rng.uniform(0.0, 2.0 * np.pi, 2000), rng.uniform(-0.4, 0.4, 2000)

    def light(cells, n):
        y, x = (np.mgrid[:n, :n] + 0.5) / n - 0.5
        return (np.cos(angle[cells])[:, None, None] * x + np.sin(angle[cells])[:, None, None] * y
                > place[cells][:, None, None]).astype(float)

    # The exact share of each of 2000 rows of a cell that is lit.
    row = ((np.arange(2000) + 0.5) / 2000 - 0.5)[:, None]
    begin = (place - np.sin(angle) * row) / np.cos(angle)
    exact = np.where(np.cos(angle) > 0.0, np.clip(0.5 - begin, 0.0, 1.0), np.clip(0.5 + begin, 0.0, 1.0)).mean(axis=0)
    for left in (0.05, 0.005):
        made = settle(np.full((40, 50), 0.5), np.full((40, 50), 0.04), lambda _, left=left: left * 80.0, light, 1.0,
                      3.0)
        true = np.square(made.means.ravel() - exact)[made.means.ravel() != 0.5].sum()
        assert true <= made.squared <= 9.0 * true
