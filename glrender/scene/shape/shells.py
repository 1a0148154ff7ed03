"""The shells of a mesh: seams welded, winding made one, closed shells turned outward.

Open shells and panels that are given with both their sides stay as the file has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial import cKDTree

from .edges import Edges, connected
from .facet_geometry import area_vectors, renumbered

# Gaps of seams: steps of float32 at the largest coordinate, and a share of an open edge's length.
_SEAM_STEPS, _SEAM_OF_EDGE = 4.0, 1e-3
# Farthest move of a vertex over its shortest open edge [1]: no facet collapses.
_MOST_OF_EDGE = 0.25
# Distance over the extent [1] below which vertices are one anywhere: a text file's last digit.
WELD_RTOL = 1e-9
# Vertices around one at which a seam is looked for: corners where tiles meet.
_AROUND = 8
# The sum of a shell's area vectors over its area, below which it is closed but for holes: a hemisphere has a half.
_HOLED = 0.25
# Volume over a shell's extent times its area, and distance over the extent [1], that count as none.
_VOLUME_RTOL, _TOUCH_RTOL = 1e-12, 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Shells:
    """Facets with outward winding, and the faults found.

    Attributes
    ----------
    facets : (F, 3) int
    is_flipped : (F,) bool
        Which facets were turned over.
    is_solid : (F,) bool
        Which belong to a shell that has an inside: closed, or closed but for holes.
    is_open : (F,) bool
        Which belong to a shell that is not closed, and are there with one side.
    n_shells, n_two_sided : int
        Shells, and facets that are there with both their sides.
    n_open_edges, n_holed_edges, n_non_manifold_edges : int
        Edges of one facet, such edges in shells that are closed else, and edges of more than two facets.
    has_rooms : bool
        Whether a closed shell came facing inward.
    """

    facets: np.ndarray
    is_flipped: np.ndarray
    is_solid: np.ndarray
    is_open: np.ndarray
    n_shells: int
    n_two_sided: int
    n_open_edges: int
    n_holed_edges: int
    n_non_manifold_edges: int
    has_rooms: bool = False


def seams(vertices: np.ndarray, edges: Edges) -> tuple[np.ndarray, float, float]:
    """Vertex (V,) that each is welded to, most to themselves, with the tolerance and the widest gap [m].

    Only vertices on open edges are welded: closed parts keep their thinnest features.
    """
    own = np.arange(len(vertices))
    sides, _ = edges.sides(edges.size == 1)
    if not len(sides):
        return own, 0.0, 0.0
    start, end = edges.start[sides], edges.end[sides]
    length = np.linalg.norm(vertices[start] - vertices[end], axis=1)
    rim, place = np.unique(np.concatenate([start, end]), return_inverse=True)
    shortest = np.full(len(rim), np.inf)
    np.minimum.at(shortest, place.ravel(), np.tile(length, 2))
    step = float(np.finfo(np.float32).eps) * float(np.abs(vertices[rim]).max())
    tolerance = max(_SEAM_STEPS * step, _SEAM_OF_EDGE * float(np.median(length)))
    least = WELD_RTOL * float(np.ptp(vertices, axis=0).max())
    most = np.minimum(np.maximum(_MOST_OF_EDGE * shortest, least), tolerance)
    distance, other = cKDTree(vertices[rim]).query(vertices[rim], k=min(_AROUND, len(rim)),
                                                   distance_upper_bound=tolerance)
    one = np.repeat(np.arange(len(rim)), other.shape[1])
    distance, other = distance.ravel(), other.ravel()
    near = np.flatnonzero(np.isfinite(distance) & (other != one))
    near = near[distance[near] <= np.minimum(most[one[near]], most[other[near]])]
    if not len(near):
        return own, tolerance, 0.0
    _, group = connected(one[near], other[near], len(rim))
    first = np.full(group.max() + 1, len(vertices))
    np.minimum.at(first, group, rim)
    own[rim] = first[group]
    return own, tolerance, float(distance[near].max())


def of_one_diagonal(vertices: np.ndarray, facets: np.ndarray, edges: Edges
                    ) -> tuple[np.ndarray, np.ndarray] | None:
    """Facets (F, 3) of which both sides of a flat quadrilateral have one diagonal: each is the other's other side then.

    With the facets' corners (F, 3) from 0 to 3 F - 1 that each corner was; None where there is nothing to change.
    """
    a, b = edges.pairs()
    beyond = [facets.ravel()[side - side % 3 + (side + 2) % 3] for side in (a, b)]
    quad = np.sort(np.stack([edges.start[a], edges.end[a], *beyond], axis=1), axis=1)
    mixed = _hashed(quad)
    twice = _repeated(mixed)
    if not len(twice):
        return None
    chosen = np.flatnonzero(np.isin(mixed, twice) & (edges.start[a] == edges.end[b]))
    # In one plane, and on one side.
    p, q, r, s = (vertices[each[chosen]] for each in (edges.start[a], edges.end[a], *beyond))
    normal, other = np.cross(q - p, r - p), np.cross(p - q, s - q)
    longest = np.maximum(np.linalg.norm(r - s, axis=1), np.linalg.norm(q - p, axis=1))
    area = np.linalg.norm(normal, axis=1)
    is_flat = ((np.einsum("ij,ij->i", normal, other) > 0.0)
               & (np.abs(np.einsum("ij,ij->i", normal, s - p)) <= _TOUCH_RTOL * longest * area))
    chosen, normal = chosen[is_flat], normal[is_flat]
    one, two = in_pairs(quad[chosen])
    turned = np.einsum("ij,ij->i", normal[one], normal[two]) < 0.0
    one, two = chosen[one[turned]], chosen[two[turned]]
    if not len(one):
        return None
    here, there = (np.stack([a[each] // 3, b[each] // 3], axis=1) for each in (one, two))
    made = facets.copy()
    made[there] = facets[here][..., ::-1]
    was = np.arange(facets.size).reshape(-1, 3)
    corners = was[there].reshape(len(there), 1, 6)
    is_it = facets.ravel()[corners] == made[there].reshape(len(there), 6, 1)
    was[there] = np.take_along_axis(corners[:, 0], np.argmax(is_it, axis=2), axis=1).reshape(-1, 2, 3)
    return made, was


def wound(vertices: np.ndarray, facets: np.ndarray, edges: Edges, inside: bool = False) -> Shells:
    """The shells of a mesh, each turned as it should be.

    Facets that share an edge with one other are of one shell. Within a shell, winding is made that of most of its
    facets. A closed shell is turned outward by its signed volume, but where a camera may be inside: there it stays.
    """
    is_flipped, is_solid, is_open = np.zeros((3, len(facets)), bool)
    is_twin = _are_twins(facets)
    single = np.flatnonzero(~is_twin)
    n_twin_shells = _n_pieces(facets[is_twin])
    if not len(single):
        return Shells(facets=facets, is_flipped=is_flipped, is_solid=is_solid, is_open=is_open, n_shells=n_twin_shells,
                      n_two_sided=len(facets) // 2, n_open_edges=0, n_holed_edges=0, n_non_manifold_edges=0)
    rest = facets[single]
    if is_twin.any():
        edges = Edges(rest)
    shell, flipped, is_one_sided = _made_one(rest, edges)
    n_shells = int(shell.max()) + 1
    rest = turned(rest, flipped)
    is_closed = _are_closed(edges, shell, n_shells) & is_one_sided
    # About a corner of each shell, or its volume would be lost in its distance from the origin.
    first = np.unique(shell, return_index=True)[1]
    corner = vertices.take(rest[:, 0], axis=0) - vertices.take(rest[first, 0], axis=0).take(shell, axis=0)
    size = np.zeros(n_shells)
    np.maximum.at(size, shell, np.linalg.norm(corner, axis=1))
    normal = area_vectors(vertices, rest)
    area = np.bincount(shell, np.linalg.norm(normal, axis=1), n_shells)
    openness = np.linalg.norm([np.bincount(shell, axis, n_shells) for axis in normal.T], axis=0)
    is_holed = is_one_sided & ~is_closed & (openness < _HOLED * area)
    volume = np.bincount(shell, np.einsum("ij,ij->i", corner, normal), n_shells)
    has_volume = np.abs(volume) > _VOLUME_RTOL * area * size
    is_inward = is_closed & has_volume & (volume < 0.0)
    has_rooms, is_inward = bool(is_inward.any()), is_inward & (not inside)
    rest = turned(rest, is_inward[shell])
    facets = facets.copy()
    facets[single], is_flipped[single] = rest, flipped ^ is_inward[shell]
    is_solid[single], is_open[single] = ((is_closed | is_holed) & has_volume)[shell], ~is_closed[shell]
    open_sides, _ = edges.sides(edges.size == 1)
    return Shells(
        facets=facets, is_flipped=is_flipped, is_solid=is_solid, is_open=is_open, n_shells=n_shells + n_twin_shells,
        n_two_sided=int(is_twin.sum()) // 2, has_rooms=has_rooms,
        n_open_edges=len(open_sides), n_holed_edges=int(is_holed[shell[open_sides // 3]].sum()),
        n_non_manifold_edges=int((edges.size > 2).sum()))


def turned(rows: np.ndarray, is_turned: np.ndarray) -> np.ndarray:
    """Rows (F, 3), of which some (F,) are the other way around."""
    return np.where(is_turned[:, None], rows[:, [0, 2, 1]], rows) if is_turned.any() else rows


def are_all_different(rows: np.ndarray) -> bool:
    """Whether no two rows (N, K) are the same, found sooner than the rows: by a hash that may say no for yes."""
    return not len(_repeated(_hashed(rows)))


def in_pairs(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (M,), (M,) of rows (N, K), of which each is there just twice: the first and the second."""
    _, same, count = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(same.ravel(), kind="stable")
    first = (np.cumsum(count) - count)[count == 2]
    return order[first], order[first + 1]


