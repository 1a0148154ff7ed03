"""Shapes of fewer facets, as an on-board model has them."""

from __future__ import annotations

import numpy as np
from glrender_camera.validate import finite
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...base.errors import ConfigError
from ...scene.shape.edges import Edges
from ...scene.shape.shape import Shape, centre_of_volume

# A tetrahedron.
_FEWEST_FACETS = 4
# How fast the simplifier's threshold grows: one of 4 stops at two facets in a hundred, one of 7 keeps less volume.
_AGGRESSIVENESS = 5.0


def checked_share(name: str, value: object) -> float:
    """A share of the facets, above 0 and up to 1."""
    if not 0.0 < (share := finite(name, value)) <= 1.0:
        raise ConfigError(name, "must be a share > 0 and <= 1", value, "0.1 keeps a tenth")
    return share


def decimated(shape: Shape, share: float, name: str = "facets") -> Shape:
    """A shape with a share of its facets, or a few less: edges collapse where that moves the surface least.

    A closed shape keeps its volume and its centre of volume, so that an estimator which believes in it finds range and
    place without a bias.

    Parameters
    ----------
    shape : Shape
    share : float [1], 0..1
        Share of the facets that is kept, above 0; 1 gives the shape itself, all others lose its texture.
    name : str
        Name of the share in errors.

    Raises
    ------
    ConfigError
        A share out of its range, or of fewer than four facets; the package is missing.

    Source: Garland and Heckbert (1997), quadric error metrics, by the package fast-simplification.
    """
    if (share := checked_share(name, share)) == 1.0:
        return shape
    if (count := int(share * len(shape.facets))) < _FEWEST_FACETS:
        raise ConfigError(name, f"must leave {_FEWEST_FACETS} facets of {len(shape.facets)}", share)
    try:
        from fast_simplification import simplify
    except ImportError:
        raise ConfigError(name, "needs fast-simplification", share, "pip install 'glrender[belief]'") from None
    # The simplifier's thresholds are lengths, which fit in units of the body. It takes arrays that it could write to.
    vertices, facets = simplify(np.array(shape.vertices_m / shape.radius_m, order="C"),
                                np.array(shape.facets, np.int32), target_count=count, agg=_AGGRESSIVENESS)
    fewer = Shape.from_arrays(vertices * shape.radius_m, _largest_shells(facets, shape.report.n_shells),
                              inside=shape.inside)
    if not (shape.report.is_watertight and fewer.report.is_watertight):
        return fewer
    # Collapsed edges cut off convex parts: 76 facets of Itokawa have 6 % less volume, and look 2 % farther away.
    size = (shape.report.volume_m3 / fewer.report.volume_m3) ** (1.0 / 3.0)
    r_true_m, r_fewer_m = (centre_of_volume(each.vertices_m, each.facets) for each in (shape, fewer))
    return Shape.from_arrays(r_true_m + size * (fewer.vertices_m - r_fewer_m), fewer.facets, inside=shape.inside)


def _largest_shells(facets: np.ndarray, count: int) -> np.ndarray:
    """The facets of the largest shells: where edges collapse, crumbs of a few facets come off."""
    first, second = (sides // 3 for sides in Edges(facets).pairs())
    pairs = coo_array((np.ones(len(first), bool), (first, second)), shape=2 * (len(facets),))
    _, shell = connected_components(pairs, directed=False)
    return facets[np.isin(shell, np.argsort(-np.bincount(shell), kind="stable")[:count])]
