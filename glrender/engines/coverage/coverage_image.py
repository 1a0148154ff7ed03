"""An image of exact areas, and the error to expect of each of its cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from . import accumulate
from .corner_visibility import CornerVisibility, HardEdges
from .image_cells import ImageCells
from .sub_triangles import projected
from .sunlit_areas import SunlitAreas, add_by_area, shared
from .sunlit_error import CoverageError, ErrorScale

# Light of an image over that of its facets by their corners, from which that is an estimate [1]: large facets near the
# camera may have five times as much.
_LIGHT_OF_CORNERS = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class LookedAt:
    """Bodies by the visibility of their corners, and the errors of hard edges in place of penumbras.

    Attributes
    ----------
    bodies : list of CornerVisibility
    scales : (ErrorScale, ErrorScale)
        Of the errors of `CoverageError`.
    hard : list of HardEdges
        Of each body; none of a Sun without a disc.
    low : list of (float, float)
        Likewise of facets in a low Sun: squared error, and light.
    """

    bodies: list[CornerVisibility]
    scales: tuple[ErrorScale, ErrorScale]
    hard: list[HardEdges]
    low: list[tuple[float, float]]

    @property
    def squared(self) -> list[float]:
        """Squared errors of hard edges and a low Sun by both scales."""
        hard = sum(float(edges.squared.sum()) for edges in self.hard)
        return [scale.of_penumbras(hard, self.low) if self.low else 0.0 for scale in self.scales]

    @property
    def penumbra(self) -> CoverageError:
        """The error of hard edges and a low Sun."""
        return CoverageError(*(scale.rms(squared) if squared else 0.0
                               for scale, squared in zip(self.scales, self.squared, strict=True)))

    @property
    def wide_px(self) -> float:
        """Width of the penumbras of the body whose are widest."""
        return max((edges.wide_px for edges in self.hard), default=0.0)

    def add_error_to(self, changes: np.ndarray, cells: ImageCells) -> None:
        """Add the squared error of hard edges and a low Sun of each cell, by the first scale."""
        if not self.low:
            return
        scale = self.scales[0]
        low = scale.of_penumbras(0.0, self.low) / len(self.bodies)
        for body, edges in zip(self.bodies, self.hard, strict=True):
            add_by_area(changes, projected(body.cutter.points.r_m, body.view, cells.camera), edges.parts.corner,
                        edges.parts.area_px, scale.of_penumbras(1.0, [(0.0, 0.0)]) * edges.squared, cells)
            facet = body.in_low_sun()
            area_px = body.facet_px(facet)
            add_by_area(changes, body.xy_px, body.facets.corners.take(facet, axis=1), area_px, shared(low, area_px),
                        cells)


@dataclass(frozen=True, kw_only=True, eq=False)
class CoverageImage:
    """An image of exact areas.

    Attributes
    ----------
    means : (rows, columns) float64 [W/m2 per pixel]
    error : CoverageError
        Infinite where nothing could be drawn.
    scales : (ErrorScale, ErrorScale), optional
        Of both errors, where those of cells are known.
    unit_W_m2 : float [W/m2]
        Mean over a cell of an irradiance of 1 in the scales' units.
    squared_of_areas : callable, optional
        () gives the squared errors (rows, columns) [(W/m2)^2] of the cells' areas.
    softer : callable, optional
        () gives the image by points of the Sun's disc, where hard edges in place of penumbras cost too much and the
        steps of so few points as well.
    areas : tuple of tuple of SunlitAreas
        By each point of the Sun's disc whose mean the image is: the areas of each body.
    """

    means: np.ndarray
    error: CoverageError
    scales: tuple[ErrorScale, ErrorScale] | None = None
    unit_W_m2: float = 1.0
    squared_of_areas: Callable[[], np.ndarray] | None = None
    softer: Callable[[], CoverageImage] | None = None
    areas: tuple[tuple[SunlitAreas, ...], ...] = ()

    def squared(self, uneven: float) -> np.ndarray:
        """Squared errors (rows, columns) [(W/m2)^2] to expect of the cells, with an RMS error [1] of their radiance."""
        light = np.square(self.means)
        return self.squared_of_areas() + light * ((uneven * self.unit_W_m2 / self.scales[0].per_root) ** 2
                                                  / max(float(light.sum()), 1e-300))

    def most_squared(self, tolerance: float, means: np.ndarray) -> float:
        """The sum [(W/m2)^2] of squared errors of cells that is within a tolerance [1], if these are the means."""
        return self._scales_of(means)[0].most_squared(tolerance) * self.unit_W_m2**2

    def with_cells(self, means: np.ndarray, squared: float) -> CoverageImage:
        """The image with other means, whose squared errors have a sum [(W/m2)^2]."""
        error = CoverageError(*(scale.error(squared / self.unit_W_m2**2) for scale in self._scales_of(means)))
        return replace(self, means=means, error=error, squared_of_areas=None)

    def _scales_of(self, means: np.ndarray) -> list[ErrorScale]:
        """The scales by the light of the image, where corners promised more."""
        light = float(means.sum()) / self.unit_W_m2
        return [replace(scale, light=min(scale.light, light)) if light > 0.0 else scale for scale in self.scales]

    def by_its_light(self) -> CoverageImage:
        """The image with an error over the light that it has, where that is much less than corners promised."""
        promised, found = self.scales[0].light, float(self.means.sum()) / self.unit_W_m2
        if not 0.0 < found < _LIGHT_OF_CORNERS * promised:
            return self
        return replace(self, error=CoverageError(*(promised / found * each for each in self.error)))

    @classmethod
    def dark(cls, cells: ImageCells, error: CoverageError) -> CoverageImage:
        """An image without light."""
        return cls(means=np.zeros(cells.shape), error=error)

    @classmethod
    def mean(cls, images: Sequence[CoverageImage], looked: LookedAt, share: float, cells: ImageCells
             ) -> CoverageImage:
        """The mean of images that points of the Sun's disc light, which leave a share [1] of the penumbras' error."""
        count = len(images)
        error = CoverageError(*(math.hypot(sum(of_points) / count, share * at_once) for of_points, at_once in zip(
            zip(*(image.error for image in images), strict=True), looked.penumbra, strict=True)))
        if math.isinf(error.judged):
            return cls.dark(cells, error)
        sums = np.zeros(cells.shape)
        for image in images:
            sums += image.means
        lit = [image for image in images if image.squared_of_areas is not None]
        if not lit:
            return cls(means=sums, error=error)
        areas = tuple(image.areas[0] if image.areas else () for image in images)
        return replace(lit[0], means=sums / count, error=error, scales=looked.scales, areas=areas,
                       squared_of_areas=lambda: sum(image.squared_of_areas() for image in lit) / count
                       + (share * lit[0].unit_W_m2) ** 2 * squared_errors(looked, [], cells))


def squared_errors(looked: LookedAt, found: Sequence[SunlitAreas], cells: ImageCells,
                   has_planes: bool = False) -> np.ndarray:
    """Squared errors (rows, columns) to expect of cells, in the scales' units."""
    changes = accumulate.no_changes(cells.shape)
    looked.add_error_to(changes, cells)
    for areas in found:
        areas.add_error_to(changes, cells, has_planes)
    return cells.sums(changes)


def overlapping(means: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """Squared errors (rows, columns) of means where the cover exceeds 1: `accumulate.settle`."""
    return (0.5 * means * np.maximum(cover - 1.0, 0.0)) ** 2
