"""The demo's on-board software: centre of brightness, a Kalman filter, and a path to follow.

It knows the body's shape or mean radius, its rotation, the Sun's direction and its own attitude, and
nothing else of the truth. Gravity of a body this small moves a spacecraft by less than the thrusters' error
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
    sigma: tuple[float, float]
    """Standard deviations: of the direction [rad], and of the range relative to itself."""


class CenterFinder:
    """Centre and range of a body out of one frame, by centre of brightness and number of lit pixels.

    Both depend on the phase angle. As a sphere: the centre of brightness of a Lambert sphere is off
    its centre towards the Sun by 3 pi / 16 sin(g) (1 + cos g) / (sin g + (pi - g) cos g) radii, and
    the lit part of its disc is (1 + cos g) / 2. By prediction: a frame rendered for the estimated
    state has the same offsets, shape and shadows included.

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

    def as_sphere(self, pixels: np.ndarray, sun_direction_camera: np.ndarray) -> Measurement | None:
        """Measure a frame (H, W) of digital numbers by the closed form; None where no body stands out of the noise."""
        found = _lit(pixels)
        if found is None:
            return None
        brightness_px, n_lit = found
        direction = self._direction(brightness_px)
        phase = np.arccos(np.clip(-direction @ sun_direction_camera, -1.0, 1.0))
        radius_px = np.sqrt(n_lit / np.pi / max(0.5 * (1.0 + np.cos(phase)), 0.05))
        offset = (3.0 * np.pi / 16.0) * np.sin(phase) * (1.0 + np.cos(phase)) / (
            np.sin(phase) + (np.pi - phase) * np.cos(phase))
        sunward = sun_direction_camera[:2]
        length = np.linalg.norm(sunward)
        center_px = brightness_px - (offset * radius_px / length * sunward if length > 1e-9 else 0.0)
        # The errors of an irregular body stay for many frames, until it has turned: they count for
        # more than their size.
        return self._measurement(center_px, self._focal_length_px * self._radius_m / radius_px,
                                 0.3 * radius_px / self._focal_length_px, 0.3)

    def by_prediction(self, pixels: np.ndarray, predicted: np.ndarray, range_m: float) -> Measurement | None:
        """Measure a frame against the one rendered for the estimated state, the body on the principal point.

        Parameters
        ----------
        pixels, predicted : (H, W)
            Digital numbers.
        range_m : float [m]
            Estimated.
        """
        found, expected = _lit(pixels), _lit(predicted)
        if found is None or expected is None:
            return None
        shift_px = found[0] - expected[0]
        # A prediction far off is worth less: the body is seen from another side.
        return self._measurement(self._principal_point_px + shift_px, range_m * np.sqrt(expected[1] / found[1]),
                                 (0.5 + 0.1 * np.linalg.norm(shift_px)) / self._focal_length_px, 0.02)

    def _measurement(self, center_px: np.ndarray, range_m: float, sigma_rad: float,
                     sigma_range: float) -> Measurement:
        return Measurement(center_px=tuple(center_px), direction_camera=self._direction(center_px), range_m=range_m,
                           sigma=(sigma_rad, sigma_range))

    def _direction(self, pixel: np.ndarray) -> np.ndarray:
        ray = np.append((pixel - self._principal_point_px) / self._focal_length_px, 1.0)
        return ray / np.linalg.norm(ray)


def _lit(pixels: np.ndarray) -> tuple[np.ndarray, int] | None:
    """Centre of brightness [px] and number of the pixels above the dark sky by six digital numbers."""
    # The body may fill most of the frame: the sky is its darkest twentieth.
    sky = np.float32(np.quantile(pixels[::4, ::4], 0.05))
    values = np.maximum(pixels, sky, dtype=np.float32) - sky
    values[values <= 6.0] = 0.0
    n_lit = int(np.count_nonzero(values))
    if n_lit < 4:
        return None
    of_columns, of_rows = values.sum(axis=0, dtype=np.float64), values.sum(axis=1, dtype=np.float64)
    return np.array([np.average(np.arange(len(sums)), weights=sums) for sums in (of_columns, of_rows)]), n_lit


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
