"""The sunlit areas of one body that a camera sees, and the places of the error to expect in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from . import accumulate, outlines
from .boundary_clip import Polygons
from .corner_visibility import CornerVisibility
from .image_cells import ImageCells
from .sub_triangles import FacetParts, projected
from .sunlit_error import CLIPPED_ERROR, pixels_squared


@dataclass(frozen=True, kw_only=True, eq=False)
class SunlitAreas:
    """The sunlit areas of one body that a camera sees.

    Attributes
    ----------
    seen : CornerVisibility
        The body, whose cutter has the points.
    whole : (W,) int
        Facets that are lit as a whole.
    polygons : list of ((K, M) int, (M,) int)
        Lit parts of others.
    clipped : FacetParts
        Parts that a boundary crosses; some polygons are their lit rest.
    large : FacetParts
        Parts whose corners agree, with more light than may be missed between them.
    missed, behind : float
        Squared error of boundaries between corners that agree, and of other bodies before facets: `sunlit_error`.
    squared : float
        Squared error of all.
    bias : float
        Light that is missing from all alike: an error of the total light.
    """

    seen: CornerVisibility
    whole: np.ndarray
    polygons: list[Polygons]
    clipped: FacetParts
    large: FacetParts
    missed: float
    behind: float
    squared: float
    bias: float

    def add_to(self, changes: np.ndarray, cells: ImageCells, is_even: bool) -> None:
        """Add what the areas change in the cells of an image: `accumulate`.

        The real part is of radiance, in 1/sr of the Sun's irradiance at 1 au, if asked for times the
        solid angle of a pixel at the facet over that on the boresight; the imaginary one is of cover, which is 1 where
        there is any.

        Parameters
        ----------
        changes : (rows, columns + 2) complex128
        cells : ImageCells
        is_even : bool
            Whether radiance has the solid angle.
        """
        seen = self.seen
        radiance = np.zeros(seen.facets.n_facets)
        radiance[self.whole] = seen.radiance.times_solid_angle(self.whole, is_even, cells.camera)
        outlines.add_facets(changes, cells, seen.facets, seen.view, seen.xy_px, radiance)
        outlines.add_polygons(changes, cells, seen.view, seen.cutter.points.r_m, [
            (corner, seen.radiance.times_solid_angle(facet, is_even, cells.camera) + 1j)
            for corner, facet in self.polygons])

    def add_planes_to(self, changes: np.ndarray, slopes: np.ndarray, cells: ImageCells) -> None:
        """The same with a radiance that varies linearly along each facet.

        What changes is the radiance at the first corner of the grid, and its slopes [1/px] along x and y, as the real
        and the imaginary part of another array (rows, columns + 2).
        """
        seen, origin_px, per_px = self.seen, cells.origin_px, cells.per_px
        points_xy = projected(seen.cutter.points.r_m, seen.view, cells.camera)
        whole = self.seen.facets.corners.take(self.whole, axis=1), self.whole
        for xy_px, (corner, facet) in ((seen.xy_px, whole), *((points_xy, each) for each in self.polygons)):
            value, across, down, _ = seen.radiance.planes(facet, seen.xy_px, origin_px)
            for image, values in ((changes, value + 1j), (slopes, across + 1j * down)):
                accumulate.add_polygons(image, xy_px, corner, values, origin_px, per_px)

    def facets(self) -> np.ndarray:
        """Facets (N,) with light, each once."""
        is_drawn = np.zeros(self.seen.facets.n_facets, bool)
        for facet in (self.whole, *(facet for _, facet in self.polygons)):
            is_drawn[facet] = True
        return np.flatnonzero(is_drawn)

    def uneven(self) -> tuple[np.ndarray, np.ndarray]:
        """Facets (N,) with light, and the squared error (N,) of each by what is not linear in its radiance."""
        facet = self.facets()
        *_, rest = self.seen.radiance.planes(facet, self.seen.xy_px, np.zeros(2))
        return facet, pixels_squared(rest, self.seen.facet_px(facet))

    def add_error_to(self, changes: np.ndarray, cells: ImageCells, has_planes: bool) -> None:
        """Add the squared error to expect of each cell, as the real part of what changes from cell to cell."""
        seen = self.seen
        points_xy = projected(seen.cutter.points.r_m, seen.view, cells.camera)
        for parts, squared in self._error_by_part():
            add_by_area(changes, points_xy, parts.corner, parts.area_px, squared, cells)
        if has_planes:
            facet, squared = self.uneven()
            add_by_area(changes, seen.xy_px, seen.facets.corners.take(facet, axis=1), seen.facet_px(facet), squared,
                        cells)

    def _error_by_part(self) -> Iterator[tuple[FacetParts, np.ndarray]]:
        """Parts and the squared error (N,) of each."""
        seen = self.seen
        yield from ((parts, CLIPPED_ERROR * seen.squared_light(parts)) for parts in (self.clipped, self.large))
        everywhere = seen.parts_of(np.flatnonzero(np.isin(seen.facing, self.whole)))
        for squared, parts in ((self.missed, [seen.boundary, seen.beside_boundary()]),
                               (self.behind, [everywhere, seen.uniform])):
            if squared > 0.0:
                parts = FacetParts.joined(parts)
                yield parts, shared(squared, pixels_squared(seen.radiance.of(parts.facet), parts.area_px))


def shared(squared: float, weights: np.ndarray) -> np.ndarray:
    """A squared error as a sum (N,) in proportion to weights (N,)."""
    return weights * (squared / max(float(weights.sum()), 1e-300))


def add_by_area(changes: np.ndarray, xy_px: np.ndarray, corner: np.ndarray, area_px: np.ndarray, amount: np.ndarray,
                cells: ImageCells) -> None:
    """Share amounts (N,) of triangles among the cells that they cover, as the real part of what changes.

    Their corners (3, N) are among places (2, P) [px].
    """
    per_area = amount / np.maximum(area_px, 1e-300) / cells.per_px.prod()
    accumulate.add_polygons(changes, xy_px, corner, per_area + 0j, cells.origin_px, cells.per_px)
