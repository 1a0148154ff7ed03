"""The shells of a mesh: seams welded, winding made one, closed shells turned outward and those of cavities inward.

Open shells and panels that are given with both their sides stay as the file has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from .hull import surface_distance_m

# Gaps of seams: steps of float32 at the largest coordinate, and a share of an open edge's length.
_SEAM_STEPS, _SEAM_OF_EDGE = 4.0, 1e-3
# Of the shortest open edge at a vertex, how far it may be moved: no facet collapses.
_MOST_OF_EDGE = 0.25
# Of the extent, below which vertices are one wherever they are: a text file's last digit.
WELD_RTOL = 1e-9
# Vertices around one at which a seam is looked for: corners where tiles meet.
_AROUND = 8
# The sum of a shell's area vectors over its area, below which it is closed but for holes: a hemisphere has a half.
_HOLED = 0.25
# Of a shell's extent times its area, a volume that is none, and of the extent a distance that is none.
_VOLUME_RTOL, _TOUCH_RTOL = 1e-12, 1e-6
# Vertices and middles of facets of a shell by which it is told whether it is within another.
_PLACES = 64
# Any directions that no mesh is built along, one to a row.
_AXES = np.array([[0.8116, 0.4532, 0.3687], [-0.3172, 0.8685, -0.3809], [-0.2961, 0.1733, 0.9393]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Shells:
    """Facets wound as they should be, and what was found.

    Attributes
    ----------
    facets : (F, 3) int
    is_flipped : (F,) bool
        Which of them were turned over.
    is_solid : (F,) bool
        Which belong to a shell that has an inside: closed, or closed but for holes.
    n_shells, n_cavities, n_two_sided : int
        Shells, those of them that bound a cavity, and facets that are there with both their sides.
    n_open_edges, n_holed_edges, n_non_manifold_edges : int
        Edges of one facet, those of them in shells that are closed else, and of more than two.
    """

    facets: np.ndarray
    is_flipped: np.ndarray
    is_solid: np.ndarray
    n_shells: int
    n_cavities: int
    n_two_sided: int
    n_open_edges: int
    n_holed_edges: int
    n_non_manifold_edges: int


@dataclass(frozen=True, eq=False)
class _Edges:
    """Sides of facets, three of each facet one after the other, with an edge's number."""

    start: np.ndarray
    edge: np.ndarray
    size: np.ndarray

    @classmethod
    def of(cls, facets: np.ndarray) -> _Edges:
        start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
        key = np.minimum(start, end) * (facets.max(initial=0) + 1) + np.maximum(start, end)
        _, edge, size = np.unique(key, return_inverse=True, return_counts=True)
        return cls(start, edge.ravel(), size)


