"""The seeds of random scenes that numbers were fitted to, and those that none was: a fit takes none of the latter.

Scenes of `accuracy/random_scenes.py`, `hard_scenes.py`, `units.py` and `eclipses.py`; `heldout.py` and `tighter.py`
draw them.
"""

from __future__ import annotations

FITTED = {
    "draw": (range(400), range(5000, 5040), range(7000, 7020)),
    "draw_small": (range(5000, 5200), range(7000, 7200), range(9000, 9200)),
    "draw_eclipse": (range(70),),
}
"""Seeds that numbers were fitted to, by the function that makes their scenes."""

NEVER_FITTED = {
    "draw": (range(400, 460),),
    "draw_small": (range(10_000, 10_200), range(30_000, 30_400)),
    "draw_eclipse": (range(20_000, 21_000),),
    "draw_neighbours": (range(20_000, 21_000), range(30_000, 30_400)),
    "draw_tiny": (range(20_000, 21_000),),
    "draw_plain": (range(30_000, 30_500),),
    "draw_crescent": (range(30_000, 30_400),),
}
"""Seeds that hold the promises of docs/accuracy.md: nothing may be fitted to them."""

COVERAGE_FITTED = range(5000, 5060)
"""Seeds of `draw_small` that `coverage_errors.py` takes."""
UNITS_FITTED = range(5000, 5040)
"""Seeds of `draw` that `unit_errors.py` takes."""


def n_fitted(maker: str, seeds: range) -> int:
    """How many of some seeds numbers were fitted to, by the function that makes their scenes."""
    return sum(any(seed in fitted for fitted in FITTED.get(maker, ())) for seed in seeds)
