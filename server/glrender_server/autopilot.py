"""The demo's on-board software: centre of brightness, a Kalman filter, and a path to follow.

It knows the body's mean radius, the Sun's direction and its own attitude, and nothing else of
the truth. Gravity of a body this small moves a spacecraft by less than the thrusters' error
over one step and is left to the filter's process noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_PROCESS_ACCELERATION_M_S2 = 2e-6


@dataclass(frozen=True)
class Measurement:
    """A body found in a frame."""

    center_px: tuple[float, float]
    direction_camera: np.ndarray
    range_m: float
    diameter_px: float


class CenterFinder:
    """Centre and range of a body out of one frame.

    The centre of brightness of a sunlit sphere is off its centre towards the Sun; the offset of a
    Lambert sphere, 3 pi / 16 * sin(g) (1 + cos g) / (sin g + (pi - g) cos g) radii, is taken back
    (photometry: closed form). The number of lit pixels gives the apparent radius, the lit
    part of a disc being (1 + cos g) / 2.

    Parameters
    ----------
    focal_length_px : float [px]
    principal_point_px : (float, float) [px]
    radius_m : float [m]
        Mean radius of the body.
    """

    def __init__(self, *, focal_length_px: float, principal_point_px: tuple[float, float], radius_m: float):
        self._focal_length_px, self._radius_m = focal_length_px, radius_m
        self._principal_point_px = np.array(principal_point_px)

    def __call__(self, pixels: np.ndarray, sun_direction_camera: np.ndarray) -> Measurement | None:
        """Measure a frame (H, W) of digital numbers; None where no body stands out of the noise."""
        values = pixels.astype(np.float64)
        background = np.median(values)
        noise = 1.4826 * np.median(np.abs(values - background)) + 1.0
        signal = np.where(values > background + 6.0 * noise, values - background, 0.0)
        lit_px = np.count_nonzero(signal)
        if lit_px < 4:
            return None
        rows, columns = np.nonzero(signal)
        weight = signal[rows, columns]
        brightness_px = np.array([np.average(columns, weights=weight), np.average(rows, weights=weight)])
        direction = self._direction(brightness_px)
        phase = np.arccos(np.clip(-direction @ sun_direction_camera, -1.0, 1.0))
        radius_px = np.sqrt(lit_px / np.pi / max(0.5 * (1.0 + np.cos(phase)), 0.05))
        offset = (3.0 * np.pi / 16.0) * np.sin(phase) * (1.0 + np.cos(phase)) / (
            np.sin(phase) + (np.pi - phase) * np.cos(phase))
        sunward = sun_direction_camera[:2]
        length = np.linalg.norm(sunward)
        center_px = brightness_px - (offset * radius_px / length * sunward if length > 1e-9 else 0.0)
        return Measurement(center_px=tuple(center_px), direction_camera=self._direction(center_px),
                           range_m=self._focal_length_px * self._radius_m / radius_px,
                           diameter_px=2.0 * radius_px)

    def sigma(self, measurement: Measurement) -> tuple[float, float]:
        """Standard deviations: direction [rad] and range [1, relative], of an irregular body seen as a sphere.

        The errors of one frame stay for many, until the body has turned: so they count for more
        than their size, and most of all that of the range.
        """
        radius_rad = 0.5 * measurement.diameter_px / self._focal_length_px
        return 0.3 * radius_rad + 0.5 / self._focal_length_px, 0.3

    def _direction(self, pixel: np.ndarray) -> np.ndarray:
        ray = np.append((pixel - self._principal_point_px) / self._focal_length_px, 1.0)
        return ray / np.linalg.norm(ray)


class Navigator:
    """Kalman filter of position and velocity about the body, inertial axes.

    Parameters
    ----------
    r_m, v_m_s : (3,) float
        First estimate.
    sigma_r_m, sigma_v_m_s : float
        Its standard deviations.
    """

    def __init__(self, r_m: np.ndarray, v_m_s: np.ndarray, *, sigma_r_m: float, sigma_v_m_s: float):
        self._x = np.concatenate([r_m, v_m_s])
        self._covariance = np.diag([sigma_r_m**2] * 3 + [sigma_v_m_s**2] * 3)

    @property
    def r_m(self) -> np.ndarray:
        """Estimated position [m]."""
        return self._x[:3]

    @property
    def v_m_s(self) -> np.ndarray:
        """Estimated velocity [m/s]."""
        return self._x[3:]

    def predict(self, acceleration_m_s2: np.ndarray, step_s: float) -> None:
        """Carry the estimate over one step with the commanded acceleration."""
        transition = np.eye(6)
        transition[:3, 3:] = step_s * np.eye(3)
        gain = np.concatenate([0.5 * step_s**2 * np.eye(3), step_s * np.eye(3)])
        self._x = transition @ self._x + gain @ acceleration_m_s2
        sigma = _PROCESS_ACCELERATION_M_S2 + 0.02 * np.abs(acceleration_m_s2).max()
        self._covariance = transition @ self._covariance @ transition.T + sigma**2 * gain @ gain.T

    def update(self, direction_inertial: np.ndarray, range_m: float, sigma: tuple[float, float]) -> None:
        """Take in where the body was seen: the measured position is minus range times direction.

        Parameters
        ----------
        direction_inertial : (3,) float
            Unit vector from the spacecraft to the body.
        range_m : float [m]
        sigma : (float [rad], float [1])
            Of the direction, and of the range relative to itself.
        """
        along = np.outer(direction_inertial, direction_inertial)
        noise = (sigma[0] * range_m) ** 2 * (np.eye(3) - along) + (sigma[1] * range_m) ** 2 * along
        innovation = -range_m * direction_inertial - self._x[:3]
        gain = self._covariance[:, :3] @ np.linalg.inv(self._covariance[:3, :3] + noise)
        self._x = self._x + gain @ innovation
        self._covariance = self._covariance - gain @ self._covariance[:3, :]


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
