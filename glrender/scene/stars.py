"""The sky behind the bodies: which stars a scene has."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from glrender_camera import StarCatalogue, hipparcos
from glrender_camera.validate import within

from ..base.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Stars:
    """Hipparcos' stars; needs the extra `stars`.

    Parameters
    ----------
    magnitude_limit : float [mag], -2..14
        Faintest V. The catalogue is complete to about 7.3.
    year : float [yr], 1900..2100
        Julian year of the frames, for the proper motion. `inertial` is ICRS.
    aberration : bool
        Whether stars are where the moving spacecraft sees them; a state must then carry the spacecraft's
        `v_inertial_m_s`, its velocity relative to the Sun.

    Raises
    ------
    ConfigError
        Also when the catalogue's package is not installed.
    """

    magnitude_limit: float
    year: float
    aberration: bool = False

    def __post_init__(self):
        object.__setattr__(self, "magnitude_limit", within("magnitude_limit", self.magnitude_limit, -2.0, 14.0))
        object.__setattr__(self, "year", within("year", self.year, 1900.0, 2100.0))
        if not isinstance(self.aberration, bool):
            raise ConfigError("aberration", "must be true or false", self.aberration)
        try:
            self.catalogue  # noqa: B018 (a missing catalogue is an error at load)
        except ConfigError as error:
            error.path = ""
            raise

    @cached_property
    def catalogue(self) -> StarCatalogue:
        """The stars at `year`."""
        found = hipparcos(self.magnitude_limit)
        return StarCatalogue(found.directions(self.year), 0.0 * found.motion_per_year, found.v_magnitude, found.b_v,
                             self.year)
