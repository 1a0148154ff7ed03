"""Times of a scenario file: the start, and the sampler of [time] or [encounter]."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from glrender_camera.validate import known_keys, one_of

from ...base.errors import ConfigError, error_path
from ..encounter import Encounter
from ..epochs import Epoch, needed
from ..instruments.images import PlacesAtImages
from ..paths import Trajectory
from ..samplers import EqualTurns, Exponential, FixedRate, Linear, Times, equal_turns
from .fields import a_table, made, with_scales

SAMPLER_KEYS = ("frames", "sampler", "slow_motion")
"""Fields of a sampler that [encounter] may have too."""
_SAMPLERS = {"linear": Linear, "exponential": Exponential, "equal_turns": EqualTurns}
_KEYS = (*SAMPLER_KEYS, "duration_s", "rate_hz", "times_s")


class TimeFields:
    """The table [time].

    Parameters
    ----------
    value : table

    Attributes
    ----------
    start : Epoch or None
    first : Epoch or None
        First of the epochs that are listed.
    """

    def __init__(self, value: object):
        table = a_table(value)
        # A time without a scale is refused as that, not as an unknown key.
        for stem in ("start", "epochs"):
            if stem in table:
                raise ConfigError(stem, "has no time scale", table[stem], f"write {' or '.join(with_scales(stem))}")
        known_keys("", table, (*_KEYS, *with_scales("start"), *with_scales("epochs")))
        self._epochs = _listed(table)
        self.start = Epoch.of_field(table, "start")
        self.first = self._epochs[0] if self._epochs else None
        self._table = {key: table[key] for key in _KEYS if key in table}

    def sampler(self, craft: Trajectory, start: Epoch | None, encounter: Mapping[str, Any]) -> Any:
        """The time sampler, of [encounter] where it has `frames`."""
        if isinstance(craft, PlacesAtImages):
            if self._table:
                raise ConfigError("time", "is given as well as ISDs, which have the times", sorted(self._table),
                                  "leave [time] out")
            return Times.of_epochs([image.epoch for image in craft.images], needed(start))
        own = {key: encounter[key] for key in (*SAMPLER_KEYS, "duration_s") if key in encounter}
        if "frames" in own:
            if self._table or self._epochs:
                raise ConfigError("time", "is given as well as frames in [encounter]", hint="give one")
            with error_path("encounter"):
                return _spread(own, craft, start)
        with error_path("time"):
            if self._epochs or "times_s" in self._table:
                if len(self._table) + bool(self._epochs) > 1:
                    raise ConfigError("", "gives times in two ways", sorted(self._table), "give one")
                return (Times.of_epochs(self._epochs, needed(start)) if self._epochs else made(Times, self._table))
            if not self._table and not isinstance(craft, Encounter):
                raise ConfigError("", "gives no times",
                                  hint="give duration_s with frames or rate_hz, times_s, or epochs_tdb")
            table = {**({"duration_s": craft.duration_s} if isinstance(craft, Encounter) else {}), **self._table}
            return made(FixedRate, table) if "rate_hz" in table else _spread(table, craft, start)


def _spread(table: dict[str, Any], craft: Trajectory, start: Epoch | None) -> Any:
    """A sampler that spreads a number of frames over a duration."""
    kind = one_of("sampler", table.pop("sampler", "linear"), _SAMPLERS)
    if kind == "equal_turns":
        if not isinstance(craft, Encounter) or craft.gravitational_parameter_m3_s2 > 0.0:
            return made(equal_turns, table, r_of=lambda t: craft.at(start, t)[0])
        table |= {"distance_m": craft.distance_m, "relative_velocity_m_s": craft.relative_velocity_m_s}
    return made(_SAMPLERS[kind], table)


def _listed(table: Mapping[str, Any]) -> list[Epoch]:
    """The epochs that [time] lists."""
    given = [name for name in with_scales("epochs") if name in table]
    if len(given) > 1:
        raise ConfigError(given[1], f"is given as well as {given[0]}", hint="give one")
    if not given:
        return []
    values, listed = table[given[0]], []
    if not isinstance(values, list) or not values:
        raise ConfigError(given[0], "must be a list that is not empty: a sequence has one frame at least", values)
    for index, value in enumerate(values):
        with error_path(f"{given[0]}[{index}]"):
            try:
                listed.append(Epoch.of_field({given[0]: value}, "epochs"))
            except ConfigError as error:
                error.path = ""
                raise
    return listed
