"""The demo's guidance: a path to follow, and the acceleration that brings an estimate back onto it."""

from __future__ import annotations

import numpy as np


class ReferencePath:
    """Approach along a line, then a slow arc round the body.

    Parameters
    ----------
    radius_m : float [m]
        Of the body's bounding sphere.
    sun_direction : (3,) float
    n_steps : int
    step_s : float [s]
    fill : float
        Range over diameter at which the body fills half of the frame.
    """

    def __init__(self, *, radius_m: float, sun_direction: np.ndarray, n_steps: int, step_s: float, fill: float):
        self._duration_s = n_steps * step_s
        self._near_m, self._far_m = 4.0 * radius_m * fill, 12.0 * radius_m * fill
        # Start 25 degrees from the sub-solar line and end at about 100.
        side = np.cross([0.0, 0.0, 1.0], sun_direction)
        side /= np.linalg.norm(side)
        self._axes = np.stack([sun_direction, side, np.cross(sun_direction, side)])

    def __call__(self, t_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and velocity [m/s] on the path."""
        step = 1e-4 * self._duration_s
        before, after = self._position(t_s - step), self._position(t_s + step)
        return self._position(t_s), (after - before) / (2.0 * step)

    def _position(self, t_s: float) -> np.ndarray:
        progress = t_s / self._duration_s
        approach = np.clip(progress / 0.4, 0.0, 1.0)
        smooth = approach**2 * (3.0 - 2.0 * approach)
        distance = self._far_m * (self._near_m / self._far_m) ** smooth
        angle = np.radians(25.0 + 75.0 * np.clip((progress - 0.3) / 0.7, 0.0, 1.0) ** 2 * 1.0)
        tilt = 0.25 * np.sin(2.0 * np.pi * progress)
        return distance * (np.array([np.cos(angle), np.sin(angle), tilt]) / np.hypot(1.0, tilt)) @ self._axes

    def steer(self, t_s: float, r_m: np.ndarray, v_m_s: np.ndarray) -> np.ndarray:
        """Acceleration [m/s2] that brings an estimated state back onto the path in a tenth of the flight."""
        horizon_s = 0.1 * self._duration_s
        r_path, v_path = self(t_s)
        _, v_next = self(t_s + 0.01 * self._duration_s)
        feed_forward = (v_next - v_path) / (0.01 * self._duration_s)
        return feed_forward + 4.0 * (r_path - r_m) / horizon_s**2 + 4.0 * (v_path - v_m_s) / horizon_s
