"""The derivatives of a frame's irradiance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class Jacobian(Mapping[str, np.ndarray]):
    """Derivatives of an image's irradiance by the parameters that were asked for.

    ``jacobian[name]`` is (k, h, w) float32 of the region `roi`, outside which it is zero:
    ``spacecraft`` and ``bodies.NAME`` [W/m2/m] along the camera's x, y and z and [W/m2/rad] about them, by the right
    hand, through the origin of the spacecraft or the body; ``sun`` [W/m2/rad]; ``focal_length`` [W/m2/px];
    ``law.NAME`` per unit of that number, of every body whose law has it.

    Attributes
    ----------
    roi : (int, int, int, int) [px]
        x0, y0, x1, y1, one past the last.
    arrays : dict of str to (k, h, w) float32 array
    ranges_m : dict of str to float [m]
        Of ``spacecraft`` and ``bodies.NAME``: from the camera to the body, or to the nearest one in view.
    sun_axes : (2, 3) float64 [1]
        Directions in `camera` in which ``sun`` moves the direction towards the Sun: the camera's x axis made
        perpendicular to it (y where the Sun stands on x), and the direction perpendicular to both.
    """

    roi: tuple[int, int, int, int]
    arrays: dict[str, np.ndarray]
    ranges_m: dict[str, float]
    sun_axes: np.ndarray

    def moved(self, across_px: int, down_px: int) -> Jacobian:
        """The same in an image that begins so far to the left and above."""
        if not any(self.roi):
            return self
        x0, y0, x1, y1 = self.roi
        return replace(self, roi=(x0 + across_px, y0 + down_px, x1 + across_px, y1 + down_px))

    def label(self, name: str, k: int) -> str:
        """The name of one parameter: ``spacecraft[0]``, or ``focal_length`` where there is one alone."""
        return f"{name}[{k}]" if len(self[name]) > 1 else name

    def whole(self, chosen: Sequence[tuple[str, int]], shape: tuple[int, int]) -> np.ndarray:
        """Chosen derivatives (K, height, width) float32 of all of an image's pixels."""
        found, (x0, y0, x1, y1) = np.zeros((len(chosen), *shape), np.float32), self.roi
        for number, (name, k) in enumerate(chosen):
            found[number, y0:y1, x0:x1] = self[name][k]
        return found

    def each(self, name: str) -> list[tuple[str, int]]:
        """All of a name's, as `whole` takes them."""
        return [(name, k) for k in range(len(self[name]))]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.arrays[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrays)

    def __len__(self) -> int:
        return len(self.arrays)
