"""Shapes of fewer facets, as an on-board model has them."""

from __future__ import annotations

import numpy as np
from glrender_camera.validate import finite
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...base.errors import ConfigError
from ...scene.shape.edges import Edges
from ...scene.shape.shape import Shape

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

    Parameters
    ----------
    shape : Shape
    share : float [1], 0..1
        Of the facets, above 0; 1 gives the shape itself, all others lose its texture.
    name : str
        What errors call the share.

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
    return Shape.from_arrays(vertices * shape.radius_m, _largest_shells(facets, shape.report.n_shells))


def _largest_shells(facets: np.ndarray, count: int) -> np.ndarray:
    """The facets of the largest shells: where edges collapse, crumbs of a few facets come off."""
    first, second = (sides // 3 for sides in Edges(facets).pairs())
    pairs = coo_array((np.ones(len(first), bool), (first, second)), shape=2 * (len(facets),))
    _, shell = connected_components(pairs, directed=False)
    return facets[np.isin(shell, np.argsort(-np.bincount(shell), kind="stable")[:count])]
