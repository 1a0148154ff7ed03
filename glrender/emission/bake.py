"""Sources as one table of weights by direction and distance; a change of the Sun is a sum, not a new table."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .fields import SphericalField, octahedral_from_direction, spherical_nodes, trilinear
from .sources.source import Source

# Nodes over the smallest feature: the peak of a jet is then 1 % too low at most, its flux right.
_NODES_PER_FEATURE = 3.0
_MOST_DIRECTIONS = 192
_SHELLS_PER_OCTAVE = 4.0
# An even coma has one direction: its shells cost nothing.
_EVEN_SHELLS_PER_OCTAVE = 12.0
# The table ends 250 least radii from the origin: beyond, where dust left the surface is forgotten within 1 %.
_OCTAVES = 9.0
_EVEN_OCTAVES = 26.0


class SphericalBake:
    """Weights of sources around one body.

    Parameters
    ----------
    sources : sequence of Source
    body_radius_m : (float, float) [m]
        Least and greatest distance of the surface from the origin.
    """

    def __init__(self, sources: Sequence[Source], body_radius_m: tuple[float, float]):
        self._sources = tuple(sources)
        nearest, farthest = body_radius_m
        nearest = max(nearest, 0.05 * farthest)
        self.least_m, self._inner_m = 0.3 * nearest, 0.5 * nearest
        self._sizes = [self._size(source) for source in sources]
        self._tables = []
        for source, (n_r, n, rate) in zip(self._sources, self._sizes, strict=True):
            nodes = spherical_nodes(n_r, n, self._inner_m, rate)
            self._tables.append(source.components(nodes.reshape(-1, 3)).astype(np.float32))

    def _size(self, source: Source) -> tuple[int, int, float]:
        """Shells, directions along a side, and shells per octave for a source."""
        if math.isinf(source.feature_rad):
            rate, octaves, n = _EVEN_SHELLS_PER_OCTAVE, _EVEN_OCTAVES, 2
        else:
            rate, octaves = _SHELLS_PER_OCTAVE, _OCTAVES
            n = math.ceil(_NODES_PER_FEATURE * math.pi / source.feature_rad)
            n = min(max(n, 8), _MOST_DIRECTIONS, source.most_directions)
        if math.isfinite(source.reach_m):
            # The last shell is at the reach itself, so that the cut is where it belongs.
            octaves = max(math.log2(source.reach_m / self._inner_m), 1.0 / rate)
            n_r = math.ceil(octaves * rate) + 1
            return n_r, n, (n_r - 1) / octaves
        return math.ceil(octaves * rate) + 1, n, rate

    def fields(self, sun_direction_body: np.ndarray) -> list[tuple[SphericalField, tuple[str, ...]]]:
        """Weights with the Sun in a direction (3,), and the models in them: sources with one grid are added up."""
        made: dict[tuple, tuple[np.ndarray, tuple[str, ...]]] = {}
        for source, size, table in zip(self._sources, self._sizes, self._tables, strict=True):
            activity = source.activity(sun_direction_body).astype(np.float32)
            values = (activity @ table).reshape(size[0], size[1], size[1])
            key, models = (size[0], size[2], math.isfinite(source.reach_m)), ()
            if key in made:
                others, models = made[key]
                n = max(others.shape[1], size[1])
                values = self._resampled(others, key, n) + self._resampled(values, key, n)
            made[key] = (values, (*models, type(source).__name__.lower()))
        return [(SphericalField(values_m=values, inner_m=self._inner_m, shells_per_octave=rate, is_cut=is_cut,
                                least_m=self.least_m), models) for (_, rate, is_cut), (values, models) in made.items()]

    def _resampled(self, values: np.ndarray, key: tuple, n: int) -> np.ndarray:
        """Values on an octahedral map of n directions along a side."""
        if values.shape[1] == n:
            return values
        old = SphericalField(values_m=values, inner_m=self._inner_m, shells_per_octave=key[1], is_cut=False,
                             least_m=self.least_m)
        direction = spherical_nodes(1, n, 1.0, 1.0)[0]
        place = octahedral_from_direction(direction) * values.shape[1] + 0.5
        texels = old.texels()
        flat = [trilinear(shell[None], np.stack([np.zeros((n, n)), place[..., 1], place[..., 0]], axis=-1))
                for shell in texels]
        return np.array(flat, np.float32)
