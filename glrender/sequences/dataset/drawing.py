"""Draws the frames of one shard, in a process of this machine or in one elsewhere."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from ...renderer import open_renderer
from ...scene.scene import Scene
from ...view.state import State
from ..header import same_version
from ..options import FrameOptions
from ..sequence import drawn, paths_of_state
from .shards import FORMATS, Files

Frames = list[tuple[int, State | None]]
"""Numbers and states of the frames of a shard; None where the setup has them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """Set-up of a process: the scene, the options, the format, the version that asks, and states with courses."""

    scene: Scene
    options: FrameOptions
    format: str
    version: str
    states: Sequence[State] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Shard:
    """A shard as it comes from a process: its files, its labels (JSON lines), processor seconds, the OpenGL."""

    files: Files
    labels: bytes
    processor_s: float
    renderer: str


# A process has its renderer, and the setup that it was opened for.
_opened: tuple[Setup, Any] | None = None
_setup: Setup | None = None
# OpenGL stays on its thread, whichever of a Dask worker's threads asks.
_thread = ThreadPoolExecutor(1)


def start(setup: Setup) -> None:
    """Begin a process of this machine."""
    global _setup
    _setup = setup
    _renderer_of(setup)


def stop() -> None:
    """End what `start` began, where the process goes on."""
    global _opened, _setup
    if _opened is not None:
        _opened[1].close()
    _opened = _setup = None


def draw_here(number: int, frames: Frames) -> Shard:
    """Draw a shard in a process that `start` began."""
    return _draw(_setup, number, frames)


def draw_elsewhere(setup: Setup, number: int, frames: Frames) -> Shard:
    """Draw a shard in a process that others began.

    Raises
    ------
    ConfigError
        Another version of glrender there.
    """
    same_version(setup.version)
    return _thread.submit(_draw, setup, number, frames).result()


def _renderer_of(setup: Setup) -> Any:
    global _opened
    if _opened is None or _opened[0] is not setup:
        if _opened is not None:
            _opened[1].close()
        _opened = (setup, open_renderer(setup.scene, setup.options.backend))
    return _opened[1]


def _draw(setup: Setup, number: int, frames: Frames) -> Shard:
    began, renderer = time.process_time(), _renderer_of(setup)
    made = FORMATS[setup.format].writer(setup.scene, setup.options, number)
    lines = []
    for index, sent in frames:
        state = setup.states[index] if sent is None else sent
        with paths_of_state(index):
            frame = drawn(renderer, index, state, setup.options)
        made.add(index, state, frame, frame.header)
        lines.append(json.dumps(frame.header))
    return Shard(files=made.files(), labels=("\n".join(lines) + "\n").encode(),
                 processor_s=time.process_time() - began, renderer=str(renderer.info.get("gl_renderer", "rays"))
                 if hasattr(renderer, "info") else setup.options.backend)
