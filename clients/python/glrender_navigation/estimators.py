"""Estimators by name."""

from __future__ import annotations

from collections.abc import Callable

from .all_pixels import AllPixels
from .altimeter import Altimeter
from .body import BelievedBody
from .brightness import Model, Sphere
from .camera import Camera
from .horizon import LimbEllipse
from .landmarks import Landmarks
from .limb import LimbShape
from .measurement import Estimator
from .pose import PoseByFeatures
from .templates import Templates

ESTIMATORS: dict[str, Callable[[Camera, BelievedBody], Estimator]] = {
    estimator.name: estimator for estimator in (
        Sphere, Model, LimbEllipse, LimbShape, Templates, Landmarks, PoseByFeatures, AllPixels, Altimeter)}
"""Name -> factory of a camera and a body."""
