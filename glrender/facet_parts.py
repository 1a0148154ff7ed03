"""Parts of facets, and what is known of their corners."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(eq=False)
class FacetParts:
    """Triangles within facets; of each corner, whether it is seen, and in sunlight as well.

    Corners (3, 3, N) [m], facet (N,), is_seen and is_lit (3, N), area_px (N,).
    """

    corner_m: np.ndarray
    facet: np.ndarray
    is_seen: np.ndarray
    is_lit: np.ndarray
    area_px: np.ndarray

    def at(self, chosen: np.ndarray) -> FacetParts:
        """Those of given numbers (M,)."""
        return FacetParts(*(getattr(self, field.name).take(chosen, axis=-1) for field in fields(self)))

    @classmethod
    def joined(cls, several: list[FacetParts]) -> FacetParts:
        """All of them, one after the other."""
        return cls(*(np.concatenate([getattr(one, field.name) for one in several], axis=-1) for field in fields(cls)))

    @property
    def n_lit(self) -> np.ndarray:
        """(N,) int: corners in sunlight that are seen."""
        return self.is_lit.sum(axis=0)

    @property
    def is_mixed(self) -> np.ndarray:
        """(N,) bool: whether the corners differ in that."""
        return (self.is_lit != self.is_lit[0]).any(axis=0)
