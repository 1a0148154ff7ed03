"""The fields of a coma, made once and again when the Sun has moved, each with its measured errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..shape import Shape
from .bake import SphericalBake
from .fields import CartesianField, Field, SphericalField
from .hits import body_hits
from .measuring import FieldErrors, measured_errors

# Activity is that of the Sun's nearest node: half a degree at most away, cos(incidence) within 1 % of its largest.
_SUN_NODES = 64
# How far out errors are measured, in body radii, where a field has no end.
_FAR_RADII = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """One field, the models in it, and what steps and nodes do to it."""

    field: Field
    models: tuple[str, ...]
    errors: FieldErrors
    volume: Any = None

    @property
    def is_spherical(self) -> bool:
        return isinstance(self.field, SphericalField)

    def field_from_body(self, body_from_inertial: np.ndarray, sun_direction_body: np.ndarray) -> np.ndarray:
        """(3, 3) float64 rotation into the field's axes."""
        return np.eye(3) if self.volume is None else self.volume.field_from_body(body_from_inertial,
                                                                                 sun_direction_body)


class Layers:
    """All fields of a coma.

    Parameters
    ----------
    sources : sequence
        Sources, and volumes (whatever has a `field`).
    shape : Shape
    """

    def __init__(self, sources: Sequence[Any], shape: Shape):
        distance = np.linalg.norm(shape.vertices_m, axis=1)
        body_radius_m = (float(distance.min()), float(distance.max()))
        # Beside the outline, where the coma is seen to its end, rays pass at about that distance.
        self.radius_m = float(np.median(distance))
        self._nearest_m = max(body_radius_m[0], 0.05 * body_radius_m[1])
        self._hits = body_hits(shape)
        volumes = [source for source in sources if hasattr(source, "field")]
        around = [source for source in sources if not hasattr(source, "field")]
        self._bake = SphericalBake(around, body_radius_m)
        self.least_m = self._bake.least_m
        self._spherical_errors: dict[tuple[str, ...], FieldErrors] = {}
        self._fixed = tuple(self._fixed_layer(volume) for volume in volumes)
        self._sun, self._around = None, ()

    def _fixed_layer(self, volume: Any) -> Layer:
        field = volume.field(self.least_m)
        return Layer(field=field, models=(type(volume).__name__.lower(),), volume=volume,
                     errors=self._errors(field))

    def _errors(self, field: Field) -> FieldErrors:
        return measured_errors(field, (self._nearest_m, self.radius_m, self._far(field)), self._hits)

    def _far(self, field: Field) -> float:
        """Distance [m] to which rays are worth measuring."""
        if isinstance(field, CartesianField):
            return max(0.5 * float(np.max(np.maximum(np.abs(field.low_m), np.abs(field.high_m)))),
                       1.5 * self.radius_m)
        return max(min(0.5 * field.radius_m, _FAR_RADII * self.radius_m), 1.5 * self.radius_m)

    def at(self, sun_direction_body: np.ndarray) -> tuple[Layer, ...]:
        """The layers with the Sun in a direction; the same objects until it leaves its node."""
        face = sun_direction_body / np.abs(sun_direction_body).max()
        sun = np.round(face * _SUN_NODES) / _SUN_NODES
        if self._sun is None or not np.array_equal(sun, self._sun):
            self._sun = sun
            self._around = tuple(self._layer(field, models)
                                 for field, models in self._bake.fields(sun / np.linalg.norm(sun)))
        return (*self._around, *self._fixed)

    def _layer(self, field: SphericalField, models: tuple[str, ...]) -> Layer:
        # What the Sun changes is how strong components are, not how fine.
        if models not in self._spherical_errors:
            self._spherical_errors[models] = self._errors(field)
        return Layer(field=field, models=models, errors=self._spherical_errors[models])
