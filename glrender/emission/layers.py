"""The fields of a coma, made once and again when the Sun has moved, each with its measured errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..base.errors import ConfigError
from ..engines.rays.exact_rays import exact_mesh
from ..scene.shape.shape import Shape
from .bake import SphericalBake
from .fields import CartesianField, Field, SphericalField
from .measuring import FieldErrors, Hits, measured_errors, worst
from .sources.source import OwnField, Source

# Activity is that of the Sun's nearest node: half a degree at most away, cos(incidence) within 1 % of its largest.
_SUN_NODES = 64
# Where the Sun stands when errors are measured: what a frame uses depends on no frame before it.
_HALF_AXES = np.vstack([np.eye(3), -np.eye(3)])
# Largest weight, beyond any comet by 1e15: its columns stay far within float32.
_GREATEST_M = 1e20
# How far out errors are measured, in body radii, where a field has no end.
_FAR_RADII = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """One field, the models in it, and what steps and nodes do to it."""

    field: Field
    models: tuple[str, ...]
    errors: FieldErrors
    volume: OwnField | None = None

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
        Each a `Source` or of an `OwnField`.
    shape : Shape
    """

    def __init__(self, sources: Sequence[Source | OwnField], shape: Shape):
        if shape.centre_m.any():
            raise ConfigError("shape", "must be around the origin of the body that has a coma", shape.centre_m.tolist(),
                              "move the shape there")
        distance = np.linalg.norm(shape.vertices_m, axis=1)
        body_radius_m = (float(distance.min()), float(distance.max()))
        # Outside the outline, where the coma is seen to its end, rays pass at about that distance.
        self.radius_m = float(np.median(distance))
        self._nearest_m = max(body_radius_m[0], 0.05 * body_radius_m[1])
        self._hits = body_hits(shape)
        volumes = [source for source in sources if isinstance(source, OwnField)]
        around = [source for source in sources if not isinstance(source, OwnField)]
        self._bake = SphericalBake(around, body_radius_m)
        self.least_m = self._bake.least_m
        self._measured = self._measured_by_axis()
        self._fixed = tuple(self._fixed_layer(volume) for volume in volumes)
        self._sun, self._around = None, ()

    def _fixed_layer(self, volume: OwnField) -> Layer:
        field = volume.field(self.least_m)
        return Layer(field=field, models=(type(volume).__name__.lower(),), volume=volume,
                     errors=self._errors(field)[0])

    def _measured_by_axis(self) -> list[tuple[FieldErrors, ...]]:
        """The errors of each field around the body, with the Sun on each half axis."""
        by_axis = [[field for field, _ in self._bake.fields(axis)] for axis in _HALF_AXES]
        made = []
        for fields in zip(*by_axis, strict=True):
            values = [field.values_m for field in fields]
            if all(np.array_equal(other, values[0]) for other in values):
                made.append(self._errors(fields[0]) * len(fields))
            else:
                made.append(self._errors(replace(fields[0], values_m=np.stack(values, axis=-1))))
        return made

    def _errors(self, field: Field) -> tuple[FieldErrors, ...]:
        if not (np.isfinite(field.values_m).all() and field.values_m.max() <= _GREATEST_M):
            raise ConfigError("emission", f"dust must have k r^2 of at most {_GREATEST_M:g} m",
                              float(field.values_m.max()), "see the sources' strengths")
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
            around = self._bake.fields(sun / np.linalg.norm(sun))
            self._around = tuple(Layer(field=field, models=models, errors=self._errors_beside(sun, by_axis))
                                 for (field, models), by_axis in zip(around, self._measured, strict=True))
        return (*self._around, *self._fixed)

    @staticmethod
    def _errors_beside(sun: np.ndarray, by_axis: Sequence[FieldErrors]) -> FieldErrors:
        """The worst with the Sun on one of the half axes around it: one of these lights all that the Sun can light."""
        return worst([errors for axis, errors in zip(_HALF_AXES, by_axis, strict=True) if axis @ sun > 0.0])


def body_hits(shape: Shape) -> Hits:
    """Distances along rays at which they first meet a shape."""
    mesh, back_m = exact_mesh(shape), 4.0 * float(np.linalg.norm(shape.vertices_m, axis=1).max())
    return lambda place_m, direction: mesh.hit(place_m - back_m * direction, direction)[1] - back_m
