"""The faults of one frame: which of those asked for it has, and what they do to its charge and its numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import noise
from ..detector import MAX_SEED, Detector
from ..errors import ConfigError, error_path, shortened
from ..validate import integer, known_keys, one_of
from .fault import Effect, Fault, Site
from .light import DeadColumns, Dust, SatelliteCrossing, StuckExposure, SunBlinding
from .numbers import GarbledBytes, LostBlocks, LostLines, RepeatedLines, ShiftedLines

KINDS = {kind.kind: kind for kind in (LostLines, RepeatedLines, ShiftedLines, LostBlocks, DeadColumns, StuckExposure,
                                      SunBlinding, GarbledBytes, Dust, SatelliteCrossing)}
"""Faults by the name of their kind."""
MAX_FAULTS = 16
"""Most faults of a camera."""
# Longest text of a fault's place; `truth` has the whole place.
_MAX_CHARACTERS = 100
# Purposes of a fault's random numbers: whether a frame has it, where, and the noise of its light.
_WHETHER, _WHERE, _NOISE = range(3)


def checked_faults(name: str, value: object) -> tuple[Fault, ...]:
    """Faults out of a list of tables, each with its `kind`, or of faults.

    Raises
    ------
    ConfigError
        With the path of the field, as ``faults[1].n_lines``.
    """
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) > MAX_FAULTS:
        raise ConfigError(name, f"must be a list of at most {MAX_FAULTS} tables, each with a `kind`", value)
    return tuple(each if isinstance(each, Fault) else _fault(f"{name}[{index}]", each)
                 for index, each in enumerate(value))


def _fault(path: str, table: object) -> Fault:
    table = dict(known_keys(path, table, table, required=("kind",)))
    kind = KINDS[one_of(f"{path}.kind", table.pop("kind"), KINDS)]
    with error_path(path):
        return kind.from_dict(table)


class FrameFaults:
    """Faults that a frame has.

    Parameters
    ----------
    faults : sequence of Fault
        Asked for.
    seed : int
        The frame's.
    sensor_seed : int
        The detector's.
    """

    def __init__(self, faults: Sequence[Fault], seed: int, sensor_seed: int):
        self._seed, self._sensor_seed, self._n_asked = integer("seed", seed, 0, MAX_SEED), sensor_seed, len(faults)
        of_kind: Counter[str] = Counter()
        self._had: list[tuple[Fault, int]] = []
        for fault in faults:
            number = of_kind[fault.kind]
            of_kind[fault.kind] += 1
            # Each further fault of one kind has random numbers of its own.
            is_had = fault.stream(seed, number, _WHETHER).random() < fault.probability
            if is_had:
                self._had.append((fault, number))
        self._effects: list[tuple[Fault, int, Effect]] = []

    @property
    def exposure_s(self) -> float | None:
        """The exposure [s] that the shutter is stuck at, if it is."""
        return next((fault.exposure_s for fault, _ in self._had if isinstance(fault, StuckExposure)), None)

    def strike(self, signal_electrons: np.ndarray, detector: Detector) -> None:
        """Choose the places in a frame of these mean photo-electrons (H, W) float32 [e-]."""
        if self._had:
            site = Site(signal_electrons, detector)
            self._effects = [(fault, number, fault.of(fault.stream(
                self._sensor_seed if fault.is_fixed else self._seed, number, _WHERE), site))
                for fault, number in self._had]

    @property
    def truth(self) -> tuple[dict[str, Any], ...]:
        """Kind and place of each fault that the frame has, as plain data."""
        return tuple(effect.truth for _, _, effect in self._effects)

    @property
    def text(self) -> str:
        """The stage in words."""
        if not self._n_asked:
            return "skipped: none asked for"
        return "; ".join(f"{fault['kind']}: " + shortened(", ".join(
            f"{key} {value}" for key, value in fault.items() if key != "kind"), _MAX_CHARACTERS)
            for fault in self.truth) or f"none of {self._n_asked} in this frame"

    @property
    def changes_charge(self) -> bool:
        """Whether any fault adds or takes light."""
        return any(effect.added_electrons is not None or effect.kept is not None for _, _, effect in self._effects)

    def collect(self, charge: np.ndarray, photo: np.ndarray, dark: np.ndarray, response: np.ndarray | None) -> None:
        """Change the charge of a frame: all light is added first, then taken.

        Poisson numbers add, and those that are thinned at random are Poisson numbers: so no other pixel's noise, nor
        any other effect's, depends on a fault.

        Parameters
        ----------
        charge : (H, W) float32 [e-]
            Drawn; changed in place.
        photo, dark : (H, W) float32 [e-]
            Means of the light and of the rest that it was drawn of; `photo` is changed.
        response : (H, W) float32 [1], optional
        """
        # Light that falls where none is collected is lost, whatever the faults' order.
        for fault, number, effect in self._effects:
            if effect.added_electrons is not None:
                added = effect.added_electrons()
                added = added if response is None else added * response
                charge += noise.poisson(added, fault.key(self._seed, number, _NOISE))
                photo += added
        for fault, number, effect in self._effects:
            if effect.kept is not None:
                kept = effect.kept()
                here = kept < 1.0
                lost = 1.0 - kept[here].astype(np.float64)
                share = photo[here] / np.maximum(photo[here] + dark[here], np.float32(1e-30))
                rng = fault.stream(self._seed, number, _NOISE)
                charge[here] -= rng.binomial(charge[here].astype(np.int64), np.clip(lost * share, 0.0, 1.0))
                photo[here] *= kept[here]

    def sent(self, dn: np.ndarray) -> np.ndarray:
        """The digital numbers (H, W) that arrive."""
        for _, _, effect in self._effects:
            if effect.sent is not None:
                dn = effect.sent(dn)
        return dn
