"""Extended Kalman filter of position and velocity about a body, and of the error of its believed size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from .checks import array, number, refuse
from .measurement import Measurement
from .motion import carried

# Three sigma of three axes: chi-square of 3 degrees of freedom at 99.73 %.
_GATE = 14.156
# After so many refusals in a row the estimate itself is doubted.
_MOST_REFUSED = 3


class Innovation(NamedTuple):
    """How far a measurement was from its prediction: `squared` in sigmas, 3 on average where all sigmas are right."""

    r_inertial_m: np.ndarray
    squared: float
    is_accepted: bool


class Navigator:
    """Extended Kalman filter of position and velocity about the body, inertial axes, and of its size's error.

    Ranges by apparent size err all alike where the believed size is wrong: no mean over frames helps, but an altimeter
    added to them does.

    Parameters
    ----------
    r_m, v_m_s : (3,) float
        First estimate.
    sigma_r_m, sigma_v_m_s : float
        Its standard deviations.
    gm_m3_s2 : float [m3/s2], optional
        Gravity of the body, as of a point.
    process_acceleration_m_s2 : float [m/s2], optional
        Standard deviation of accelerations that are not modelled, constant over a step.
    thruster_error : float [1], optional
        Standard deviation of a commanded acceleration, relative to its largest component.
    sigma_size : float [1], optional
        Standard deviation of the believed size, relative; 0 where it is exact.
    is_gated : bool, optional
        Whether measurements beyond three sigma are refused; after three in a row the covariance grows fourfold.

    Raises
    ------
    ValueError
        With the field: a value that is no number, a standard deviation below zero, or a place in the body's origin.
    """

    def __init__(self, r_m: np.ndarray, v_m_s: np.ndarray, *, sigma_r_m: float, sigma_v_m_s: float,
                 gm_m3_s2: float = 0.0, process_acceleration_m_s2: float = 2e-6, thruster_error: float = 0.02,
                 sigma_size: float = 0.0, is_gated: bool = True):
        r_m, v_m_s = array("r_m", r_m, (3,), "give metres"), array("v_m_s", v_m_s, (3,), "give metres a second")
        if not r_m.any():
            raise refuse("r_m", "must not be the origin of the body", r_m, "give the spacecraft's place about the body")
        sigma_r_m, sigma_v_m_s, sigma_size, self._gm_m3_s2, self._process_m_s2, self._thruster_error = (
            number(name, value, "0 is exact, or none", is_zero_allowed=True) for name, value in (
                ("sigma_r_m", sigma_r_m), ("sigma_v_m_s", sigma_v_m_s), ("sigma_size", sigma_size),
                ("gm_m3_s2", gm_m3_s2), ("process_acceleration_m_s2", process_acceleration_m_s2),
                ("thruster_error", thruster_error)))
        self._x = np.concatenate([r_m, v_m_s, [0.0]])
        self._covariance = np.diag([sigma_r_m**2] * 3 + [sigma_v_m_s**2] * 3 + [sigma_size**2])
        self._is_gated, self._n_refused = is_gated, 0
        self.innovations: list[Innovation] = []

    @property
    def r_m(self) -> np.ndarray:
        """Estimated position [m] of the spacecraft about the body."""
        return self._x[:3].copy()

    @property
    def v_m_s(self) -> np.ndarray:
        """Estimated velocity [m/s]."""
        return self._x[3:6].copy()

    @property
    def size_error(self) -> tuple[float, float]:
        """Estimated excess [1] of ranges by apparent size, as of the believed size, and its standard deviation."""
        return float(self._x[6]), float(self._covariance[6, 6]**0.5)

    @property
    def covariance(self) -> np.ndarray:
        """(6, 6), of position [m] and velocity [m/s]."""
        return self._covariance[:6, :6].copy()

    def predict(self, acceleration_m_s2: np.ndarray, step_s: float) -> None:
        """Carry the estimate along its orbit, with the commanded acceleration (3,) and the body's gravity.

        The step is integrated (DOP853), and the covariance by the orbit's own transition matrix: one long step is as
        exact as many short ones. Accelerations that are not modelled count as constant over the step.

        Raises
        ------
        ValueError
            With the field: an acceleration that is no number, a step below zero, or one that leads through the body's
            centre or round it more than some fifty times; the estimate stays.
        """
        acceleration_m_s2 = array("acceleration_m_s2", acceleration_m_s2, (3,), "give zeros where none is commanded")
        step_s = number("step_s", step_s, "a filter goes forward in time", is_zero_allowed=True)
        end = carried(self._x[:6], acceleration_m_s2, step_s, self._gm_m3_s2)
        sigma = np.hypot(self._process_m_s2, self._thruster_error * np.abs(acceleration_m_s2).max())
        transition = block_diag(end.transition, 1.0)
        self._x = np.append(end.motion, self._x[6])
        self._covariance = transition @ self._covariance @ transition.T
        self._covariance[:6, :6] += sigma**2 * end.gain @ end.gain.T

    def update(self, measurement: Measurement, camera_from_inertial: np.ndarray,
               r_camera_inertial_m: np.ndarray = (0.0, 0.0, 0.0)) -> bool:
        """Take a measurement in, if it is within three sigma of its prediction.

        Parameters
        ----------
        measurement : Measurement
        camera_from_inertial : (3, 3) float
            Attitude of the camera.
        r_camera_inertial_m : (3,) float [m], optional
            From the spacecraft's centre to the camera.

        Returns
        -------
        bool
            Whether it was taken in; `innovations` has a line for each.
        """
        camera_from_inertial = array("camera_from_inertial", camera_from_inertial, (3, 3), "give a rotation matrix")
        mount_m = array("r_camera_inertial_m", r_camera_inertial_m, (3,), "give metres, inertial axes")
        arm_m = self._x[:3] + mount_m
        excess = 1.0 + self._x[6] if measurement.is_by_size else 1.0
        expected = -camera_from_inertial @ arm_m * excess
        r_camera, noise = measurement.place(float(np.linalg.norm(expected)))
        # The noise has the axes of the expected line of sight: those of the measured one err together with it.
        turn = _turn(r_camera, expected)
        noise = camera_from_inertial.T @ turn @ noise @ turn.T @ camera_from_inertial
        innovation = -camera_from_inertial.T @ r_camera - arm_m * excess
        sensitivity = np.zeros((3, 7))
        sensitivity[:, :3] = excess * np.eye(3)
        if measurement.is_by_size:
            sensitivity[:, 6] = arm_m
        inverse = np.linalg.inv(sensitivity @ self._covariance @ sensitivity.T + noise)
        squared = float(innovation @ inverse @ innovation)
        is_accepted = not self._is_gated or squared <= _GATE
        self.innovations.append(Innovation(innovation, squared, is_accepted))
        if not is_accepted:
            self._n_refused += 1
            if self._n_refused >= _MOST_REFUSED:
                self._covariance *= 4.0
            return False
        self._n_refused = 0
        gain = self._covariance @ sensitivity.T @ inverse
        # Joseph's form: it stays symmetric and positive over thousands of updates.
        left = np.eye(7) - gain @ sensitivity
        self._x = self._x + gain @ innovation
        self._covariance = left @ self._covariance @ left.T + gain @ noise @ gain.T
        return True


def _turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The least rotation (3, 3) that takes the direction of a to that of b."""
    return Rotation.align_vectors(b[None] / np.linalg.norm(b), a[None] / np.linalg.norm(a))[0].as_matrix()
