"""What a small body's own grid errs by: samples on a lattice, and cells shared among pixels by area. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .eclipses import LEAST_LEFT, NO_ECLIPSE, Eclipse
from .error_model import FACETS_SEEN, NOISE_FACETS, LevelTraits, lit_share
from .view import BodyView

# Of a sample: errors of edges and of creases, powers of what is lit and of creases' slope. What errors of pixels and of
# the centre, over the size, and of the flux, over the root of what is lit, have of that; and the flux, of an eclipse's.
_EDGES, _CREASES, _LIT, _SLOPE = 0.47, 0.67, 1.15, 0.8
_PIXELS, _CENTRE, _FLUX, _PENUMBRAS = 1.2, 1.0, 2.8, 2.0
# By which the samples for an error are found: to a hundredth from a tenth of them.
_STEPS = 4
# Of cells.
_CELL_ERROR, _CELL_LIT = 2.2, 1.2


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """How the light of a body that is alone errs on a regular grid of samples.

    Edges leave N^-1.5 with N samples across a body, and so do creases between facets; those of facets that are much
    smaller than samples are noise, N^-1, and so are penumbras, where each sample meets one point of the Sun's disc.
    They err independently. Kept above seven shapes (a sphere, and 8000 to 3.1 million facets with creases of 4 to
    33 deg), 0.1 to 20 px across, at 3 to 152 deg with 64 to 512 samples across (docs/decisions, 0023).

    Attributes
    ----------
    flux, pixels : float [1]
        Error of the flux, and RMS error of pixels over the mean of the lit ones, over `at`: the truth is within in 98
        of 100.
    centre : float [px]
        That of the centre of light: 97 of 100.
    edges, creases, penumbras : float [1]
        With one sample a pixel.
    facets_across_px : float
        Along a pixel's side, over those from which samples are noise.
    light : float
        Of one unit over all bodies that are drawn.
    lit_px : float [px]
        Pixels that are lit, about, or as many times fewer as those of all that is drawn.
    """

    flux: float
    pixels: float
    centre: float
    edges: float
    creases: float
    penumbras: float
    facets_across_px: float
    light: float
    lit_px: float

    @classmethod
    def of(cls, view: BodyView, level: LevelTraits, *, reflectance: float = 1.0,
           eclipse: Eclipse = NO_ECLIPSE) -> Lattice:
        """Of a body; what others' shadows leave of its light errs the more."""
        lit, size_px = lit_share(view.phase_rad), min(view.size_px, 1e5)
        left = max(eclipse.left, LEAST_LEFT)
        gain = 1.0 / math.sqrt(left)
        flux = gain * _FLUX / math.sqrt(lit)
        return cls(flux=flux, pixels=gain * _PIXELS * size_px + flux, centre=gain * _CENTRE * size_px,
                   edges=_EDGES * lit**-_LIT * size_px**-1.5,
                   creases=_CREASES * level.slope**_SLOPE * lit**-_LIT / size_px,
                   penumbras=_PENUMBRAS * eclipse.noise / (flux * size_px),
                   facets_across_px=math.sqrt(FACETS_SEEN * level.n_facets / NOISE_FACETS) / size_px,
                   light=reflectance * lit * left * size_px**2, lit_px=left * max(size_px**2, 1.0))

    def at(self, samples_per_px: float) -> float:
        """Error with so many along a pixel's side, before `flux`, `pixels` and `centre`."""
        creases = self.creases * min(math.sqrt(self.facets_across_px / samples_per_px), 1.0)
        return math.hypot(self.edges / math.sqrt(samples_per_px), creases, self.penumbras) / samples_per_px


class Lattices:
    """Bodies on one grid, which err independently of each other.

    Parameters
    ----------
    bodies : sequence of Lattice
        Each as if it were alone.
    outline_px : float [px]
        Larger side of the box around all of them.
    """

    def __init__(self, bodies: Sequence[Lattice], outline_px: float):
        light = sum(body.light for body in bodies)
        lit_px = min(sum(body.lit_px for body in bodies), max(outline_px, 1.0) ** 2)
        shares = [(body, body.light / light) for body in bodies if body.light > 0.0]
        self._flux = [(body, share * body.flux) for body, share in shares]
        self._centre = [(body, share * body.centre) for body, share in shares]
        # The light of pixels that are its own is as much over the mean as they are few.
        self._pixels = [(body, share * math.sqrt(max(lit_px / body.lit_px, 1.0)) * body.pixels)
                        for body, share in shares]

    def error(self, samples_per_px: float) -> float:
        """RMS error of pixels over the mean of the lit ones, with so many samples along a pixel's side."""
        return _joined(self._pixels, samples_per_px)

    def flux_error(self, samples_per_px: float) -> float:
        """That of the flux, the same."""
        return _joined(self._flux, samples_per_px)

    def samples_per_px(self, *, flux: float = math.inf, pixels: float = math.inf,
                       centre_px: float = math.inf) -> float:
        """Samples along a pixel's side whose errors of all three are no larger."""
        return max(_samples(self._flux, flux), _samples(self._pixels, pixels), _samples(self._centre, centre_px))


def _joined(parts: Sequence[tuple[Lattice, float]], samples_per_px: float) -> float:
    return math.sqrt(sum((weight * body.at(samples_per_px)) ** 2 for body, weight in parts))


def _samples(parts: Sequence[tuple[Lattice, float]], error: float) -> float:
    """Samples along a pixel's side that leave no more than an error, and hardly less."""
    if not parts or math.isinf(error):
        return 0.0
    found = max((weight * body.edges / error) ** (2.0 / 3.0) for body, weight in parts)
    # Errors fall by N^-1.5 at most, so that these are never too many, and by N^-1 at least.
    for _ in range(_STEPS):
        found *= (_joined(parts, found) / error) ** (2.0 / 3.0)
    return found * max(_joined(parts, found) / error, 1.0)


def cell_error(cell_px: float, phase_rad: float) -> float:
    """RMS error of a body of few pixels whose cells of so many pixels' width are shared among those by area.

    Of 120 attitudes of four shapes at 1 to 4 px, 95 of 100 are within at 0.015 to 0.25 px and 3 to 152 deg, about.
    """
    return _CELL_ERROR * cell_px**2 * lit_share(phase_rad) ** -_CELL_LIT


def cell_size(error: float, phase_rad: float) -> float:
    """Width [px] of cells that have such an error: the inverse."""
    return math.sqrt(error / _CELL_ERROR * lit_share(phase_rad) ** _CELL_LIT)
