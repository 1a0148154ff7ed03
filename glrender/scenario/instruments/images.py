"""Trajectories and attitudes at the epochs of images, one ISD an image; between them there is nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import ConfigError
from ..attitude import Geometry
from ..epochs import Epoch, needed
from .isd import Isd

# Round-off of an epoch that was a time from the start.
_SAME_S = 1e-6


def read_images(paths: Sequence[Path], lens: Mapping[str, Any] | None = None) -> list[Isd]:
    """The images of ISD files, in the order of their epochs.

    Raises
    ------
    ConfigError
        Images of several sensors or bodies, or of one epoch.
    """
    images = [Isd.from_file(path, lens) for path in paths]
    for path, image in zip(paths, images, strict=True):
        if image.frames != images[0].frames:
            raise ConfigError(path.name, f"must be of the frames of {paths[0].name}, sensor and body "
                              f"{images[0].frames}", image.frames, "write a scenario for each")
    order = sorted(range(len(images)), key=lambda index: images[index].epoch)
    for before, index in zip(order, order[1:], strict=False):
        if not images[index].epoch - images[before].epoch > _SAME_S:
            raise ConfigError(paths[index].name, f"must not be of the epoch of {paths[before].name}",
                              images[index].epoch.tdb)
    return [images[index] for index in order]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacesAtImages:
    """The trajectory of the spacecraft or the Sun, at the epochs of images alone.

    Parameters
    ----------
    images : sequence of Isd
        In the order of their epochs.
    is_sun : bool
    about : str
        The body that the images are of.
    """

    images: Sequence[Isd]
    is_sun: bool
    about: str

    def at(self, start: Epoch | None, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities, as `Trajectory` has them; ConfigError at other times."""
        images = _at(self.images, start, t_s)
        pairs = [(image.r_sun_m, image.v_sun_m_s) if self.is_sun else (image.r_spacecraft_m, image.v_spacecraft_m_s)
                 for image in images]
        return np.array([r for r, _ in pairs]).reshape(-1, 3), np.array([v for _, v in pairs]).reshape(-1, 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudesAtImages:
    """The attitudes of the sensor or the body, at the epochs of images alone.

    Parameters
    ----------
    images : sequence of Isd
        In the order of their epochs.
    is_body : bool
    """

    images: Sequence[Isd]
    is_body: bool

    def at(self, geometry: Geometry, owner: str) -> tuple[np.ndarray, np.ndarray | None]:
        """Attitudes and rates, as `Attitude` has them; ConfigError at other times."""
        pairs = [(image.q_body_from_inertial, image.rates_body_rad_s) if self.is_body
                 else (image.q_sensor_from_inertial, image.rates_sensor_rad_s)
                 for image in _at(self.images, geometry.start, geometry.t_s)]
        rates = None if any(rate is None for _, rate in pairs) else np.array([rate for _, rate in pairs]).reshape(-1, 3)
        return np.array([q for q, _ in pairs]).reshape(-1, 4), rates


def _at(images: Sequence[Isd], start: Epoch | None, t_s: np.ndarray) -> list[Isd]:
    """The images at times [s] from a start."""
    from_start = np.array([image.epoch - needed(start) for image in images])
    nearest = [int(np.argmin(np.abs(from_start - t))) for t in t_s]
    for index, t in zip(nearest, t_s, strict=True):
        if not abs(from_start[index] - t) <= _SAME_S:
            raise ConfigError("time", f"must be an image's: the nearest is of {images[index].epoch.tdb} TDB",
                              f"{needed(start).after(float(t)).tdb} TDB", "ISDs have no state between images")
    return [images[index] for index in nearest]
