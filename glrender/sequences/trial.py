"""A trial of a sequence or data set: a few of its frames are drawn, and nothing is kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..base.errors import ConfigError
from ..renderer import open_renderer
from ..scene.scene import Scene
from ..view.state import State
from .formats import FrameFile, header_path, write
from .options import FrameOptions
from .sequence import captured, file_ending, frame_file, paths_of_state
from .warned import counted

Measured = Callable[[int, State, FrameFile], int]
"""Bytes of a frame on disk, of its number, state and file."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Figures of N frames that were tried.

    Attributes
    ----------
    indices : tuple of int
        Numbers of the frames.
    unit : str
    exposure_s : (N,) float [s]
        Without an entry for irradiance.
    least, greatest : (N,) float [unit]
        Pixels of each frame.
    saturated_share : (N,) float [1]
        Of the lit pixels; without an entry for irradiance.
    n_dark : int
        Frames without light of a body or coma.
    processor_s : float [s]
        Median of a frame; the first one also opens caches.
    n_bytes : float
        Mean of a frame on disk; NaN where it cannot be written.
    problem : str
        The reason for which frames cannot be written; empty else.
    warnings : dict
        As of `counted`.
    """

    indices: tuple[int, ...]
    unit: str
    exposure_s: np.ndarray
    least: np.ndarray
    greatest: np.ndarray
    saturated_share: np.ndarray
    n_dark: int
    processor_s: float
    n_bytes: float
    problem: str
    warnings: Mapping[str, Mapping[str, Any]]


def chosen(states: Sequence[State], body: str, n_frames: int) -> tuple[int, ...]:
    """Numbers of some states, evenly in the order of their ranges from a body, the nearest and the farthest with them.

    Parameters
    ----------
    states : sequence of State
    body : str
    n_frames : int, > 0
        At most.
    """
    range_m = [np.linalg.norm(state.spacecraft.r_inertial_m - state.bodies[body].r_inertial_m) for state in states]
    order = np.argsort(range_m, kind="stable")
    places = np.rint(np.linspace(0, len(states) - 1, min(n_frames, len(states)))).astype(int)
    return tuple(sorted(order[np.unique(places)].tolist()))


def tried(scene: Scene, states: Sequence[State], options: FrameOptions, n_frames: int,
          measured: Measured | None = None) -> Trial:
    """Draw some frames of a sequence or data set as it would, one after the other.

    Parameters
    ----------
    scene : Scene
    states : sequence of State
        All states.
    options : FrameOptions
    n_frames : int, > 0
        At most.
    measured : callable, optional
        Bytes of a frame; those of its file in the options' format by default.

    Raises
    ------
    ConfigError
        With the number of the frame that cannot be drawn.
    """
    indices = chosen(states, scene.bodies[0].name, n_frames)
    with open_renderer(scene, options.backend) as renderer, TemporaryDirectory(prefix="glrender-trial-") as folder:
        path = Path(folder, f"frame.{file_ending(scene.camera(options.camera), options)}")
        rows = [_row(renderer, index, states[index:index + 2], options, measured or _written(path))
                for index in indices]
    of_frames = {name: np.array([row[name] for row in rows if row[name] is not None]) for name in (
        "exposure_s", "least", "greatest", "saturated_share")}
    return Trial(indices=indices, unit=options.unit, n_dark=sum(not row["has_light"] for row in rows), **of_frames,
                 processor_s=float(np.median([row["processor_s"] for row in rows])),
                 n_bytes=float(np.mean([row["n_bytes"] for row in rows])), problem=rows[0]["problem"],
                 warnings=counted(row["header"] for row in rows))


def _row(renderer: Any, index: int, states: Sequence[State], options: FrameOptions, measured: Measured
         ) -> dict[str, Any]:
    """What is known of a frame, of its state and the next one's."""
    began, (state, *following) = time.process_time(), states
    with paths_of_state(index):
        capture = captured(renderer, index, state, options)
        file = frame_file(renderer.scene, index, state, options, capture, tuple(following))
    n_bytes, problem = np.nan, ""
    try:
        n_bytes = measured(index, state, file)
    except ConfigError as error:
        problem = str(error)
    lit, frame = capture.irradiance_W_m2 > 0.0, capture.frame
    return {"processor_s": time.process_time() - began, "n_bytes": n_bytes, "problem": problem, "header": file.header,
            "has_light": lit.any(), "least": file.pixels.min(), "greatest": file.pixels.max(),
            "exposure_s": None if frame is None else frame.exposure_s,
            "saturated_share": None if frame is None else float(frame.saturated[lit].mean()) if lit.any() else 0.0}


def _written(path: Path) -> Measured:
    """Bytes of a frame as a sequence writes it."""
    def measured(index: int, state: State, file: FrameFile) -> int:
        write(path, file)
        return sum(each.stat().st_size for each in (path, header_path(path)) if each.exists())

    return measured
