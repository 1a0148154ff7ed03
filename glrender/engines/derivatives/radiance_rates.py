"""How fast the radiance of a body's facets changes, by differences of the float64 laws."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...base.errors import ConfigError
from ...brdf import Lambert, Law
from ...view.view import BodyView
from ..coverage import facet_loops
from ..coverage.facet_tables import FacetTables
from ..rays.mesh import cross, dot
from .moving_lines import sun_rates_body
from .parameters import Rates, numbers_of

# Step of directions [rad]: a law bends by half as much, and float64 leaves 1e-10 of its value.
_STEP_RAD = 1e-6
# Step of a law's number over the number, and at least [1].
_STEP, _LEAST_STEP = 1e-5, 1e-7


def radiance_rates(facets: FacetTables, view: BodyView, facet: np.ndarray, radiance: np.ndarray,
                   names: Sequence[str], rates: Rates) -> np.ndarray:
    """Rates (K, N) of the radiance of facets (N,), in 1/sr of the Sun's irradiance at 1 au.

    Parameters
    ----------
    facets : FacetTables
    view : BodyView
    facet : (N,) int
        Facets that face camera and Sun.
    radiance : (N,) float64
        Theirs.
    names : sequence of str
        Of the K parameters.
    rates : Rates
    """
    shading = Shading(facets, view, facet, radiance)
    # The camera in the body's frame: turns about the camera leave it where it is.
    camera_m, sun = -rates.shifts_m @ view.camera_from_body, sun_rates_body(rates, view)
    found = np.zeros((len(names), len(facet)))
    if camera_m.any() and not isinstance(shading.law, Lambert):
        found += camera_m @ shading.by_camera()
    if sun.any():
        found += sun @ shading.by_sun()
    for k, name in enumerate(names):
        number = name.removeprefix("law.")
        if number != name and number in numbers_of(shading.law):
            found[k] = shading.by_law(number)
    return found


class Shading:
    """The radiance (N,) of facets (N,), and its derivatives."""

    def __init__(self, facets: FacetTables, view: BodyView, facet: np.ndarray, radiance: np.ndarray):
        self._radiance, self._view, self.law = radiance, view, facets.surface.body.brdf
        self._normal = facets.normal.take(facet, axis=1).T
        self._to_camera = facet_loops.to_camera(facets.vertices_m, facets.corners, facet, view.r_camera_body_m)
        way_m = facets.corner_m(facet).mean(axis=0) - view.r_camera_body_m[:, None]
        self._range_m = np.sqrt(dot(way_m, way_m))

    def by_camera(self) -> np.ndarray:
        """Derivatives (3, N) [1/m] by the camera's place in the body's frame."""
        found = np.zeros_like(self._to_camera)
        for axis in _tangents(self._to_camera):
            value = self._value(self.law, to_camera=_turned(self._to_camera, axis))
            found += axis * ((value - self._radiance) / (_STEP_RAD * self._range_m))
        return found

    def by_sun(self) -> np.ndarray:
        """Derivatives (3, N) [1] by the direction towards the Sun in the body's frame."""
        to_sun, found = self._view.sun_direction_body[:, None], np.zeros_like(self._to_camera)
        for axis in _tangents(to_sun):
            value = self._value(self.law, to_sun=_turned(to_sun, axis)[:, 0])
            found += axis * ((value - self._radiance) / _STEP_RAD)
        return found

    def by_normal(self) -> np.ndarray:
        """Derivatives (3, N) [1] by the facets' normals."""
        found = np.zeros_like(self._to_camera)
        for axis in _tangents(self._normal.T):
            value = self._value(self.law, normal=_turned(self._normal.T, axis).T)
            found += axis * ((value - self._radiance) / _STEP_RAD)
        return found

    def by_law(self, name: str) -> np.ndarray:
        """Derivatives (N,) by a number of the law: to one side where the law takes no value on the other."""
        value = float(getattr(self.law, name))
        step = max(_STEP * abs(value), _LEAST_STEP)
        above, below = (_law_with(self.law, name, value + side * step) for side in (1.0, -1.0))
        if above is not None and below is not None:
            return (self._value(above) - self._value(below)) / (2.0 * step)
        side = 1.0 if above is not None else -1.0
        near, far = above or below, _law_with(self.law, name, value + 2.0 * side * step)
        if near is None or far is None:
            raise ConfigError(f"derivatives: law.{name}", "must be a number that the law takes on one side at least",
                              value, "leave it out")
        return side * (4.0 * self._value(near) - 3.0 * self._radiance - self._value(far)) / (2.0 * step)

    def _value(self, law: Law, to_sun: np.ndarray | None = None, to_camera: np.ndarray | None = None,
               normal: np.ndarray | None = None) -> np.ndarray:
        to_sun = self._view.sun_direction_body if to_sun is None else to_sun
        to_camera = self._to_camera if to_camera is None else to_camera
        normal = self._normal if normal is None else normal
        with warnings.catch_warnings():
            # The frame itself warns of phases beyond the law's.
            warnings.simplefilter("ignore")
            brdf = law.brdf(to_sun, to_camera.T, normal)
        return brdf * np.maximum(normal @ to_sun, 0.0) / self._view.sun_distance_au**2


def _law_with(law: Law, name: str, value: float) -> Law | None:
    """A law with another number; none where it does not take it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return replace(law, **{name: value})
    except ConfigError:
        return None


def _tangents(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3, N) perpendicular to directions (3, N) and to each other."""
    least = np.argmin(np.abs(direction), axis=0)
    first = cross(np.eye(3)[least].T, direction)
    first /= np.sqrt(dot(first, first))
    return first, cross(direction, first)


def _turned(direction: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Directions (3, N), a step towards others: of length 1 to half of its square, 5e-13."""
    return direction + _STEP_RAD * axis
