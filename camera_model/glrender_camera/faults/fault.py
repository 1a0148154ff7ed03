"""The base of all faults: their fields, their own random numbers, and the places where they may be."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property, partial
from typing import Any, ClassVar

import cv2
import numpy as np

from .. import noise
from ..detector import Detector
from ..errors import ConfigError
from ..pattern import FAULT, stream
from ..validate import integer, known_keys, one_of, within

MAX_FAULT_SEED = 2**32 - 1
PLACES = ("random", "limb")
"""Places of a fault: anywhere, or on the lit edge of the largest body in the frame, where it hurts most."""
# Share of the brightest pixel below full well that is light of a body, not the wing of its point spread function.
_LIT_SHARE = 0.02
# Width of the neighbourhood that separates the limb, a step of light, from the terminator, a slope.
_STEP_PX = 7


def whole(default: int, low: int, high: int) -> Any:
    """A field that holds an integer from `low` to `high`."""
    return field(default=default, metadata={"check": partial(integer, low=low, high=high)})


def number(default: float, low: float, high: float) -> Any:
    """A field that holds a number from `low` to `high`."""
    return field(default=default, metadata={"check": partial(within, low=low, high=high)})


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A fault's changes of one frame.

    Attributes
    ----------
    truth : dict
        The kind and the place, as plain data.
    added_electrons : callable, optional
        Mean photo-electrons (H, W) float32 [e-] of light that is there besides.
    kept : callable, optional
        Share (H, W) float32 [1] of the light that is left.
    sent : callable, optional
        Makes the digital numbers (H, W) that arrive of those that were read.
    """

    truth: dict[str, Any]
    added_electrons: Callable[[], np.ndarray] | None = None
    kept: Callable[[], np.ndarray] | None = None
    sent: Callable[[np.ndarray], np.ndarray] | None = None


class Site:
    """The frame that a fault falls on: mean photo-electrons (H, W) float32 [e-], and the detector behind them."""

    def __init__(self, signal_electrons: np.ndarray, detector: Detector):
        self.signal_electrons, self.detector, self.shape = signal_electrons, detector, signal_electrons.shape

    @cached_property
    def limb(self) -> np.ndarray:
        """Pixels (N, 2) int [px], x and y, on the bright edge of the largest lit region; none in darkness."""
        light = np.minimum(self.signal_electrons, np.float32(self.detector.full_well_electrons))
        peak = float(light.max(initial=0.0))
        if not peak > 0.0:
            return np.empty((0, 2), int)
        lit = (light > _LIT_SHARE * peak).astype(np.uint8)
        outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        edge = max(outlines, key=cv2.contourArea).reshape(-1, 2)
        # The frame's border cuts a body off: that is no limb.
        edge = edge[((edge > 0) & (edge < np.array(self.shape[::-1]) - 1)).all(axis=1)]
        if not len(edge):
            return edge
        bright = cv2.dilate(light, np.ones((_STEP_PX, _STEP_PX), np.uint8))[edge[:, 1], edge[:, 0]]
        return edge[bright >= 0.5 * bright.max()]

    def pixels(self, rng: np.random.Generator, place: str, n: int, beyond: float = 0.0) -> tuple[np.ndarray, str]:
        """Chosen pixels (n, 2) int [px], x and y, and the place where they are: "random" where there is no limb.

        Random ones may be `beyond` the frame by that share of its sides.
        """
        if place == "limb" and len(self.limb):
            return self.limb[rng.integers(len(self.limb), size=n)], "limb"
        size = np.array(self.shape[::-1])
        return np.floor((rng.random((n, 2)) * (1.0 + 2.0 * beyond) - beyond) * size).astype(int), "random"

    def offsets(self, x: int, y: int) -> tuple[np.ndarray, np.ndarray]:
        """Offsets (W,) and (H, 1) float32 [px] of the pixels from a place."""
        return (np.arange(self.shape[1], dtype=np.float32) - np.float32(x),
                (np.arange(self.shape[0], dtype=np.float32) - np.float32(y))[:, None])


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault that frames may have.

    Parameters
    ----------
    probability : float [1], 0..1
        That a frame has it; each frame's seed decides.
    place : "random" or "limb"
        Anywhere, or on the bright edge of the largest lit body; random where nothing is lit, and always of a fault
        that is fixed to the sensor.
    seed : int, 0..2**32 - 1
        Another seed puts the fault elsewhere. A fault that is fixed to the sensor stands where this and the
        detector's `sensor_seed` put it, any other where this and the frame's seed do.

    Raises
    ------
    ConfigError
    """

    kind: ClassVar[str]
    is_fixed: ClassVar[bool] = False

    probability: float = number(1.0, 0.0, 1.0)
    place: str = field(default="random", metadata={"check": partial(one_of, allowed=PLACES)})
    seed: int = whole(0, 0, MAX_FAULT_SEED)

    def __post_init__(self):
        for each in fields(self):
            object.__setattr__(self, each.name, each.metadata["check"](each.name, getattr(self, each.name)))
        if self.is_fixed and self.place != "random":
            raise ConfigError("place", f"must be \"random\": {self.kind} stays where it is while the limb moves",
                              self.place, "leave `place` out; another `seed` moves it")

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Fault:
        """From plain data without its `kind`; unknown keys are refused by name."""
        known_keys("", table, [each.name for each in fields(cls)],
                   required=[each.name for each in fields(cls) if each.default is MISSING])
        return cls(**table)

    def stream(self, seed: int, *key: int) -> np.random.Generator:
        """Random numbers of this kind and seed alone, so that no fault changes another's, or the detector's noise."""
        return stream(seed, *self._purpose, *key)

    def key(self, seed: int, *key: int) -> np.ndarray:
        """Key of `noise` for random numbers that are this kind's and seed's alone."""
        return noise.key_of(seed, *self._purpose, *key)

    @property
    def _purpose(self) -> tuple[int, int, int]:
        return FAULT, zlib.crc32(self.kind.encode()), self.seed

    def of(self, rng: np.random.Generator, site: Site) -> Effect:
        """The fault's changes of a frame."""
        raise NotImplementedError
