"""A sequence: frames of many states, drawn by processes that each have a renderer, into files of one folder."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.validate import integer

from ..base.errors import ConfigError
from ..capture.capture import Capture, draw_still, take_frame
from ..renderer import open_renderer
from ..scene.scene import Scene
from ..scene.shape.shape import Shape
from ..view.state import State
from . import labels
from .formats import FrameFile, write
from .options import FrameOptions, require_model

MANIFEST = "manifest.json"
_VERSION = version("glrender")
_DIGITS = 5
# Frames given to a process ahead of those that it draws.
_AHEAD = 2
_MAX_PROCESSES = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameSequence:
    """Frames of many states in one folder.

    A frame's file depends on its state, its number and the options alone: it has the same bytes whichever process
    draws it, and whether the sequence is drawn at once or in parts.

    Parameters
    ----------
    scene : Scene
    states : sequence of State
    folder : path
        Made if it is missing. `MANIFEST` in it says whose frames it holds.
    options : FrameOptions

    Raises
    ------
    ConfigError
        No states, an unknown camera, or a folder with the frames of another sequence.
    """

    scene: Scene
    states: Sequence[State]
    folder: Path
    options: FrameOptions

    def __post_init__(self):
        if not self.states:
            raise ConfigError("states", "must be one or more", 0)
        require_model(self.scene, self.options)

    def path(self, index: int) -> Path:
        """The path of one frame's file."""
        return self.folder / f"frame_{index:0{_DIGITS}d}.{self.options.format}"

    def missing(self) -> list[int]:
        """Numbers of the frames that are not drawn yet."""
        return [index for index in range(len(self.states)) if not self.path(index).exists()]

    def draw(self, n_processes: int | None = None) -> Iterator[int]:
        """Draw what is missing; yields the number of each frame when its file is there.

        Parameters
        ----------
        n_processes : int, optional
            As many as the machine has cores by default.

        Raises
        ------
        GlrenderError
            With the number of the frame that cannot be drawn; the others' files stay.
        """
        n_processes = integer("processes", n_processes or os.cpu_count() or 1, 1, _MAX_PROCESSES)
        self._claim_folder()
        left = iter(self.missing())
        pool = ProcessPoolExecutor(n_processes, mp_context=get_context("spawn"), initializer=_start,
                                   initargs=(self.scene, self.options))
        under_way: dict[Future, int] = {}
        try:
            while True:
                while len(under_way) < _AHEAD * n_processes and (index := next(left, None)) is not None:
                    under_way[pool.submit(_draw, self.path(index), index, self.states[index])] = index
                if not under_way:
                    return
                done, _ = wait(under_way, return_when=FIRST_COMPLETED)
                for future in done:
                    index = under_way.pop(future)
                    future.result()
                    yield index
        finally:
            pool.shutdown(cancel_futures=True)

    def _claim_folder(self) -> None:
        """Write the manifest, or find it the same.

        Raises
        ------
        ConfigError
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        file, ours = self.folder / MANIFEST, self.manifest()
        try:
            theirs = json.loads(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            apart = file.with_suffix(".part")
            apart.write_text(json.dumps(ours, indent=1), encoding="utf-8")
            os.replace(apart, file)
            return
        except ValueError:
            theirs = {}
        if differing := [name for name in ours if theirs.get(name) != ours[name]]:
            raise ConfigError("out", f"holds the frames of another sequence: {', '.join(differing)} differ",
                              str(self.folder), "choose another folder, or remove this one")

    def manifest(self) -> dict[str, Any]:
        """The frames depend on these: version, digests of scene and states, options."""
        states = hashlib.sha256("\n".join(json.dumps(state.to_dict()) for state in self.states).encode())
        return {"glrender": _VERSION, "n_frames": len(self.states), "states_sha256": states.hexdigest(),
                "scene_sha256": _digest_of_scene(self.scene), "options": dataclasses.asdict(self.options) | {
                    "products": list(self.options.products)}}


def _digest_of_scene(scene: Scene) -> str:
    """The digest of shapes, laws, textures and cameras, by their content and not by where they were read."""
    digest = hashlib.sha256()
    _feed(digest, scene)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(repr((value.dtype.str, value.shape)).encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Shape):
        _feed(digest, (value.vertices_m, value.facets))
    elif dataclasses.is_dataclass(value):
        for part in dataclasses.fields(value):
            digest.update(f"{type(value).__name__}.{part.name}=".encode())
            _feed(digest, getattr(value, part.name))
    elif isinstance(value, Mapping):
        for key in sorted(value, key=str):
            digest.update(f"{key}:".encode())
            _feed(digest, value[key])
    elif isinstance(value, list | tuple):
        for entry in value:
            _feed(digest, entry)
            digest.update(b",")
    else:
        digest.update(repr(value).encode())


# Of a process that draws: its renderer, and what is asked of it.
_renderer: Any = None
_options: FrameOptions | None = None


def _start(scene: Scene, options: FrameOptions) -> None:
    global _renderer, _options
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _renderer, _options = open_renderer(scene, options.backend), options


def _end_with_parent() -> None:
    """A process whose parent was killed would wait for work for ever."""
    connection.wait([parent_process().sentinel])
    os._exit(1)


def _draw(path: Path, index: int, state: State) -> None:
    try:
        write(path, drawn(_renderer, index, state, _options))
    except ConfigError as error:
        error.path = f"states[{index}]" + (f".{error.path}" if error.path else "")
        raise


def drawn(renderer: Any, index: int, state: State, options: FrameOptions) -> FrameFile:
    """One frame of a sequence, as it is written.

    Parameters
    ----------
    renderer
        Of `open_renderer`.
    index : int
        Number of the frame: it is added to the options' seed.
    state : State
    options : FrameOptions

    Raises
    ------
    ConfigError, SceneError
    """
    return frame_file(renderer.scene, index, state, options, captured(renderer, index, state, options))


def captured(renderer: Any, index: int, state: State, options: FrameOptions, **asked: Any) -> Capture:
    """One frame of a sequence, with options of `take_frame` or `draw_still` besides; arguments as of `drawn`."""
    products = dict.fromkeys((*options.products, *(labels.PRODUCTS if options.has_labels else ())))
    asked |= {"products": tuple(products), "max_error": options.max_error}
    if options.output == "dn":
        return take_frame(renderer, state, options.camera, seed=options.seed + index, exposure_s=options.exposure_s,
                          **asked)
    return draw_still(renderer, state, options.camera, **asked)


def frame_file(scene: Scene, index: int, state: State, options: FrameOptions, capture: Capture) -> FrameFile:
    """What is written of a frame of `captured`."""
    camera, header = scene.camera(options.camera), {}
    pixels = capture.irradiance_W_m2
    if capture.frame is not None:
        pixels = capture.frame.dn
        header = {"seed": capture.frame.seed, "exposure_s": capture.frame.exposure_s}
    if options.has_labels:
        header["labels"] = labels.frame_labels(scene, state, camera, pixels, capture.products)
    kept = {name: capture.products[name] for name in options.products}
    return FrameFile(pixels=pixels, unit=options.unit, products=kept, header={
        "glrender": _VERSION, "index": index, "state": state.to_dict(), "unit": options.unit,
        "camera": {"name": camera.name, "width_px": camera.width_px, "height_px": camera.height_px,
                   "focal_length_px": camera.focal_length_px, "principal_point_px": list(camera.principal_point_px),
                   "r_camera_spacecraft_m": list(camera.r_camera_spacecraft_m),
                   "q_camera_from_spacecraft": list(camera.q_camera_from_spacecraft)},
        "plan": {"max_error": capture.plan.max_error, "predicted_error": capture.plan.predicted_error},
        "warnings": [str(advice) for advice in capture.warnings], **header})
