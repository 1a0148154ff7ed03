"""Settings of a coma: dust around one body, as a `[[emission]]` table of a scene asks for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glrender_camera.validate import known_keys, text

from ..base.errors import ConfigError, error_path
from ..scene.scene import Body
from .dust import Dust
from .phase_function import phase_function
from .tables import MODELS

_KEYS = ("body", "dust", "has_shadow", "sources")
_DUST_KEYS = ("geometric_albedo", "phase_function", "extinction_efficiency")


@dataclass(frozen=True, kw_only=True, eq=False)
class ComaSettings:
    """Dust around one body.

    Parameters
    ----------
    body : str
        Its name.
    sources : sequence
        `sources.Source`s and `sources.Volume`s, whose dust adds up.
    dust : Dust
    has_shadow : bool
        Whether bodies cast shadows through it.
    """

    body: str
    sources: Sequence[Any]
    dust: Dust = field(default_factory=Dust)
    has_shadow: bool = False

    def __post_init__(self):
        text("body", self.body)
        if not isinstance(self.dust, Dust):
            raise ConfigError("dust", "must be a Dust", self.dust)
        if not isinstance(self.has_shadow, bool):
            raise ConfigError("has_shadow", "must be true or false", self.has_shadow)
        object.__setattr__(self, "sources", tuple(self.sources))
        if not self.sources:
            raise ConfigError("sources", "must have at least one member")

    @classmethod
    def from_table(cls, table: Mapping[str, Any], resolve: Callable[[str, object], Path],
                   bodies: Mapping[str, Body]) -> ComaSettings:
        """From a scene's table: `docs/coma.md`.

        Raises
        ------
        ConfigError
            With the field's path in the table.
        """
        known_keys("", table, _KEYS, required=("body", "sources"))
        name = text("body", table["body"])
        if name not in bodies:
            raise ConfigError("body", f"must be one of {', '.join(bodies)}", name)
        with error_path("dust"):
            dust_table = dict(known_keys("", table.get("dust", {}), _DUST_KEYS))
            if "phase_function" in dust_table:
                with error_path("phase_function"):
                    dust_table["phase_function"] = phase_function(dust_table["phase_function"])
            dust = Dust(**dust_table)
        entries = table["sources"]
        if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
            raise ConfigError("sources", "must be a list of tables that is not empty", entries)
        made = []
        for index, entry in enumerate(entries):
            with error_path(f"sources[{index}]"):
                model = entry.get("model") if isinstance(entry, Mapping) else entry
                if not isinstance(entry, Mapping) or not isinstance(model, str) or model not in MODELS:
                    raise ConfigError("model", f"must be one of {', '.join(MODELS)}", model)
                rest = {key: value for key, value in entry.items() if key != "model"}
                made.append(MODELS[model](rest, bodies[name], dust, resolve))
        return cls(body=name, sources=made, dust=dust, has_shadow=table.get("has_shadow", False))

    @property
    def dims(self) -> bool:
        """Whether what stands behind or in it loses light."""
        return self.dust.extinction_efficiency > 0.0
