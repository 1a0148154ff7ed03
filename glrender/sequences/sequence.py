"""A sequence: frames of many states, drawn by processes that each have a renderer, into files of one folder."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.notebook import png, strip, table
from glrender_camera.pattern import seed_of

from ..base.errors import ConfigError, GlrenderError
from ..capture.capture import Capture, draw_still, take_frame
from ..capture.outputs import checked_output
from ..renderer import open_renderer
from ..scene.scene import Scene
from ..view.state import State
from . import labels
from .folder import MANIFEST, claim_folder, manifest_of, write_whole
from .formats import FrameFile, header_path, range_type, write
from .header import VERSION, camera_table, decoding_of, frame_header, offset_DN
from .options import FrameOptions, exposures_of
from .processes import own_processes, parted, processes_of
from .read import read_header, read_image
from .surface_maps import MAPS, made_of, surface_maps
from .warned import counted, in_words

_DIGITS = 5
# Instants of an exposure at which a course is compared, in exposures from its middle: no period has all alike.
_INSTANTS = (-0.5, -0.309017, -0.118034, 0.190983, 0.5)
# Frames that a notebook shows, and their longer side.
_N_SHOWN, _SHOWN_PX = 5, 160


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
        Made if it is missing. `manifest.json` in it says whose frames it holds.
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
        checked_output(self.options.output, self.scene.camera(self.options.camera))

    def path(self, index: int) -> Path:
        """The path of one frame's file; a stream's ends in the name of its codec."""
        ending = file_ending(self.scene.camera(self.options.camera), self.options)
        return self.folder / f"frame_{index:0{_DIGITS}d}.{ending}"

    @property
    def _decoding(self) -> dict[str, Any]:
        """The arguments of `glrender_camera.compression.decode` but for the stream; empty without streams."""
        camera = self.scene.camera(self.options.camera)
        return decoding_of(camera_table(camera)) if self.options.output == "compressed" else {}

    def missing(self) -> list[int]:
        """Numbers of the frames that are not drawn yet."""
        return [index for index in range(len(self.states)) if not self._is_drawn(self.path(index))]

    def _is_drawn(self, path: Path) -> bool:
        return path.exists() and (self.options.output != "compressed" or header_path(path).exists())

    def draw(self, n_processes: int | None = None) -> Iterator[int]:
        """Draw the missing frames; yields the number of each when its file is there.

        Parameters
        ----------
        n_processes : int, optional
            By default one for each core; one where the states' courses cannot be sent to others.

        Raises
        ------
        GlrenderError
            With the number of the frame that cannot be drawn; the others' files stay.
        """
        claim_folder(self.folder, self.manifest())
        n_processes = processes_of(self.states, self.options, n_processes)
        once, each = parted(self.states, self.options)
        tasks = ((index, _draw, (self.path(index), index, each[index:index + 2])) for index in self.missing())
        headers = {}
        with own_processes(n_processes, _start, (self.scene, self.options, once), _stop) as pool:
            for index, headers[index] in pool.done(tasks):
                yield index
        entries = manifest_of(self.folder)
        all_headers = (headers.get(index) or read_header(self.path(index)) for index in range(len(self.states)))
        entries["warnings"] = counted(header for header in all_headers if header is not None)
        write_whole(self.folder / MANIFEST, json.dumps(entries, indent=1).encode())

    def warnings(self) -> list[str]:
        """The frames' warnings, once all are drawn: the first of each kind, and how many frames have one."""
        return in_words(manifest_of(self.folder)["warnings"], len(self.states))

    def __repr__(self) -> str:
        n_missing = len(self.missing())
        return f"<FrameSequence {self.folder}: {len(self.states) - n_missing} of {len(self.states)} frames drawn>"

    def _repr_html_(self) -> str:
        """For notebooks: the options, the number of frames drawn, and some of the frames."""
        drawn = sorted(set(range(len(self.states))) - set(self.missing()))
        shown = [drawn[round(k)] for k in np.linspace(0, len(drawn) - 1, min(_N_SHOWN, len(drawn)))]
        rows = [("folder", self.folder), ("frames", f"{len(drawn)} of {len(self.states)} drawn"),
                ("each", self.options.text)]
        offset = offset_DN(self.scene.camera(self.options.camera))
        return table("Sequence", rows) + strip((f"{index}", png(read_image(self.path(index)), _SHOWN_PX, offset))
                                               for index in shown)

    def manifest(self) -> dict[str, Any]:
        """The frames depend on these: version, digests of scene and states, options."""
        return {"glrender": VERSION, "n_frames": len(self.states),
                "states_sha256": digest_of_states(self.states, exposures_of(self.scene, self.options)),
                "scene_sha256": digest_of_scene(self.scene), "options": self.options.to_dict(),
                **({"decoding": self._decoding} if self._decoding else {})}


def digest_of_states(states: Sequence[State], spans_s: Sequence[float] = ()) -> str:
    """The digest of states, in their order, and of their courses over spans (N,) [s] about each state."""
    digest = hashlib.sha256("\n".join(json.dumps(state.to_dict()) for state in states).encode())
    for state in states if spans_s else ():
        if state.course is not None:
            digest.update(_motion(state, np.outer(spans_s, _INSTANTS).ravel()).encode())
    return digest.hexdigest()


def _motion(state: State, dt_s: np.ndarray) -> str:
    """The states of a course at times (N,) [s] about one state; where they are not known, the error's text."""
    try:
        return json.dumps([later.to_dict() for later in state.at(dt_s)])
    except GlrenderError as error:
        return str(error)


