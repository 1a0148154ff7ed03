"""The on-board side of a loop: frames, believed states and measurements reach it, and nothing of the truth."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from glrender_navigation import ESTIMATORS, Estimator, Measurement, Navigator, sight

OF_FRAMES = {name: made for name, made in ESTIMATORS.items() if not hasattr(made, "directions_camera")}
"""The estimators that measure a camera's frames, by name; others measure an altimeter's ranges."""


class OnBoard:
    """The on-board software: an estimator of the believed scene, and a filter of position and velocity.

    Parameters
    ----------
    estimator : Estimator
        Of the believed camera and body.
    navigator : Navigator
        With the first estimate, relative to the body.
    render : callable
        Draws the believed scene, as `Estimator.measure` asks for it.

    Attributes
    ----------
    is_accepted : bool
        Whether the filter took the last frame's measurement in.
    """

    def __init__(self, estimator: Estimator, navigator: Navigator, render: Callable[..., Any]):
        self._estimator, self._navigator, self._render = estimator, navigator, render
        self.is_accepted, self._doubt = False, ""

    @property
    def r_m(self) -> np.ndarray:
        """Estimated position (3,) [m], from the body, inertial axes."""
        return self._navigator.r_m

    @property
    def v_m_s(self) -> np.ndarray:
        """Estimated velocity (3,) [m/s]."""
        return self._navigator.v_m_s

    @property
    def reason(self) -> str:
        """Why the last frame gave no measurement, or one that is not taken in; empty after one that may be."""
        return self._estimator.reason or self._doubt

    def take(self, frame: np.ndarray, believed: Any) -> Measurement | None:
        """Measure a frame and take the measurement in.

        Parameters
        ----------
        frame : (height, width) array
            Digital numbers.
        believed : State
            The spacecraft where it is estimated to be, all else by the believed ephemerides.
        """
        self.is_accepted = False
        found = self._estimator.measure(frame, believed, self._render)
        self._doubt = "" if found is None else found.doubt
        if found is not None and not found.doubt:
            camera = self._estimator.camera
            here = sight(believed, camera, self._estimator.body.name)
            pose = np.asarray(believed.spacecraft.r_inertial_m)
            body = np.asarray(believed.bodies[self._estimator.body.name].r_inertial_m)
            # The camera's place is what the sight leaves of the spacecraft's.
            lever_m = body - here.camera_from_inertial.T @ here.r_body_camera_m - pose
            self.is_accepted = self._navigator.update(found, here.camera_from_inertial, lever_m)
        return found

    def fly(self, acceleration_m_s2: np.ndarray, step_s: float) -> None:
        """Carry the estimate over a step with the acceleration (3,) that is known on board."""
        self._navigator.predict(acceleration_m_s2, step_s)
