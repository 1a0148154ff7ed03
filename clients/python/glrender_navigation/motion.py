"""Motion about a body: a place and a velocity carried over a step, with their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from .checks import refuse

# Relative error of each of the integrator's own steps; of places, of velocities and of their derivatives.
_TOLERANCE = 1e-11
# One orbit takes 150 to 600 evaluations: a step of more than some fifty orbits, or into the centre, is refused.
_MOST_EVALUATIONS = 20_000
# Columns of the integrated state: the motion, and its derivatives by the first place, velocity and the acceleration.
_MOTION, _BY_FIRST, _BY_ACCELERATION = 0, slice(1, 7), slice(7, 10)


class Carried(NamedTuple):
    """A motion after a step: place and velocity (6,) [m, m/s], and their derivatives.

    `transition` (6, 6) is by the first place and velocity, `gain` (6, 3) by an acceleration that is constant over the
    step.
    """

    motion: np.ndarray
    transition: np.ndarray
    gain: np.ndarray


def carried(motion: np.ndarray, acceleration_m_s2: np.ndarray, step_s: float, gm_m3_s2: float) -> Carried:
    """A motion about a point mass after a step, with the derivatives of the variational equations.

    Parameters
    ----------
    motion : (6,) float [m, m/s]
        First place and velocity, from the mass, inertial axes.
    acceleration_m_s2 : (3,) float [m/s2]
        Besides gravity, constant over the step.
    step_s : float [s]
    gm_m3_s2 : float [m3/s2]

    Raises
    ------
    ValueError
        The motion goes through the mass within the step, or round it too often.

    Source: Hairer, Norsett and Wanner (1993), Solving Ordinary Differential Equations I: DOP853, by SciPy.
    """
    # Lengths in first distances, times in steps: one tolerance suits all.
    unit_m = float(np.linalg.norm(motion[:3]))
    units = np.repeat([unit_m, unit_m / step_s], 3) if step_s > 0.0 else np.ones(6)
    gm, acceleration = gm_m3_s2 * step_s**2 / unit_m**3, acceleration_m_s2 * step_s**2 / unit_m
    begin = np.column_stack([motion / units, np.eye(6), np.zeros((6, 3))])
    too_far = refuse("step_s", "must not lead through the body's centre, or round it more than some fifty times",
                     step_s, "take shorter steps; an estimate that falls into the centre has diverged")
    evaluations = 0

    def rates(_: float, flat: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        evaluations += 1
        now = flat.reshape(6, 10)
        r = now[:3, _MOTION]
        square = float(r @ r)
        if evaluations > _MOST_EVALUATIONS or not square > 0.0:
            raise too_far
        pull = gm / square**1.5
        bent = -pull * now[:3]
        bent[:, 1:] += np.outer(3.0 * pull / square * r, r @ now[:3, 1:])
        bent[:, _MOTION] += acceleration
        bent[:, _BY_ACCELERATION] += np.eye(3)
        return np.concatenate([now[3:], bent]).ravel()

    if step_s == 0.0:
        return Carried(motion.copy(), np.eye(6), np.zeros((6, 3)))
    solved = solve_ivp(rates, (0.0, 1.0), begin.ravel(), method="DOP853", rtol=_TOLERANCE, atol=_TOLERANCE,
                       first_step=1.0)
    end = solved.y[:, -1].reshape(6, 10)
    if not solved.success or not np.isfinite(end).all():
        raise too_far
    return Carried(units * end[:, _MOTION], units[:, None] * end[:, _BY_FIRST] / units,
                   units[:, None] * end[:, _BY_ACCELERATION] * step_s**2 / unit_m)
