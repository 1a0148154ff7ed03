"""Motion during an exposure: the times at which poses are drawn, and the warnings of what they leave out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from glrender_camera import PinholeCamera

from ..base.errors import ConfigError, SceneError
from ..scene.scene import Scene
from ..view.state import State
from .motion_path import MOST_INSTANTS, STILL_PX, Path, even_times, path_at, path_of

# Light is linear in time between poses: half a pixel apart they widen a blurred edge by 0.04 px2.
_STEP_PX = 0.5
MAX_POSES = 65
"""Most poses of a frame: 32 pixels of motion at half a pixel; longer motion is drawn in longer steps and warned of."""
MAX_GIVEN_POSES = 257
"""Most poses of a frame, where a request gives them."""
COARSE_PX = 1.0
"""Distance of poses [px] from which on a warning names it: an edge is then steps that a point spread function shows."""
# Poses of a motion back and forth, the fewest, and for each step of its extent: two sides of a turn.
_LEAST_SPREAD, _A_STEP = 9, 4
# Poses are exchanged so often, and for the mean and the spread of so many points.
_SWEEPS, _POINTS, _SEED = 3, 16, 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Times (N,) [s] of the poses to draw, after the state's; their states; and what they are, in words.

    `warning` says what they leave out, if anything.
    """

    times_s: np.ndarray
    text: str
    states: tuple[State, ...] = ()
    exposure_s: float = 0.0
    row_s: float = 0.0
    warning: str = ""

    @property
    def is_still(self) -> bool:
        """Whether one pose is enough."""
        return len(self.times_s) == 1


STILL = Motion(times_s=np.zeros(1), text="skipped: the state does not move")


def checked_sub_states(value: object) -> tuple[State, ...]:
    """Check `sub_states`: none, or 2 to 257 states of rising `t_s`.

    Raises
    ------
    ConfigError
    """
    if not isinstance(value, Sequence) or not all(isinstance(each, State) for each in value):
        raise ConfigError("sub_states", "must be a list of State", value)
    if len(value) == 1 or len(value) > MAX_GIVEN_POSES:
        raise ConfigError("sub_states", f"must be 2 to {MAX_GIVEN_POSES} states, or none", len(value))
    times = [each.t_s for each in value]
    if any(not a < b for a, b in pairwise(times)):
        raise ConfigError("sub_states", "t_s must rise", times[:8])
    return tuple(value)


def given_motion(state: State, sub_states: tuple[State, ...], exposure_s: float, row_s: float, n_rows: int) -> Motion:
    """The poses of a simulation instead of rates: their light is linear in time between them.

    Parameters
    ----------
    state : State
        At the middle of all rows' exposures.
    sub_states : tuple of State
        States of `checked_sub_states`; must span the exposures of all rows.
    exposure_s, row_s : float [s]
    n_rows : int
        Rows of the image with its margin.

    Raises
    ------
    ConfigError
    """
    times = np.array([each.t_s - state.t_s for each in sub_states])
    half_s = 0.5 * (exposure_s + abs(row_s) * (n_rows - 1))
    # t_s may be seconds of decades: float64 then has 1e-7 s.
    slack = 1e-9 * half_s + 4.0 * np.spacing(abs(state.t_s))
    if times[0] > -half_s + slack or times[-1] < half_s - slack:
        raise ConfigError("sub_states", f"t_s must span {state.t_s - half_s:.9g} to {state.t_s + half_s:.9g} s, the "
                          "exposures of all rows", (sub_states[0].t_s, sub_states[-1].t_s))
    times[0], times[-1] = min(times[0], -half_s), max(times[-1], half_s)
    return Motion(times_s=times, text=f"{len(times)} poses as given, over {2.0 * half_s:.3g} s",
                  exposure_s=exposure_s, row_s=row_s, states=sub_states)


