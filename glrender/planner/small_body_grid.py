"""The samples that an image of a body needs across it, and cells when it has a grid of its own. Pure."""

from __future__ import annotations

import math

from ..view.view import BodyView
from .error_model import FACETS_SEEN, NOISE_FACETS, BodyTraits, lit_share

CELL_PX = 0.28
"""Side of the cells of a small body, each a point: light in its middle is 0.0065 px^2 narrower, and a crowd of points
is spread 0.0067 px^2 wider."""
SAMPLE_COUNTS = tuple(sorted(first * 2**k for first in (2, 3) for k in range(6)))
"""Samples along a pixel's side that a refinement may take: up to 16, and more where they are asked for."""
MAX_RAYS_ACROSS = 1024
"""Most rays across a small body: some half a second."""
SAMPLES_ACROSS = tuple(n for each in SAMPLE_COUNTS if (n := 32 * each) <= MAX_RAYS_ACROSS)
"""Samples across the outline of a body that has a grid of its own."""
# Cells across a small body's own grid, at least and at most.
_CELLS_ACROSS, _MOST_CELLS = 16.0, 2048.0
# Relative error of one sample across a body: edges fall as N^-1.5, creases between facets as N^-1 while a sample is
# larger than a facet and as N^-1.5 from there on. Seven shapes of 8,000 to 3.1 million facets, 0.1 to 20 px across, at
# 3 to 152 deg, 64 to 512 samples across: 98 of 100 are within (tests/planner/test_small_bodies.py).
_EDGES = 0.47
_CREASES = 0.67
_CREASE_POWER = 0.8
_LIT_POWER = 1.2
# The same data: errors of the flux, of pixels and of the centre of light [px], over that.
_FLUX = 2.8
_PIXELS = 1.2


def own_cells(outline: tuple[float, float, float, float], size_px: float
              ) -> tuple[tuple[float, float, float, float], tuple[int, int], float]:
    """Bounds [px] and grid of the cells of a body of an outline [px], each within one pixel; and cells per px."""
    # Smaller ones are points to float64.
    size_px = max(size_px, 1e-8)
    per_px = 2.0 ** min(math.floor(math.log2(_MOST_CELLS / size_px)),
                        math.ceil(math.log2(max(1.0 / CELL_PX, _CELLS_ACROSS / size_px))))
    # Powers of two: edges of cells at those of pixels have no rounding.
    x0, y0, x1, y1 = ((edge + 0.5) * per_px for edge in outline)
    first, last = (math.floor(x0), math.floor(y0)), (math.floor(x1) + 1, math.floor(y1) + 1)
    return (tuple(edge / per_px - 0.5 for edge in first + last), (last[0] - first[0], last[1] - first[1]), per_px)


def sampling_errors(view: BodyView, traits: BodyTraits, n_across: float, penumbra: float = 0.0
                    ) -> tuple[float, float]:
    """Error of the flux [1], and RMS error of pixels over their mean [1], with so many samples across a body.

    Each sample meets one point of the Sun's disc: noise whose square is `penumbra` that of a body of which all is half
    eclipsed.
    """
    lit = lit_share(view.phase_rad)
    crowd = FACETS_SEEN * traits.n_facets / NOISE_FACETS
    creases = _CREASES * traits.slope**_CREASE_POWER * min(math.sqrt(math.sqrt(crowd) / n_across), 1.0)
    # Where all of a body is half eclipsed half of the samples are lit: they deviate by a half from their mean.
    noise = 0.5 * math.sqrt(penumbra)
    error = lit**-_LIT_POWER * math.hypot(_EDGES / math.sqrt(n_across), creases, noise) / n_across
    flux = _FLUX / math.sqrt(lit) * error
    return flux, _PIXELS * min(view.size_px, 1e5) * error + flux


def samples_across(view: BodyView, traits: BodyTraits, flux_error: float, pixel_error: float = math.inf,
                   penumbra: float = 0.0) -> int:
    """The fewest of `SAMPLES_ACROSS` whose errors of flux and pixels are within; the most where none are."""
    for n_across in SAMPLES_ACROSS:
        flux, pixels = sampling_errors(view, traits, n_across, penumbra)
        if flux <= flux_error and pixels <= pixel_error:
            return n_across
    return SAMPLES_ACROSS[-1]
