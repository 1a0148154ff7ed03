"""Faults of the digital numbers on their way from the detector: lines, blocks and bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from .fault import Effect, Fault, Site, whole


@dataclass(frozen=True, kw_only=True)
class Lines(Fault):
    """Fault of `n_gaps` gaps of `n_lines` neighbouring lines each."""

    n_lines: int = whole(8, 1, 16384)
    n_gaps: int = whole(1, 1, 100)

    def gaps(self, rng: np.random.Generator, site: Site) -> tuple[list[tuple[int, int]], dict[str, Any]]:
        """First line of each gap and one past its last, and the truth: gaps are about the places that were chosen."""
        pixels, place = site.pixels(rng, self.place, self.n_gaps)
        first = np.clip(pixels[:, 1] - self.n_lines // 2, 0, max(site.shape[0] - self.n_lines, 0))
        gaps = [(y, min(y + self.n_lines, site.shape[0])) for y in np.unique(first).tolist()]
        lines = np.unique(np.concatenate([np.arange(*gap) for gap in gaps])).tolist()
        return gaps, {"kind": self.kind, "place": place, "lines": lines}


@dataclass(frozen=True, kw_only=True)
class LostLines(Lines):
    """Lines do not arrive: they are 0 DN."""

    kind: ClassVar[str] = "lost_lines"

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        _, truth = self.gaps(rng, site)

        def sent(dn: np.ndarray) -> np.ndarray:
            dn[truth["lines"]] = 0
            return dn

        return Effect(truth=truth, sent=sent)


@dataclass(frozen=True, kw_only=True)
class RepeatedLines(Lines):
    """Each gap's lines hold the line above the gap once more; at the top of the frame, the gap's first."""

    kind: ClassVar[str] = "repeated_lines"

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        gaps, truth = self.gaps(rng, site)

        def sent(dn: np.ndarray) -> np.ndarray:
            for first, end in gaps:
                dn[first:end] = dn[max(first - 1, 0)].copy()
            return dn

        return Effect(truth=truth, sent=sent)


@dataclass(frozen=True, kw_only=True)
class ShiftedLines(Lines):
    """Lines start late: they stand `shift_px` to the right, and their ends come in on the left."""

    kind: ClassVar[str] = "shifted_lines"
    shift_px: int = whole(16, -16384, 16384)

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        _, truth = self.gaps(rng, site)

        def sent(dn: np.ndarray) -> np.ndarray:
            dn[truth["lines"]] = np.roll(dn[truth["lines"]], self.shift_px, axis=1)
            return dn

        return Effect(truth={**truth, "shift_px": self.shift_px}, sent=sent)


@dataclass(frozen=True, kw_only=True)
class LostBlocks(Fault):
    """Square blocks of the grid that a compressor cuts the frame into do not arrive: they are 0 DN."""

    kind: ClassVar[str] = "lost_blocks"
    n_blocks: int = whole(4, 1, 10_000)
    size_px: int = whole(32, 1, 16384)

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        pixels, place = site.pixels(rng, self.place, self.n_blocks)
        corners = np.unique(pixels // self.size_px * self.size_px, axis=0)
        ends = np.minimum(corners + self.size_px, site.shape[::-1])
        blocks = np.concatenate([corners, ends], axis=1).tolist()

        def sent(dn: np.ndarray) -> np.ndarray:
            for x0, y0, x1, y1 in blocks:
                dn[y0:y1, x0:x1] = 0
            return dn

        return Effect(truth={"kind": self.kind, "place": place, "blocks": blocks}, sent=sent)


@dataclass(frozen=True, kw_only=True)
class GarbledBytes(Fault):
    """Runs of `n_bytes` bytes arrive as noise, in the order of a frame's little-endian bytes, line by line.

    Numbers stay within the detector's bits.
    """

    kind: ClassVar[str] = "garbled_bytes"
    n_bytes: int = whole(64, 1, 2**16)
    n_runs: int = whole(4, 1, 1000)

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        pixels, place = site.pixels(rng, self.place, self.n_runs)
        size = 1 if site.detector.bit_depth <= 8 else 2
        n_px, most = -(-self.n_bytes // size), site.detector.max_DN
        first = np.unique(np.clip(pixels[:, 1] * site.shape[1] + pixels[:, 0] - n_px // 2, 0,
                                  max(site.shape[0] * site.shape[1] - n_px, 0)))
        noise = rng.integers(256, size=(len(first), self.n_bytes), dtype=np.uint8)

        def sent(dn: np.ndarray) -> np.ndarray:
            raw = dn.reshape(-1).view(np.uint8)
            for start, run in zip(first.tolist(), noise, strict=True):
                part = raw[start * size:start * size + self.n_bytes]
                part[:] = run[:len(part)]
            return np.bitwise_and(dn, dn.dtype.type(most), out=dn)

        runs = [[k % site.shape[1], k // site.shape[1], n_px] for k in first.tolist()]
        return Effect(truth={"kind": self.kind, "place": place, "runs": runs}, sent=sent)