def _repeated(numbers: np.ndarray) -> np.ndarray:
    """Numbers that occur more than once among some numbers (N,)."""
    numbers = np.sort(numbers)
    return numbers[1:][numbers[1:] == numbers[:-1]]


def _hashed(rows: np.ndarray) -> np.ndarray:
    """A number (N,) for each row (N, K): the same for equal ones."""
    mixed = np.zeros(len(rows), np.uint64)
    for column in rows.T:
        mixed = (mixed ^ column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(32)
    return mixed


def _are_twins(facets: np.ndarray) -> np.ndarray:
    """Facets (F,) whose other side is there too; none is there twice with the same side."""
    if are_all_different(np.sort(facets, axis=1)):
        return np.zeros(len(facets), bool)
    is_twin = np.zeros(len(facets), bool)
    is_twin[np.concatenate(in_pairs(np.sort(facets, axis=1)))] = True
    return is_twin


def pieces(facets: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Pieces that facets (F, 3) make by shared vertices: how many, and the number (count,) of each vertex's."""
    return connected(facets[:, :2].ravel(), facets[:, 1:].ravel(), count)


def _n_pieces(facets: np.ndarray) -> int:
    used, facets = renumbered(facets, facets.max(initial=0) + 1)
    return pieces(facets, len(used))[0]


def closed_volumes(facets: np.ndarray, *vertices: np.ndarray) -> list[np.ndarray]:
    """Volumes (S,) [m3] of pieces between vertices (V, 3) [m], above 0 where they face outward; 0 of open ones."""
    edges, (n_pieces, piece) = Edges(facets), pieces(facets, len(vertices[0]))
    is_closed = np.ones(n_pieces, bool)
    is_closed[piece[edges.start[edges.sides(edges.size == 1)[0]]]] = False
    _, one = np.unique(piece, return_index=True)
    of_facet, found = piece.take(facets[:, 0]), []
    for each in vertices:
        # About a vertex of its own: far from the origin volumes are small differences.
        first = each.take(facets[:, 0], axis=0) - each.take(one.take(of_facet), axis=0)
        share = np.einsum("ij,ij->i", first, area_vectors(each, facets))
        found.append(is_closed * np.bincount(of_facet, share, n_pieces) / 6.0)
    return found


def _made_one(facets: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shells (F,), which facets (F,) to turn over so that neighbours agree, and which shells can agree at all."""
    count = len(facets)
    a, b = edges.pairs()
    # Two facets that run along an edge the same way are wound against each other.
    against = edges.start[a] == edges.start[b]
    owner_a, owner_b = a // 3, b // 3
    n_shells, shell = connected(owner_a, owner_b, count)
    flipped, is_one_sided = np.zeros(count, bool), np.ones(n_shells, bool)
    if against.any():
        flipped = _two_coloured(count, owner_a, owner_b, against, shell)
        # As most facets have it.
        most = 2 * np.bincount(shell, flipped, n_shells) > np.bincount(shell, minlength=n_shells)
        flipped ^= most[shell]
        # A Moebius strip has one side: it stays as it is.
        still = against != (flipped[owner_a] != flipped[owner_b])
        is_one_sided[shell[owner_a[still]]] = False
        flipped &= is_one_sided[shell]
    return shell, flipped, is_one_sided


def _two_coloured(count: int, owner_a: np.ndarray, owner_b: np.ndarray, against: np.ndarray,
                  shell: np.ndarray) -> np.ndarray:
    """Facets to flip so that neighbours agree, each shell from its first facet outward."""
    graph = coo_array((np.where(against, 2, 1), (owner_a, owner_b)), shape=(count, count)).tocsr()
    graph = graph.maximum(graph.T).tocsr()
    flipped = np.zeros(count, bool)
    seeds = np.unique(shell, return_index=True)[1]
    for seed in seeds[np.unique(shell[owner_a[against]])]:
        order, parent = breadth_first_order(graph, seed, directed=False)
        rows = order[1:]
        if not len(rows):
            continue
        turns = np.asarray(graph[parent[rows], rows]).ravel() == 2
        for facet, before, turn in zip(rows.tolist(), parent[rows].tolist(), turns.tolist(), strict=True):
            flipped[facet] = flipped[before] ^ turn
    return flipped


def _are_closed(edges: Edges, shell: np.ndarray, n_shells: int) -> np.ndarray:
    """Whether each shell passes each edge an even number of times."""
    sides, edge = edges.sides(edges.size != 2)
    key, count = np.unique(edge * np.int64(n_shells) + shell[sides // 3], return_counts=True)
    is_closed = np.ones(n_shells, bool)
    is_closed[key[count % 2 == 1] % n_shells] = False
    return is_closed