def digest_of_scene(scene: Scene) -> str:
    """The digest of shapes, laws, textures and cameras, by their content and not by where they were read."""
    digest = hashlib.sha256()
    _feed(digest, scene)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Feed all that a value consists of, with the names of its types."""
    if isinstance(value, np.ndarray):
        digest.update(repr((value.dtype.str, value.shape)).encode() + np.ascontiguousarray(value).tobytes())
        return
    kind = type(value)
    digest.update(f"{kind.__module__}.{kind.__qualname__}(".encode())
    if dataclasses.is_dataclass(value):
        # A shape's report is made of the shape, and has the name of its file.
        _feed_named(digest, {part.name: getattr(value, part.name) for part in dataclasses.fields(value)
                             if part.name != "report"})
    elif isinstance(value, Mapping):
        _feed_named(digest, value)
    elif isinstance(value, list | tuple):
        for entry in value:
            _feed(digest, entry)
            digest.update(b",")
    elif kind.__repr__ is object.__repr__:
        # The repr has the place in memory alone, another one in each process.
        _feed_named(digest, getattr(value, "__dict__", {}))
    else:
        digest.update(repr(value).encode())
    digest.update(b")")


def _feed_named(digest: Any, values: Mapping[Any, Any]) -> None:
    for key in sorted(values, key=str):
        digest.update(f"{key}:".encode())
        _feed(digest, values[key])
        digest.update(b",")


# A process that draws has its renderer, and the options and states that it was given.
_renderer: Any = None
_options: Any = None
_states: Sequence[State] = ()


def _start(scene: Scene, options: FrameOptions, states: Sequence[State]) -> None:
    global _renderer, _options, _states
    _renderer, _options, _states = open_renderer(scene, options.backend), options, states


def _stop() -> None:
    global _renderer
    if _renderer is not None:
        _renderer.close()
    _renderer = None


def _draw(path: Path, index: int, states: Sequence[State | None]) -> dict[str, Any]:
    """Draw a frame and write it; returns what `counted` reads of its header."""
    with paths_of_state(index):
        state, *following = [_states[index + k] if each is None else each for k, each in enumerate(states)]
        file = drawn(_renderer, index, state, _options, tuple(following))
        write(path, file)
        return {name: file.header[name] for name in ("index", "warnings", "warning_codes")}


@contextmanager
def paths_of_state(index: int) -> Iterator[None]:
    """Errors name a state's field by the sequence, e.g. ``states[3].bodies.rock`` for ``state.bodies.rock``."""
    try:
        yield
    except ConfigError as error:
        field = "" if error.path == "state" else error.path.removeprefix("state.")
        error.path = ".".join(part for part in (f"states[{index}]", field) if part)
        raise


def file_ending(camera: PinholeCamera, options: FrameOptions) -> str:
    """The ending of a frame's file: its format, or the codec of a stream."""
    return camera_table(camera)["compression"]["codec"] if options.output == "compressed" else options.format


def drawn(renderer: Any, index: int, state: State, options: FrameOptions,
          following: tuple[State, ...] | None = None) -> FrameFile:
    """One frame of a sequence, as it is written.

    Parameters
    ----------
    renderer
        A renderer of `open_renderer`.
    index : int
        Number of the frame: its noise has the seed that `seed_of` derives from the number and the options' seed.
    state : State
    options : FrameOptions
    following : tuple of State, optional
        As of `surface_maps`.

    Raises
    ------
    ConfigError, SceneError
    """
    return frame_file(renderer.scene, index, state, options, captured(renderer, index, state, options), following)


def captured(renderer: Any, index: int, state: State, options: FrameOptions, **asked: Any) -> Capture:
    """One frame of a sequence, with options of `take_frame` or `draw_still` besides; arguments as of `drawn`.

    `seed` among them replaces the frame's own.
    """
    products = made_of((*options.products, *(labels.PRODUCTS if options.has_labels else ())))
    asked |= {"products": products, "max_error": options.max_error}
    seed = asked.pop("seed", None)
    if options.is_of_detector:
        return take_frame(renderer, state, options.camera, seed=seed_of(options.seed, index) if seed is None else seed,
                          exposure_s=options.exposure_s, **asked)
    return draw_still(renderer, state, options.camera, **asked)


def frame_file(scene: Scene, index: int, state: State, options: FrameOptions, capture: Capture,
               following: tuple[State, ...] | None = None) -> FrameFile:
    """The file of a frame of `captured`; `following` as of `surface_maps`."""
    pixels = capture.irradiance_W_m2 if capture.frame is None else capture.frame.dn
    header = frame_header(scene, index, state, options, capture)
    if options.has_labels:
        header["labels"] = labels.frame_labels(scene, state, scene.camera(options.camera), pixels, capture.products,
                                               options.keypoints, options.limb_points, capture.irradiance_W_m2)
    made = capture.products | (surface_maps(scene, state, scene.camera(options.camera), capture.products,
                                            options.products, following) if MAPS.keys() & options.products else {})
    kept = {name: made[name] for name in options.products}
    if "range" in kept:
        kept["range"] = kept["range"].astype(range_type(scene.camera(options.camera)))
    return FrameFile(pixels=pixels, unit=options.unit, products=kept, header=header,
                     stream=None if capture.frame is None else capture.frame.stream)