def plan_motion(scene: Scene, state: State, camera: PinholeCamera, exposure_s: float, row_s: float,
                margin_px: int) -> Motion:
    """Choose the poses of a frame from the motion of its state: of its course, or at its rates.

    Poses are half a pixel apart. Of a motion back and forth that is faster they are as many as its extent needs, at
    times in step with no period, with the mean place and the spread of the whole motion.

    Parameters
    ----------
    scene : Scene
    state : State
        At the middle of the frame's exposure: of all its rows, where the shutter rolls.
    camera : PinholeCamera
        One of the scene's.
    exposure_s : float [s]
    row_s : float [s]
        Delay from row to row.
    margin_px : int [px]
        Rows that are drawn beyond the frame.
    """
    half_s = 0.5 * (exposure_s + abs(row_s) * (camera.height_px - 1 + 2 * margin_px))
    wide, unknown = camera.with_margin(margin_px), ""
    try:
        path = path_of(scene, state, wide, half_s)
    except (ConfigError, SceneError) as error:
        unknown = f"only known rates blur the frame: {error}"
        state = replace(state)
        path = path_of(scene, state, wide, half_s)
    if path.extent_px < STILL_PX:
        return Motion(times_s=np.zeros(1), text=f"skipped: {path.extent_px:.2g} px of motion", warning=unknown)
    length_px, extent_px, span = path.length_px, path.extent_px, f"in {2.0 * half_s:.3g} s"
    # Odd numbers: the middle one is the state itself.
    along = 2 * math.ceil(0.5 * length_px / _STEP_PX) + 1
    across = max(_LEAST_SPREAD, 2 * math.ceil(0.5 * _A_STEP * extent_px / _STEP_PX) + 1)
    n_poses, made = min(along, across, MAX_POSES), {"exposure_s": exposure_s, "row_s": row_s}
    if path.is_followed and (along <= n_poses or length_px <= 2.0 * extent_px):
        step_px = length_px / (n_poses - 1)
        bounded = "" if step_px <= _STEP_PX else f", at most {MAX_POSES} are drawn: {step_px:.2g} px from pose to pose"
        coarse = "" if step_px <= COARSE_PX else (
            f"motion of {length_px:.3g} px is drawn as {n_poses} poses, {step_px:.2g} px apart, that show as steps; a "
            "shorter exposure has none")
        times = even_times(n_poses, half_s)
        return Motion(times_s=times, states=tuple(state.at(times)), warning=unknown or coarse, **made,
                      text=f"{n_poses} poses, {length_px:.3g} px {span}{bounded}")
    if len(path.times_s) < MOST_INSTANTS:
        path = path_at(scene, state, wide, half_s)
    # A path that is not followed is longer than it is known to be.
    n_poses = max(n_poses, _LEAST_SPREAD)
    chosen = _chosen(path, n_poses)
    grain = "" if across <= MAX_POSES and not row_s else (
        f"motion back and forth over {extent_px:.3g} px, faster than the exposure, is drawn as {n_poses} of its poses: "
        "they have its mean and its spread, and leave out places between them, and differences from row to row; a "
        "shorter exposure has less")
    return Motion(times_s=path.times_s[chosen], states=tuple(path.states[k] for k in chosen), **made,
                  text=f"{n_poses} poses, back and forth over {extent_px:.3g} px {span}", warning=unknown or grain)


def _chosen(path: Path, n_poses: int) -> np.ndarray:
    """Numbers of the instants (n_poses,) whose mean place and spread are those of all.

    One of each share of the exposure, exchanged one after the other for the nearest; the ends and the state itself are
    among them.
    """
    times, last = path.times_s, len(path.times_s) - 1
    middle = int(np.flatnonzero(times == 0.0)[0])
    shares = np.array_split(np.setdiff1d(np.arange(1, last), [middle]), n_poses - 3)
    step = max(1, path.xy_px.shape[1] // _POINTS)
    xy = path.xy_px[:, ::step]
    xy = xy - xy.mean(axis=0)
    # Second moments in the unit of the first, and as large: over a fifth of the extent.
    unit_px = 0.2 * path.extent_px
    values = np.concatenate([xy, xy**2 / unit_px, xy[..., :1] * xy[..., 1:] / unit_px], axis=2)
    values = values.reshape(last + 1, -1)
    wanted = _weights(times) @ values
    # At random first: places at even distances may be in step with a motion that is exchanged one pose at a time.
    rng = np.random.default_rng(_SEED)
    taken = np.array([rng.choice(share) for share in shares])
    for _ in range(_SWEEPS):
        for k, share in enumerate(shares):
            choices = np.tile(taken, (len(share), 1))
            choices[:, k] = share
            whole = np.sort(np.pad(choices, [(0, 0), (3, 0)]) + np.pad([[0, middle, last]], [(0, 0), (0, len(taken))]),
                            axis=1)
            off = np.einsum("cn,cnv->cv", _weights(times[whole]), values[whole]) - wanted
            taken[k] = share[int(np.argmin((off**2).sum(axis=1)))]
    return np.sort(np.concatenate([[0, middle, last], taken]))


def _weights(times: np.ndarray) -> np.ndarray:
    """Weights (..., N) of light that is linear between times (..., N)."""
    half = 0.5 * np.diff(times, axis=-1)
    pad = [(0, 0)] * (times.ndim - 1)
    return (np.pad(half, [*pad, (0, 1)]) + np.pad(half, [*pad, (1, 0)])) / (times[..., -1:] - times[..., :1])
