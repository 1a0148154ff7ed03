"""Faults of the light that reaches the detector, and of the pixels that collect it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..exposure import checked_exposure_s
from .fault import Effect, Fault, Site, number, whole

# Full wells in a pixel of the Sun's image: more would not change the numbers.
_MOST_FULL_WELLS = 10.0
# How far beyond the frame the Sun may stand, as a share of the frame's sides.
_BESIDE = 0.25
# Standard deviations beyond which a satellite's trail gives no light, and the share of its depth below which a spot
# of dust takes none.
_REACH, _NEGLIGIBLE = 5.0, 1e-4


@dataclass(frozen=True, kw_only=True)
class StuckExposure(Fault):
    """The exposure stays at `exposure_s` [s], whatever was asked for or metered."""

    kind: ClassVar[str] = "stuck_exposure"
    exposure_s: float = field(metadata={"check": checked_exposure_s})

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        return Effect(truth={"kind": self.kind, "exposure_s": self.exposure_s})


@dataclass(frozen=True, kw_only=True)
class SunBlinding(Fault):
    """The Sun shines into the optics, from within the frame or up to a quarter of its sides outside.

    The veil around it falls with the distance squared and is a full well at `radius_px`. Where the Sun stands in the
    frame its charge overflows along the columns as far as `bloom_px`.
    """

    kind: ClassVar[str] = "sun_blinding"
    radius_px: float = number(40.0, 0.5, 16384.0)
    bloom_px: float = number(200.0, 0.0, 16384.0)

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        ((x, y),), place = site.pixels(rng, self.place, 1, _BESIDE)
        is_inside = 0 <= x < site.shape[1] and 0 <= y < site.shape[0]

        def added() -> np.ndarray:
            across, down = site.offsets(x, y)
            light = np.float32(self.radius_px**2) / np.maximum(across**2 + down**2, np.float32(1.0))
            if is_inside:
                # The overflow thins out.
                half = 0.5 * self.radius_px * (1.0 - np.abs(down) / (self.bloom_px + 1.0))
                light[np.abs(across) <= half] = _MOST_FULL_WELLS
            return np.minimum(light, np.float32(_MOST_FULL_WELLS)) * np.float32(site.detector.full_well_electrons)

        return Effect(truth={"kind": self.kind, "place": place, "centre_px": [int(x), int(y)],
                             "radius_px": self.radius_px}, added_electrons=added)


@dataclass(frozen=True, kw_only=True)
class SatelliteCrossing(Fault):
    """A bright satellite crosses the frame in a straight line while the shutter is open.

    Its trail is `peak_full_wells` bright in the middle and Gaussian across, with a standard deviation of `sigma_px`.
    """

    kind: ClassVar[str] = "satellite_crossing"
    sigma_px: float = number(1.0, 0.3, 100.0)
    peak_full_wells: float = number(1.0, 0.0, _MOST_FULL_WELLS)

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        ((x, y),), place = site.pixels(rng, self.place, 1)
        angle = np.pi * rng.random()
        direction, peak = [float(np.cos(angle)), float(np.sin(angle))], site.detector.full_well_electrons

        def added() -> np.ndarray:
            across, down = site.offsets(x, y)
            aside = np.float32(direction[1]) * across - np.float32(direction[0]) * down
            near = np.abs(aside) < _REACH * self.sigma_px
            light = np.zeros(aside.shape, np.float32)
            light[near] = self.peak_full_wells * peak * np.exp(-0.5 * (aside[near] / self.sigma_px) ** 2)
            return light

        return Effect(truth={"kind": self.kind, "place": place, "through_px": [int(x), int(y)],
                             "direction": direction, "sigma_px": self.sigma_px}, added_electrons=added)


@dataclass(frozen=True, kw_only=True)
class Dust(Fault):
    """Grains on the optics make soft dark spots that stay where they are, from half to one and a half times as wide as
    `radius_px`, their standard deviation; the middle of each loses the share `depth` of its light."""

    kind: ClassVar[str] = "dust"
    is_fixed: ClassVar[bool] = True
    n_spots: int = whole(5, 1, 100)
    radius_px: float = number(8.0, 0.3, 1000.0)
    depth: float = number(0.5, 0.0, 1.0)

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        centres, place = site.pixels(rng, self.place, self.n_spots)
        radii = self.radius_px * (0.5 + rng.random(self.n_spots))
        spots = [[x, y, radius] for (x, y), radius in zip(centres.tolist(), radii.tolist(), strict=True)]

        def kept() -> np.ndarray:
            left = np.ones(site.shape, np.float32)
            for x, y, radius in spots:
                across, down = (np.exp(-0.5 * (offset / radius) ** 2) for offset in site.offsets(x, y))
                near_x, near_y = across > _NEGLIGIBLE, down[:, 0] > _NEGLIGIBLE
                left[np.ix_(near_y, near_x)] *= 1.0 - np.float32(self.depth) * down[near_y] * across[near_x]
            return left

        return Effect(truth={"kind": self.kind, "place": place, "depth": self.depth, "spots": spots}, kept=kept)


@dataclass(frozen=True, kw_only=True)
class DeadColumns(Fault):
    """Columns of the detector collect no light and stay dead; their dark current and read noise remain."""

    kind: ClassVar[str] = "dead_columns"
    is_fixed: ClassVar[bool] = True
    n_columns: int = whole(4, 1, 1000)

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        pixels, place = site.pixels(rng, self.place, self.n_columns)
        columns, left = np.unique(pixels[:, 0]), np.ones(site.shape[1], np.float32)
        left[columns] = 0.0
        return Effect(truth={"kind": self.kind, "place": place, "columns": columns.tolist()},
                      kept=lambda: np.broadcast_to(left, site.shape))
