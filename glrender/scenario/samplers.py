"""Time samplers: the times of the frames, in seconds from the scenario's start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import integer, positive

from ..base.errors import ConfigError
from .checks import MAX_DURATION_S, duration, length, numbers, speed
from .epochs import Epoch

MAX_FRAMES = 10_000_000
# sinh of more overflows no float64, but leaves no two times apart in the middle.
_MAX_SLOW_MOTION = 30.0
# Nodes, each a fraction of the turn apart, and how often they are spread anew: a pass as short as 1e-12 of the
# duration is found.
_NODES, _REFINEMENTS = 4001, 8


@dataclass(frozen=True, kw_only=True)
class Linear:
    """Frames at equal steps from 0 to the duration, both ends included; one frame is in the middle.

    Parameters
    ----------
    duration_s : float [s], > 0
    frames : int, 1..1e7
    """

    duration_s: float
    frames: int

    def __post_init__(self):
        object.__setattr__(self, "duration_s", duration("duration_s", self.duration_s))
        object.__setattr__(self, "frames", integer("frames", self.frames, 1, MAX_FRAMES))

    def t_s(self) -> np.ndarray:
        """(N,) float64 times [s], ascending."""
        if self.frames == 1:
            return np.array([0.5 * self.duration_s])
        return self.duration_s * np.arange(self.frames) / (self.frames - 1)


@dataclass(frozen=True, kw_only=True)
class Exponential(Linear):
    """Frames that crowd about the middle: steps at the ends are cosh(slow_motion) times those there.

    Parameters
    ----------
    duration_s, frames
        As for `Linear`.
    slow_motion : float [1], > 0..30

    Source: SISPO's exponential time sampler, t = T/2 sinh(s x) / sinh(s).
    """

    slow_motion: float = 2.0

    def __post_init__(self):
        Linear.__post_init__(self)
        object.__setattr__(self, "slow_motion", positive("slow_motion", self.slow_motion))
        if not self.slow_motion <= _MAX_SLOW_MOTION:
            raise ConfigError("slow_motion", f"must be at most {_MAX_SLOW_MOTION:g}", self.slow_motion)

    def t_s(self) -> np.ndarray:
        """(N,) float64 times [s], ascending."""
        from_middle = np.sinh(self.slow_motion * _places(self.frames)) / np.sinh(self.slow_motion)
        return 0.5 * self.duration_s * (1.0 + from_middle)


@dataclass(frozen=True, kw_only=True)
class EqualTurns(Linear):
    """Frames between which the line of sight turns by one angle, on a straight fly-by, nearest in the middle.

    Reconstruction from images wants it. With x in -1..1, t = d / v tan(x atan(v T / 2 d)).

    Parameters
    ----------
    duration_s, frames
        As for `Linear`.
    distance_m : float [m], > 0
        At the closest approach.
    relative_velocity_m_s : float [m/s], > 0
    """

    distance_m: float
    relative_velocity_m_s: float

    def __post_init__(self):
        Linear.__post_init__(self)
        object.__setattr__(self, "distance_m", length("distance_m", self.distance_m))
        object.__setattr__(self, "relative_velocity_m_s", speed("relative_velocity_m_s", self.relative_velocity_m_s))

    def t_s(self) -> np.ndarray:
        """(N,) float64 times [s], ascending."""
        ratio = 0.5 * self.relative_velocity_m_s * self.duration_s / self.distance_m
        return 0.5 * self.duration_s * (1.0 + np.tan(_places(self.frames) * np.arctan(ratio)) / ratio)


@dataclass(frozen=True, kw_only=True)
class FixedRate:
    """Frames at a rate from 0 on, as long as the duration lasts.

    Parameters
    ----------
    duration_s : float [s], > 0
    rate_hz : float [1/s], > 0
    """

    duration_s: float
    rate_hz: float

    def __post_init__(self):
        object.__setattr__(self, "duration_s", duration("duration_s", self.duration_s))
        object.__setattr__(self, "rate_hz", positive("rate_hz", self.rate_hz))
        if not self.duration_s * self.rate_hz < MAX_FRAMES:
            raise ConfigError("rate_hz", f"times duration_s must be below {MAX_FRAMES} frames", self.rate_hz)

    def t_s(self) -> np.ndarray:
        """(N,) float64 times [s], ascending."""
        # A frame that round-off would put behind the end is still one.
        return np.arange(int(np.floor(self.duration_s * self.rate_hz * (1.0 + 1e-12))) + 1) / self.rate_hz


@dataclass(frozen=True, kw_only=True, eq=False)
class Times:
    """Frames at given times.

    Parameters
    ----------
    times_s : (N,) float [s]
        From the scenario's start, strictly ascending, at least one.
    """

    times_s: Sequence[float]

    def __post_init__(self):
        times = numbers("times_s", self.times_s)
        if times.ndim != 1 or not times.size or not (np.abs(times) <= MAX_DURATION_S).all():
            raise ConfigError("times_s", f"must be a list of times within {MAX_DURATION_S:g} s that is not empty",
                              self.times_s)
        if not (np.diff(times) > 0.0).all():
            later = int(np.argmin(np.diff(times))) + 1
            raise ConfigError(f"times_s[{later}]", "must be later than the one before", float(times[later]))
        times.setflags(write=False)
        object.__setattr__(self, "times_s", times)

    @classmethod
    def of_epochs(cls, epochs: Sequence[Epoch], start: Epoch) -> Times:
        """The times of epochs, from a start."""
        return cls(times_s=[epoch - start for epoch in epochs])

    def t_s(self) -> np.ndarray:
        """(N,) float64 times [s], ascending."""
        return np.asarray(self.times_s)


def equal_turns(r_of: Callable[[np.ndarray], np.ndarray], *, duration_s: float, frames: int) -> Times:
    """Frames between which the line of sight turns by one angle, on any trajectory.

    Parameters
    ----------
    r_of : callable
        From times (N,) [s] after the start to positions (N, 3) [m] relative to the target.
    duration_s : float [s], > 0
    frames : int, 1..1e7

    Raises
    ------
    ConfigError
        A line of sight that does not turn.
    """
    even = Linear(duration_s=duration_s, frames=frames).t_s()
    t = np.linspace(0.0, even[-1] if frames > 1 else duration_s, max(_NODES, 2 * frames))
    for _ in range(_REFINEMENTS):
        r = r_of(t)
        before, after = r[:-1], r[1:]
        steps = np.arctan2(np.linalg.norm(np.cross(before, after), axis=1), np.einsum("ij,ij->i", before, after))
        turned = np.concatenate([[0.0], np.cumsum(steps)])
        if not turned[-1] > 0.0:
            raise ConfigError("sampler", "needs a line of sight that turns", "equal_turns", 'give "linear"')
        # A little of time itself keeps the nodes apart where nothing turns.
        place = turned / turned[-1] + 1e-9 * t / duration_s
        finer = np.interp(np.linspace(0.0, place[-1], len(t)), place, t)
        finer[0], finer[-1] = t[0], t[-1]
        t, last = finer, (place, t)
    place, nodes = last
    if frames == 1:
        return Times(times_s=[float(np.interp(0.5 * place[-1], place, nodes))])
    return Times(times_s=np.interp(np.linspace(0.0, place[-1], frames), place, nodes))


def _places(frames: int) -> np.ndarray:
    """Places -1..1 of frames; 0 of a single one. Symmetric to the last bit, so that the middle one is 0."""
    k = np.arange(frames)
    return (2.0 * k - (frames - 1)) / max(frames - 1, 1)