def seams(vertices: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Which vertex (V,) each is welded to, itself most, the tolerance and the widest gap [m].

    Only vertices on open edges are welded: what is closed already keeps its thinnest features.
    """
    own = np.arange(len(vertices))
    edges = _Edges.of(facets)
    open_side = np.flatnonzero(edges.size[edges.edge] == 1)
    if not len(open_side):
        return own, 0.0, 0.0
    start, end = facets.ravel()[open_side], np.roll(facets, -1, axis=1).ravel()[open_side]
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
    group = connected_components(coo_array((np.ones(len(near)), (one[near], other[near])), shape=(len(rim), len(rim))),
                                 directed=False)[1]
    first = np.full(group.max() + 1, len(vertices))
    np.minimum.at(first, group, rim)
    own[rim] = first[group]
    return own, tolerance, float(distance[near].max())


def wound(vertices: np.ndarray, facets: np.ndarray) -> Shells:
    """The shells of a mesh, each turned as it should be.

    Facets that share an edge with one other are of one shell. Within a shell, winding is made that of most of its
    facets. A closed shell is turned outward, or into the cavity where it is within an odd number of others.
    """
    is_flipped, is_solid = np.zeros(len(facets), bool), np.zeros(len(facets), bool)
    is_twin = _are_twins(facets)
    single = np.flatnonzero(~is_twin)
    n_twin_shells = _n_pieces(facets[is_twin])
    if not len(single):
        return Shells(facets=facets, is_flipped=is_flipped, is_solid=is_solid, n_shells=n_twin_shells, n_cavities=0,
                      n_two_sided=len(facets) // 2, n_open_edges=0, n_holed_edges=0, n_non_manifold_edges=0)
    rest, edges = facets[single], _Edges.of(facets[single])
    shell, flipped, is_one_sided = _made_one(rest, edges)
    n_shells = int(shell.max()) + 1
    rest = np.where(flipped[:, None], rest[:, [0, 2, 1]], rest)
    is_closed = _are_closed(edges, shell, n_shells) & is_one_sided
    owner, extents = _Owner(shell, n_shells), _extents(vertices, rest, shell, n_shells)
    corner = vertices[rest] - extents.mean(axis=0)[shell][:, None]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.bincount(shell, np.linalg.norm(normal, axis=1), n_shells)
    openness = np.linalg.norm([np.bincount(shell, axis, n_shells) for axis in normal.T], axis=0)
    is_holed = is_one_sided & ~is_closed & (openness < _HOLED * area)
    volume = np.bincount(shell, np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])), n_shells)
    has_volume = np.abs(volume) > _VOLUME_RTOL * area * np.linalg.norm(extents[1] - extents[0], axis=1)
    depth = _depths(vertices, rest, owner, extents, is_closed & has_volume, (is_closed | is_holed) & has_volume)
    is_inward = is_closed & has_volume & ((volume < 0.0) != (depth % 2 == 1))
    rest = np.where(is_inward[shell][:, None], rest[:, [0, 2, 1]], rest)
    facets = facets.copy()
    facets[single], is_flipped[single] = rest, flipped ^ is_inward[shell]
    is_solid[single] = ((is_closed | is_holed) & has_volume)[shell]
    is_open = edges.size[edges.edge] == 1
    return Shells(
        facets=facets, is_flipped=is_flipped, is_solid=is_solid, n_shells=n_shells + n_twin_shells,
        n_cavities=int((is_closed & has_volume & (depth % 2 == 1)).sum()), n_two_sided=int(is_twin.sum()) // 2,
        n_open_edges=int(is_open.sum()), n_holed_edges=int((is_open & is_holed[np.repeat(shell, 3)]).sum()),
        n_non_manifold_edges=int((edges.size > 2).sum()))


class _Owner:
    """Facets of each of some shells."""

    def __init__(self, shell: np.ndarray, n_shells: int):
        self._order = np.argsort(shell, kind="stable")
        self._begins = np.searchsorted(shell[self._order], np.arange(n_shells + 1))

    def facets(self, number: int) -> np.ndarray:
        """Of one shell (N,)."""
        return self._order[self._begins[number]:self._begins[number + 1]]


def _are_twins(facets: np.ndarray) -> np.ndarray:
    """Facets (F,) whose other side is there too; none is there twice with the same side."""
    _, same, count = np.unique(np.sort(facets, axis=1), axis=0, return_inverse=True, return_counts=True)
    return count[same.ravel()] == 2


def _n_pieces(facets: np.ndarray) -> int:
    """How many pieces facets are of that share vertices."""
    if not len(facets):
        return 0
    used, corner = np.unique(facets, return_inverse=True)
    corner = corner.reshape(-1, 3)
    pairs = np.concatenate([corner[:, :2], corner[:, 1:]])
    return int(connected_components(coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])),
                                              shape=(len(used), len(used))), directed=False)[0])


def _made_one(facets: np.ndarray, edges: _Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shells (F,), which facets (F,) to turn over so that neighbours agree, and which shells can agree at all."""
    count = len(facets)
    order = np.argsort(edges.edge, kind="stable")
    first = (np.cumsum(edges.size) - edges.size)[edges.size == 2]
    a, b = order[first], order[first + 1]
    # Two facets that run along an edge the same way are wound against each other.
    against = edges.start[a] == edges.start[b]
    owner_a, owner_b = a // 3, b // 3
    n_shells, shell = connected_components(coo_array((np.ones(len(a)), (owner_a, owner_b)), shape=(count, count)),
                                           directed=False)
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
    """Which facets to flip so that neighbours agree, each shell from its first facet outward."""
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


def _are_closed(edges: _Edges, shell: np.ndarray, n_shells: int) -> np.ndarray:
    """Whether each shell passes each edge an even number of times."""
    odd = np.flatnonzero(edges.size[edges.edge] != 2)
    key, count = np.unique(edges.edge[odd] * np.int64(n_shells) + shell[odd // 3], return_counts=True)
    is_closed = np.ones(n_shells, bool)
    is_closed[key[count % 2 == 1] % n_shells] = False
    return is_closed


def _extents(vertices: np.ndarray, facets: np.ndarray, shell: np.ndarray, n_shells: int) -> np.ndarray:
    """Least and largest coordinates (2, S, 3) of shells."""
    found = np.full((2, n_shells, 3), np.inf)
    for corner in facets.T:
        np.minimum.at(found[0], shell, vertices[corner])
        np.minimum.at(found[1], shell, -vertices[corner])
    return found * np.array([1.0, -1.0])[:, None, None]


def _depths(vertices: np.ndarray, facets: np.ndarray, owner: _Owner, extents: np.ndarray, is_inner: np.ndarray,
            is_outer: np.ndarray) -> np.ndarray:
    """Within how many others (S,) each shell is; only of those that may be inner, by those that may be outer ones."""
    low, high = extents
    depth = np.zeros(len(is_inner), int)
    inner = np.flatnonzero(is_inner)
    for outer in np.flatnonzero(is_outer):
        within = inner[(low[inner] >= low[outer]).all(axis=1) & (high[inner] <= high[outer]).all(axis=1)
                       & (inner != outer)]
        if len(within):
            mesh = _Mesh(vertices, facets[owner.facets(outer)])
            for number in within:
                depth[number] += mesh.holds(vertices, facets[owner.facets(number)],
                                            float((high[number] - low[number]).max()))
    return depth


class _Mesh:
    """A shell, asked what is within it by how often lines in three directions pass it."""

    def __init__(self, vertices: np.ndarray, facets: np.ndarray):
        self._used, corner = np.unique(facets, return_inverse=True)
        corner = corner.reshape(-1, 3)
        self._vertices, self._facets = vertices[self._used], corner
        self._views = []
        for axis in _AXES:
            u = np.cross(axis, [0.0, 0.0, 1.0])
            u /= np.linalg.norm(u)
            frame = np.stack([u, np.cross(axis, u), axis])
            placed = (self._vertices @ frame.T)[corner]
            middle = placed[..., :2].mean(axis=1)
            reach = float(np.linalg.norm(placed[..., :2] - middle[:, None], axis=2).max())
            self._views.append((frame, placed, cKDTree(middle), reach))

    def holds(self, vertices: np.ndarray, facets: np.ndarray, extent: float) -> bool:
        """Whether another shell is within: no place of it outside, but such as touch, and one inside."""
        own = np.setdiff1d(np.unique(facets), self._used)
        places = np.concatenate([vertices[_some(own)], vertices[facets[_some(np.arange(len(facets)))]].mean(axis=1)])
        is_any = False
        for place in places:
            is_inside = self._is_inside(place)
            if is_inside and is_any:
                continue
            if surface_distance_m(self._vertices, self._facets, place) > _TOUCH_RTOL * extent:
                if not is_inside:
                    return False
                is_any = True
        return is_any

    def _is_inside(self, place: np.ndarray) -> bool:
        odd = 0
        for frame, placed, tree, reach in self._views:
            point = frame @ place
            near = np.array(tree.query_ball_point(point[:2], reach), int)
            odd += _n_above(placed[near], self._facets[near], point) % 2
        return odd >= 2


def _n_above(corner: np.ndarray, number: np.ndarray, point: np.ndarray) -> int:
    """How many triangles (N, 3, 3) a line along +z from a point passes; on an edge that two share, one of them."""
    sides = []
    for k in range(3):
        a, b = corner[:, k], corner[:, (k + 1) % 3]
        # The same number whichever way an edge is passed.
        turned = number[:, k] > number[:, (k + 1) % 3]
        low, high = np.where(turned[:, None], b, a), np.where(turned[:, None], a, b)
        left = ((high[:, 0] - low[:, 0]) * (point[1] - low[:, 1]) - (high[:, 1] - low[:, 1]) * (point[0] - low[:, 0])) > 0.0
        sides.append(left ^ turned)
    hit = np.flatnonzero((sides[0] == sides[1]) & (sides[1] == sides[2]))
    a, b, c = (corner[hit, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    height = np.einsum("ij,ij->i", normal, a - point)
    return int((height * normal[:, 2] > 0.0).sum())


def _some(numbers: np.ndarray) -> np.ndarray:
    """At most `_PLACES` of numbers, evenly."""
    return numbers if len(numbers) <= _PLACES else numbers[np.linspace(0, len(numbers) - 1, _PLACES).astype(int)]
