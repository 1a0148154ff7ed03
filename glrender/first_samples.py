"""How many samples a window is drawn with first, before its image tells where more are needed. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from .error_model import NOISE_FACETS, LevelTraits, facets_per_px, lit_share
from .refine import SAMPLE_COUNTS
from .view import BodyView

MAX_SAMPLES = 16
"""Most samples along a pixel's side, but of rays at small bodies."""
# Squared error of one sample a pixel, cast shadows included: outlines and terminator, and creases between facets, which
# grow no more where they are sharp. Fourteen shapes at 50 to 400 px and 30 to 155 deg (docs/planner.md).
_LIMB, _LIMB_POWER, _LIT_POWER = 0.236, 1.12, 2.17
_CREASES, _SHARP_RAD, _TILT_POWER = 3.98, 0.58, 0.88
# Of surface detail's slope, which no layer has finer than two pixels.
_DETAIL = 0.044
# What an image tells of its squared error over that, and scatter of the logarithm of the error.
_TOLD, _SCATTER = 1.7, 0.35
# A second pass that was not foreseen has so many more samples along a pixel's side.
_MORE = 1.5


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Squared error that an image will tell of itself, in parts of one sample a pixel.

    Attributes
    ----------
    limb, creases : float [1]
        Of outlines, and of facets much smaller than a pixel.
    facets_per_px : float
    """

    limb: float
    creases: float
    facets_per_px: float

    @classmethod
    def of(cls, view: BodyView, level: LevelTraits) -> Expected:
        """Of a body."""
        diameter = min(max(view.size_px, 1.0), 1e5)
        lit = lit_share(view.phase_rad)
        tilt = (0.02 + min(math.tan(0.5 * view.phase_rad), 30.0) ** 2) ** _TILT_POWER
        creases = _CREASES / (level.crease_rad**-2 + _SHARP_RAD**-2) if level.crease_rad > 0.0 else 0.0
        return cls(limb=_TOLD * _LIMB * diameter**-_LIMB_POWER * lit**-_LIT_POWER,
                   creases=_TOLD * tilt * (creases + _DETAIL * level.detail_slope**2),
                   facets_per_px=facets_per_px(view, level.n_facets))

    @classmethod
    def worst(cls, several: Iterable[Expected]) -> Expected:
        """Of bodies that are drawn together."""
        limb, creases, facets = zip(*((one.limb, one.creases, one.facets_per_px) for one in several), strict=True)
        return cls(limb=max(limb), creases=max(creases), facets_per_px=max(facets))

    def limb_at(self, samples: int) -> float:
        """Of outlines, with so many samples along a pixel's side."""
        return self.limb / samples**3

    def creases_at(self, samples: int) -> float:
        """Of creases: samples much larger than facets are noise, others meet edges."""
        return self.creases * min(math.sqrt(self.facets_per_px / NOISE_FACETS) / samples, 1.0) / samples**2


def first_samples(expected: Expected, n_px: float, setup: float, passed_over: float, least: int,
                  budget: float, most: int = MAX_SAMPLES) -> tuple[float, int]:
    """Cost of drawing, and samples along a pixel's side before the image itself tells where more are needed.

    A second pass over few pixels cures outlines; creases are everywhere, and half of the pixels
    have nearly all of their error. The cheapest pair of passes that should meet the budget decides, or one pass, with
    what a second costs where the guess may fail.

    Parameters
    ----------
    expected : Expected
    n_px : float [px]
        Of the bodies.
    setup, passed_over : float
        Cost of a pass, and of a sample that a second pass leaves out, in samples: where chunks of facets have a
        pixel that is drawn, in about 0.3 + 1.2 sqrt(share) of them.
    least, most : int
        Fewest and most samples along a pixel's side.
    budget : float [1]
        RMS.
    """
    best = (math.inf, most)
    edge_share = min(12.0 / math.sqrt(n_px), 1.0)

    def second_pass(samples: float, share: float) -> float:
        beside = min(0.3 + 1.2 * math.sqrt(share), 1.0)
        return setup + n_px * samples**2 * (share + passed_over * beside)

    for first in range(least, most + 1):
        cost = setup + n_px * first**2
        if cost > best[0]:
            break
        creases = expected.creases_at(first)
        guess = math.sqrt(expected.limb_at(first) + creases)
        if guess <= budget:
            # The image may tell that it was not enough.
            risk = 0.5 * math.erfc(math.log(budget / guess) / (_SCATTER * math.sqrt(2.0))) if guess > 0.0 else 0.0
            best = min(best, (cost + risk * second_pass(_MORE * first, edge_share), first))
            continue
        if first == most:
            best = min(best, (cost, first))
        for second in SAMPLE_COUNTS:
            room = budget**2 - expected.limb_at(second)
            kept = min(room / creases, 1.0) if creases > 0.0 else 1.0
            if second <= first or room <= 0.0 or kept * creases < expected.creases_at(second):
                continue
            share = min(edge_share + 0.5 * (1.0 - kept) ** 2, 1.0)
            best = min(best, (cost + second_pass(second, share), first))
    return best
