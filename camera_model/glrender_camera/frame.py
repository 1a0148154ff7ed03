"""The frame that the detector gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .notebook import png


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of the detector.

    Attributes
    ----------
    dn : (H, W) uint8 or uint16 [DN]
    electrons : (H, W) float32 [e-]
        Collected charge with all noise, before gain and rounding.
    saturated : (H, W) bool
        At full well or at the largest digital number.
    exposure_s : float [s]
    seed : int
    stages : dict of str to str
        Each stage, how it was modelled or why it was skipped, in the order of the light.
    faults : tuple of dict
        Kind and place of each fault that the frame has. `electrons` and `saturated` are the detector's: before lines,
        blocks or bytes are lost, and before compression.
    stream : bytes, optional
        The compressed frame, as it is sent; `dn` is then what the ground decodes from it.
    offset_DN : float [DN], optional
        Offset of the detector: black in pictures where no sky is seen.
    """

    dn: np.ndarray
    electrons: np.ndarray
    saturated: np.ndarray
    exposure_s: float
    seed: int
    stages: dict[str, str]
    faults: tuple[dict[str, Any], ...] = ()
    stream: bytes | None = None
    offset_DN: float | None = None

    @property
    def compressed_bytes(self) -> int | None:
        """Size of the stream [byte], or None without compression."""
        return None if self.stream is None else len(self.stream)

    @property
    def bits_per_pixel(self) -> float | None:
        """Size of the stream [bit/px], or None without compression."""
        return None if self.stream is None else 8.0 * len(self.stream) / self.dn.size

    def __repr__(self) -> str:
        height, width = self.dn.shape
        return (f"<Frame {width} x {height} px, {self.dn.dtype} [DN] {self.dn.min()} to {self.dn.max()}, "
                f"{self.exposure_s:.6g} s, {self.saturated.mean():.1%} saturated>")

    def _repr_png_(self) -> bytes:
        """For notebooks: the digital numbers in grey."""
        return png(self.dn, offset_DN=self.offset_DN)
