"""The parameters that a frame may be differentiated by: their names, and how fast each moves bodies, Sun and camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from numbers import Real

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import did_you_mean

from ...base import rotations as frames
from ...base.errors import ConfigError
from ...brdf import Law
from ...scene.scene import Scene
from ...view.view import BodyView

COUNTS = {"spacecraft": 6, "sun": 2, "focal_length": 1}
"""Names of parameters that every scene has, and the number of derivatives of each."""
_BODY_COUNT = 6
# Sine of the Sun's angle from the camera's x axis up to which it counts as on it [1]: float64 leaves 13 digits there.
_ON_AXIS = 1e-3
# Shifts along the camera's axes, then turns about them.
_ALONG, _ABOUT = np.eye(6, 3), np.eye(6, 3, -3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rates:
    """Rates of K parameters: of one body's places in `camera`, of the Sun's direction, and of the focal length.

    Attributes
    ----------
    shifts_m : (K, 3) float64 [m]
        A point at r [m] moves by its shift + turn x r.
    turns_rad : (K, 3) float64 [rad]
        About the camera.
    sun_turns_rad : (K, 3) float64 [rad]
        By which the direction towards the Sun turns.
    focal_length_px : (K,) float64 [px]
    """

    shifts_m: np.ndarray
    turns_rad: np.ndarray
    sun_turns_rad: np.ndarray
    focal_length_px: np.ndarray

    @classmethod
    def of(cls, names: Sequence[str], view: BodyView, camera: PinholeCamera) -> Rates:
        """The rates of parameters by name, one after the other: all zero of those that only a law has."""
        return cls(**{field.name: np.concatenate([getattr(one, field.name) for one in (
            _rates(name, view, camera) for name in names)]) for field in fields(cls)})


def checked_derivatives(derivatives: Iterable[str], scene: Scene) -> tuple[str, ...]:
    """Names of parameters, each once.

    Raises
    ------
    ConfigError
        An unknown name, with a near one.
    """
    names = (derivatives,) if isinstance(derivatives, str) else derivatives
    if not isinstance(names, Iterable):
        raise ConfigError("derivatives", "must be names of parameters", derivatives, f"there are {_listed(scene)}")
    names, known = tuple(names), known_names(scene)
    for index, name in enumerate(names):
        if not isinstance(name, str) or name not in known:
            raise ConfigError(f"derivatives[{index}]", "must be the name of a parameter", name,
                              did_you_mean(name, known) or f"there are {_listed(scene)}")
        if name in names[:index]:
            raise ConfigError(f"derivatives[{index}]", "must be named once", name)
    return names


def known_names(scene: Scene) -> tuple[str, ...]:
    """Names of all parameters of a scene's frames."""
    of_laws = {f"law.{name}": None for body in scene.bodies for name in numbers_of(body.brdf)}
    return (*COUNTS, *(f"bodies.{body.name}" for body in scene.bodies), *of_laws)


def numbers_of(law: Law) -> tuple[str, ...]:
    """Names of a law's parameters that are numbers."""
    if not is_dataclass(law):
        return ()
    values = {field.name: getattr(law, field.name) for field in fields(law)}
    return tuple(name for name, value in values.items() if isinstance(value, Real) and not isinstance(value, bool))


def count_of(name: str) -> int:
    """The number of derivatives of a parameter."""
    return COUNTS.get(name, _BODY_COUNT if name.startswith("bodies.") else 1)


def each_of(names: Iterable[str]) -> list[str]:
    """The name of each derivative."""
    return [name for name in names for _ in range(count_of(name))]


def sun_axes(to_sun: np.ndarray) -> np.ndarray:
    """Directions (2, 3) in `camera` in which the direction (3,) towards the Sun moves.

    The camera's x axis made perpendicular to it, or the y axis where the Sun stands on that of x; and the one that is
    perpendicular to both.
    """
    axis = np.eye(3)[0 if np.hypot(*to_sun[1:]) > _ON_AXIS else 1]
    first = axis - to_sun * (axis @ to_sun)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(to_sun, first)])


def _rates(name: str, view: BodyView, camera: PinholeCamera) -> Rates:
    count = count_of(name)
    shifts, turns, sun_turns, stretch = *np.zeros((3, count, 3)), np.zeros(count)
    if name == "spacecraft":
        # About the spacecraft's origin: what stands still moves the other way.
        origin_m = -frames.dcm(camera.q_camera_from_spacecraft) @ camera.r_camera_spacecraft_m
        shifts, turns, sun_turns = np.cross(_ABOUT, origin_m) - _ALONG, -_ABOUT, -_ABOUT
    elif name == "sun":
        to_sun = view.camera_from_body @ view.sun_direction_body
        sun_turns = np.cross(to_sun, sun_axes(to_sun))
    elif name == "focal_length":
        stretch[:] = 1.0
    elif name == f"bodies.{view.name}":
        origin_m = -view.camera_from_body @ (view.r_camera_body_m + view.centre_m)
        shifts, turns = _ALONG - np.cross(_ABOUT, origin_m), _ABOUT
    return Rates(shifts_m=shifts, turns_rad=turns, sun_turns_rad=sun_turns, focal_length_px=stretch)


def _listed(scene: Scene) -> str:
    return ", ".join(known_names(scene))
