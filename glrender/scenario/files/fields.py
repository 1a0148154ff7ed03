"""The parts that all readers of a scenario file share: the objects known so far, and calls with a table's fields."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glrender_camera.validate import known_keys, one_of, text

from ...base.errors import ConfigError
from ...scene.scene import Scene
from ..epochs import EPOCH_SUFFIXES, Epoch
from ..instruments.isd import Isd
from ..paths import Trajectory
from ..scenario import SUN
from ..spice.kernels import Spice


@dataclass
class Known:
    """Objects that were read from a scenario file so far."""

    scene: Scene
    folder: Path
    start: Epoch | None = None
    duration_s: float = 0.0
    spice: Spice | None = None
    images: list[Isd] = field(default_factory=list)
    trajectories: dict[str, Trajectory] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Names of the bodies."""
        return [body.name for body in self.scene.bodies]

    def about(self, table: Mapping[str, Any]) -> str:
        """Name of the object that a trajectory is about: the first body by default."""
        return one_of("about", table.get("about", self.names[0]), [SUN, *self.names])

    def about_sun(self, name: str) -> Trajectory:
        """The trajectory of a body about the Sun."""
        path = self.trajectories.get(name)
        if path is not None and path.about == SUN:
            return path
        raise ConfigError("", f"needs an orbit of {name!r} about the Sun", hint="give its [bodies.orbit]")

    def kernels(self) -> Spice:
        """SPICE, where it was given."""
        if self.spice is None:
            raise ConfigError("", "needs [spice] with its kernels")
        return self.spice

    def file(self, table: Mapping[str, Any]) -> Path:
        """The path of a table's `file`."""
        return self.folder / text("file", table["file"])


def a_table(value: object) -> dict[str, Any]:
    """A copy of a table; another value is refused."""
    if not isinstance(value, Mapping):
        raise ConfigError("", "must be a table", value)
    return dict(value)


def taken_epoch(value: object, stem: str) -> tuple[dict[str, Any], Epoch | None]:
    """A table without the epoch of a stem, and that epoch."""
    table = a_table(value)
    epoch = Epoch.of_field(table, stem)
    return {key: entry for key, entry in table.items() if key not in with_scales(stem)}, epoch


def with_scales(stem: str) -> list[str]:
    """The fields of an epoch: `start` gives start_tdb, start_utc, start_et_s."""
    return [stem + suffix for suffix in EPOCH_SUFFIXES]


def made(make: Callable, value: object, **given: Any) -> Any:
    """Call with a table's fields, and with what was read already; fields that it does not know are refused by name."""
    table, parameters = a_table(value), parameters_of(make)
    known_keys("", table, [name for name in parameters if name not in given],
               required=[name for name, parameter in parameters.items()
                         if parameter.default is inspect.Parameter.empty and name not in given])
    return make(**table, **given)


def parameters_of(make: Callable) -> Mapping[str, inspect.Parameter]:
    """The parameters of a class or a function, by name."""
    return inspect.signature(make).parameters
