"""The error budget of a frame: the share of the tolerance that each cause of error may take, with its reason. Pure.

Errors are RMS over the lit pixels over their mean [1], before the camera's point spread function: `account` applies the
function's gain once, where errors are reported. Of the total light it averages none. Causes are independent, so that
their errors add up in squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

FLUX_SHARE = 0.1
"""Error of the total light over the tolerance: the promise of docs/accuracy.md."""
PENUMBRA_SHARE = 0.7
"""Penumbras, and facets of one radiance each: half of the squared tolerance, so that the drawing has the other half."""
SHADOW_MAP_SHARE = 0.4
"""Texels of shadow maps at the edges of shadows: samples are left 0.92 of the tolerance."""
CELL_SHARE = 0.3
"""Cells of a law's table: what is left is 0.95 of the tolerance."""
SAMPLES_SHARE = 0.9
"""Samples of a small body's own grid, which is drawn once: 0.44 is left for shadow maps."""
LEAST_LEFT = 0.3
"""The least that the drawing aims at, whatever is modelled otherwise: it then adds 4 % to that error."""
OVERLAPS_LEFT = 0.9
"""Clipping, of the squared tolerance: a tenth is left for facets that turn out to overlap."""
MISSED_SHARE = 0.8
"""Boundaries that pass between corners that agree, of the squared tolerance: all facets that face camera and Sun are
divided while it is more, which takes longer than to clip the others within the fifth that is left."""
UNDIVIDED_SHARE = 0.25
"""Triangles that are clipped as they are, of the squared error that is left: the dimmest, which are the most."""
ECLIPSE_SHARE = 0.85
"""Samples in an eclipse, or that pass parts by: the first, which the refinement follows, show fewer lit pixels than
there are."""


@dataclass(frozen=True, kw_only=True)
class Budget:
    """The errors that a region's image may have."""

    tolerance: float
    """RMS error [1]; infinite where nothing is drawn again."""
    flux: float | None = None
    """Error of the total light [1]: by default `FLUX_SHARE` of the RMS error, as before a point spread function."""
    flux_asked: float = math.inf
    """Error of the total light [1], where one was asked for; infinite without."""

    def __post_init__(self):
        if self.flux is None:
            object.__setattr__(self, "flux", FLUX_SHARE * self.tolerance)

    @property
    def flux_share(self) -> float:
        """Error of the total light over the RMS error before a point spread function [1]."""
        return self.flux / self.tolerance

    def rms_of(self, modelled: Mapping[str, float], modelled_flux: Mapping[str, float]) -> float:
        """The RMS error [1] of causes with RMS errors, and of those with errors of the total, over their share."""
        return math.hypot(*modelled.values(), *(error / self.flux_share for error in modelled_flux.values()))

    def after(self, modelled: float) -> Budget:
        """The budget of the drawing, by `left_after`: the total light has the same share."""
        left = self.left_after(modelled)
        return replace(self, tolerance=left, flux=self.flux_share * left)

    def left_after(self, modelled: float) -> float:
        """The part of the tolerance that an error [1] leaves for the drawing, in squares; `LEAST_LEFT` at least."""
        return max(math.sqrt(max(self.tolerance**2 - modelled**2, 0.0)), LEAST_LEFT * self.tolerance)
