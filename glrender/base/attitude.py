"""Attitudes that other tools give, turned into glrender's `q_b_from_a`: [w, x, y, z], components in a to those in b.

SPICE's quaternions turn vectors, as glrender's do. Those of MATLAB's Aerospace Toolbox and of Basilisk turn frames:
they are the conjugates. Every function takes leading axes and returns w >= 0. Norms off unity by up to 1e-6 are
renormalised, by up to 1e-3 with a warning, for digits that were rounded; others are refused.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from glrender_camera.validate import near_unit, unit_vectors
from scipy.spatial.transform import Rotation

from .errors import ConfigError

_NORMALISE = "normalise [w, x, y, z] first"


def from_matlab_dcm(dcm_b_from_a: np.ndarray) -> np.ndarray:
    """The attitude of a direction cosine matrix of MATLAB's Aerospace Toolbox or Blockset.

    Parameters
    ----------
    dcm_b_from_a : (..., 3, 3) float [1]
        Matrix that `angle2dcm` and `quat2dcm` give, and `dcm2quat` takes: components in a to components in b. MATLAB's
        3 x 3 x M is `np.moveaxis(dcm, -1, 0)`.

    Returns
    -------
    (..., 4) float64
        `q_b_from_a`.

    Raises
    ------
    ConfigError
        A matrix whose rows are not orthonormal within 1e-3, or that mirrors.

    Source: Aerospace Toolbox, dcm2quat: "right-hand passive transformation from frame A to frame B".
    """
    return _of_matrices("dcm_b_from_a", _numbers("dcm_b_from_a", dcm_b_from_a, (3, 3)))


def from_matlab_quat(quat: np.ndarray) -> np.ndarray:
    """The attitude of a quaternion of MATLAB's Aerospace Toolbox or Blockset: its conjugate.

    Parameters
    ----------
    quat : (..., 4) float [1]
        Scalar first, from a to b, as `dcm2quat` and `angle2quat` give it. MATLAB's M x 4 is taken as it comes.

    Returns
    -------
    (..., 4) float64
        `q_b_from_a`.

    Raises
    ------
    ConfigError
        A norm farther from 1 than 1e-3.

    Source: Aerospace Toolbox, quat2dcm: its matrix has 2 (q1 q2 + q0 q3) in row 1, column 2.
    """
    return _canonical(unit_vectors("quat", _numbers("quat", quat, (4,)), _NORMALISE) * [1.0, -1.0, -1.0, -1.0])


def from_basilisk_mrp(sigma_BN: np.ndarray) -> np.ndarray:
    """The attitude of modified Rodrigues parameters of Basilisk: tan(angle / 4) times the axis.

    Parameters
    ----------
    sigma_BN : (..., 3) float [1]
        Of frame B relative to frame N, `scStateOutMsg.sigma_BN` for one; of either set, the short way or the long.

    Returns
    -------
    (..., 4) float64
        `q_b_from_n`: for a pose in `inertial`, its `q_from_inertial`.

    Raises
    ------
    ConfigError
        A number that is not finite.

    Source: Schaub and Junkins, Analytical Mechanics of Space Systems, section 3.5; Basilisk's MRP2C.
    """
    sigma = _numbers("sigma_BN", sigma_BN, (3,))
    with np.errstate(over="ignore"):
        length = np.linalg.norm(sigma, axis=-1, keepdims=True)
    # The shadow set -sigma / length^2 is the same rotation, and its squares do not overflow.
    outer = length > 1.0
    safe = np.where(outer, length, 1.0)
    sigma = np.where(outer, -sigma / safe / safe, sigma)
    squared = np.sum(sigma * sigma, axis=-1, keepdims=True)
    return _canonical(np.concatenate([1.0 - squared, -2.0 * sigma], axis=-1) / (1.0 + squared))


def from_spice(rotation: np.ndarray) -> np.ndarray:
    """The attitude of a rotation of SPICE, a matrix or a quaternion.

    Parameters
    ----------
    rotation : (..., 3, 3) or (..., 4) float [1]
        The matrix of `pxform(a, b, et)` or `ckgp`, or the quaternion that `m2q` makes of that matrix.

    Returns
    -------
    (..., 4) float64
        `q_b_from_a`.

    Raises
    ------
    ConfigError
        A matrix whose rows are not orthonormal within 1e-3, or that mirrors; a norm farther from 1 than 1e-3.

    Source: NAIF, Rotation Required Reading, "SPICE quaternions".
    """
    rotation = _numbers("rotation", rotation, (3, 3), (4,))
    if rotation.shape[-1] == 4:
        return _canonical(unit_vectors("rotation", rotation, _NORMALISE))
    return _of_matrices("rotation", rotation)


def from_scipy(rotation: Rotation) -> np.ndarray:
    """The attitude of a SciPy `Rotation` whose `apply` takes components in a to components in b.

    Parameters
    ----------
    rotation : scipy.spatial.transform.Rotation
        One, or a stack of N. Of a frame's axes, as `from_euler` builds them, it is the inverse that is meant.

    Returns
    -------
    (4,) or (N, 4) float64
        `q_b_from_a`.

    Raises
    ------
    ConfigError
        Another type: SciPy's quaternions are scalar last, and an array does not say so.
    """
    if not isinstance(rotation, Rotation):
        raise ConfigError("rotation", "must be a scipy Rotation", rotation, "of numbers take Rotation.from_quat(...)")
    return _canonical(rotation.as_quat(scalar_first=True))


def from_ros(orientation: object) -> np.ndarray:
    """The attitude of a ROS orientation of frame b in frame a: the conjugate, scalar first.

    Parameters
    ----------
    orientation : geometry_msgs Quaternion, or (..., 4) float [1]
        [x, y, z, w] of `Pose.orientation` of b in `header.frame_id` a, or of a transform with the parent a and the
        child b. (`lookup_transform(b, a)` gives the transform with the parent b: its result here is `q_a_from_b`.)

    Returns
    -------
    (..., 4) float64
        `q_b_from_a`.

    Raises
    ------
    ConfigError
        A norm farther from 1 than 1e-3.

    Source: geometry_msgs/Pose and TransformStamped; REP 103.
    """
    given: Any = orientation
    if all(hasattr(given, name) for name in "xyzw"):
        given = [given.x, given.y, given.z, given.w]
    q = unit_vectors("orientation", _numbers("orientation", given, (4,)), "normalise [x, y, z, w] first")
    return _canonical(np.roll(q, 1, axis=-1) * [1.0, -1.0, -1.0, -1.0])


def _of_matrices(name: str, matrices: np.ndarray) -> np.ndarray:
    off = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-1, -2))
    determinant = np.linalg.det(matrices)
    wrong = np.maximum(off, np.abs(determinant - 1.0))
    if wrong.size:
        index = np.unravel_index(np.argmax(wrong), wrong.shape)
        field, got = name + "".join(f"[{i}]" for i in index), matrices[index].tolist()
        if determinant[index] < 0.0 and off[index] < 0.5:
            raise ConfigError(field, "must be a rotation, but mirrors: its determinant is -1", got,
                              "turn one axis of a left-handed frame round")
        near_unit(field, float(wrong[index]), f"rows must be orthonormal within {{:g}}, are off by {wrong[index]:.3g}",
                  got, "give the rotation alone, without scale or shear")
    q = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    return _canonical(q.reshape(*matrices.shape[:-2], 4))


def _numbers(name: str, value: np.ndarray, *shapes: tuple[int, ...]) -> np.ndarray:
    """Finite float64 numbers whose last axes are of one of the shapes."""
    expected = " or ".join(f"(..., {', '.join(map(str, shape))})" for shape in shapes)
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise TypeError
    except (TypeError, ValueError):
        raise ConfigError(name, f"must be numbers of shape {expected}", value) from None
    if not any(array.shape[-len(shape):] == shape for shape in shapes):
        hint = "of MATLAB's 3 x 3 x M take np.moveaxis(array, -1, 0)" if array.shape[:2] == (3, 3) in shapes else ""
        raise ConfigError(name, f"must have shape {expected}", array.shape, hint)
    if not np.isfinite(array).all():
        raise ConfigError(name, "must be finite", value)
    return array.astype(np.float64)


def _canonical(q: np.ndarray) -> np.ndarray:
    """The sign with w >= 0, and no -0.0."""
    return np.where(q[..., :1] < 0.0, -q, q) + 0.0
