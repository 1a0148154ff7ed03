"""Estimators by name."""

from __future__ import annotations

from collections.abc import Callable

from .body import BelievedBody
from .brightness import Model, Sphere
from .camera import Camera
from .measurement import Estimator

ESTIMATORS: dict[str, Callable[[Camera, BelievedBody], Estimator]] = {
    estimator.name: estimator for estimator in (Sphere, Model)}
"""Name -> factory of a camera and a body."""
