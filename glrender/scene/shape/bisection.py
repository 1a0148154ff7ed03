"""Facets bisected at their longest sides, where they are asked to be finer: no crack opens, and no place moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .edges import Edges


def bisected(vertices: np.ndarray, facets: np.ndarray, is_coarse: Callable[[np.ndarray, np.ndarray], np.ndarray],
             max_facets: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A mesh bisected until none of its facets is coarse, or until they are too many.

    Parameters
    ----------
    vertices, facets : (V, 3) float64, (F, 3) int
    is_coarse : callable
        Of vertices and facets: which facets (F,) are to be bisected.
    max_facets : int

    Returns
    -------
    vertices, facets : (W, 3) float64, (G, 3) int
    parent : (G,) int
        The facet that each is a part of.

    Source: Rivara (1984), longest-side bisection: angles stay above half the smallest there was.
    """
    parent = np.arange(len(facets))
    while len(facets) <= max_facets and (coarse := is_coarse(vertices, facets)).any():
        vertices, facets, of = _once(vertices, facets, coarse)
        parent = parent[of]
    return vertices, facets, parent


def _once(vertices: np.ndarray, facets: np.ndarray, coarse: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A mesh whose coarse facets (F,) are cut at their longest sides, and others where a neighbour is cut."""
    edges = Edges(facets)
    edge, first = edges.of_sides().reshape(-1, 3), edges.order[edges.begin]
    one, two = np.minimum(edges.start, edges.end)[first], np.maximum(edges.start, edges.end)[first]
    length = np.linalg.norm(vertices[one] - vertices[two], axis=1)
    # Both facets of an edge must agree which is longest: equal lengths go by the edges' numbers.
    rank = np.empty(len(length), np.int64)
    rank[np.argsort(length, kind="stable")] = np.arange(len(length))
    longest = np.argmax(rank[edge], axis=1)
    own = np.take_along_axis(edge, longest[:, None], axis=1)[:, 0]
    is_cut = np.zeros(len(length), bool)
    is_cut[own[coarse]] = True
    while (behind := is_cut[edge].any(axis=1) & ~is_cut[own]).any():
        is_cut[own[behind]] = True
    middle = np.full(len(length), -1)
    middle[is_cut] = len(vertices) + np.arange(int(is_cut.sum()))
    vertices = np.concatenate([vertices, 0.5 * (vertices[one[is_cut]] + vertices[two[is_cut]])])
    whole, cut = np.flatnonzero(~is_cut[own]), np.flatnonzero(is_cut[own])
    turn = (longest[cut, None] + np.arange(3)) % 3
    (a, b, c), (m, q, r) = (np.take_along_axis(each, turn, axis=1).T for each in (facets[cut], middle[edge[cut]]))
    rows = np.concatenate([np.column_stack([facets[whole], whole]), *_halves(c, a, m, r, cut),
                           *_halves(b, c, m, q, cut)])
    return vertices, rows[:, :3], rows[:, 3]


def _halves(a: np.ndarray, b: np.ndarray, m: np.ndarray, middle: np.ndarray, of: np.ndarray) -> list[np.ndarray]:
    """Facets a, b, m and what they are part of, in rows (N, 4): in two where their side a, b has a middle."""
    whole, halved = middle < 0, middle >= 0
    return [np.stack([a, b, m, of], axis=1)[whole], np.stack([a, middle, m, of], axis=1)[halved],
            np.stack([middle, b, m, of], axis=1)[halved]]
