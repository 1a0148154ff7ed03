"""Shapes of fewer facets, as an on-board model has them."""

from __future__ import annotations

import numpy as np
from glrender_camera.validate import finite

from ...base.errors import ConfigError
from ...scene.shape.shape import Shape

# A tetrahedron.
_FEWEST_FACETS = 4
# How fast the simplifier's threshold grows: its default, with which every count is reached.
_AGGRESSIVENESS = 7.0


def checked_share(name: str, value: object) -> float:
    """A share of the facets, above 0 and up to 1."""
    if not 0.0 < (share := finite(name, value)) <= 1.0:
        raise ConfigError(name, "must be a share > 0 and <= 1", value, "0.1 keeps a tenth")
    return share


def decimated(shape: Shape, share: float, name: str = "facets") -> Shape:
    """A shape with a share of its facets, by collapsing edges where the surface moves least; texture is lost.

    Parameters
    ----------
    shape : Shape
    share : float [1], 0..1
        Of the facets, above 0; 1 gives the shape itself.
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
    return Shape.from_arrays(vertices * shape.radius_m, facets)
