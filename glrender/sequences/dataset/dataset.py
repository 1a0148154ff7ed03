"""A data set: labelled frames of many states, drawn in shards by processes here or elsewhere, into one folder."""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from glrender_camera.validate import integer, one_of

from ...base.errors import ConfigError, GlrenderError
from ...capture.outputs import checked_output
from ...scene.scene import Scene
from ...view.state import State
from .. import labels
from ..folder import MANIFEST, claim_folder, manifest_of, write_whole
from ..header import VERSION, camera_table
from ..options import FrameOptions, exposures_of
from ..processes import Pool, own_processes, parted, processes_of
from ..sequence import digest_of_scene, digest_of_states
from ..surface_maps import refuse_flow
from ..warned import counted, in_words
from . import bop, coco
from .drawing import Setup, draw_elsewhere, draw_here, start, stop
from .shards import FORMATS, Files

FRAMES_A_SHARD = 50
_LIBRARIES = ("numpy", "scipy", "pillow")


@dataclass(frozen=True, kw_only=True, eq=False)
class DataSet:
    """Labelled frames of many states in one folder.

    A shard depends on its states, their numbers and the options alone: it has the same bytes whichever process draws
    it, and whether the data set is drawn at once or in parts.

    Parameters
    ----------
    scene : Scene
    states : sequence of State
    folder : path
        Made if it is missing. `manifest.json` in it says whose frames it holds.
    options : FrameOptions
        Its `format` is not used, and labels are always made.
    format : "webdataset", "hdf5", "coco" or "bop"
    frames_a_shard : int, 1..10000
    source : mapping
        Where the states are from, as plain data, for the manifest.
    scenario : str
        The text of the scenario's file, for the manifest; it may change where the states and the scene do not.

    Raises
    ------
    ConfigError
        No states, an unknown camera, options that the format does not hold, or a folder with another data set.
    """

    scene: Scene
    states: Sequence[State]
    folder: Path
    options: FrameOptions
    format: str = "webdataset"
    frames_a_shard: int = FRAMES_A_SHARD
    source: Mapping[str, Any] = field(default_factory=dict)
    scenario: str = ""

    def __post_init__(self):
        if not self.states:
            raise ConfigError("states", "must be one or more", 0)
        one_of("format", self.format, FORMATS)
        integer("frames_a_shard", self.frames_a_shard, 1, 10_000)
        camera = self.scene.camera(self.options.camera)
        checked_output(self.options.output, camera)
        if self.options.output == "compressed":
            raise ConfigError("output", "must be 'irradiance' or 'dn' in a data set", self.options.output,
                              "ask for 'dn', whose numbers are decoded from the stream")
        if self.options.output != "dn" and self.format in ("coco", "bop"):
            raise ConfigError("format", f"{self.format} holds digital numbers alone", self.options.unit,
                              "use webdataset or hdf5, or --output dn")
        if self.format == "bop":
            if camera.distortion is not None:
                raise ConfigError("format", "bop has no distortion", camera.name, "use another, or a camera without")
            if self.options.products:
                raise ConfigError("products", "must be none with bop, which has depths", list(self.options.products),
                                  "leave them out, or use another format")
        refuse_flow(self.options.products)
        for name in self.options.keypoints:
            if name not in self.scene.hulls:
                raise ConfigError(f"keypoints.{name}", "is no body of the scene",
                                  hint=f"bodies: {', '.join(self.scene.hulls)}")
        FORMATS[self.format].check()

    @cached_property
    def setup(self) -> Setup:
        """All that a process needs besides the states."""
        wanted = {*self.options.products, *labels.PRODUCTS, *(("range",) if self.format == "bop" else ())}
        options = replace(self.options, has_labels=True, format="npz", products=tuple(sorted(wanted)))
        return Setup(scene=self.scene, options=options, format=self.format, version=VERSION, states=self._parted[0])

    @cached_property
    def _parted(self) -> tuple[Sequence[State], Sequence[State | None]]:
        return parted(self.states, self.options)

    def numbers(self) -> range:
        """Numbers of the shards."""
        return range(-(-len(self.states) // self.frames_a_shard))

    def indices(self, number: int) -> range:
        """Numbers of the frames of a shard."""
        first = number * self.frames_a_shard
        return range(first, min(first + self.frames_a_shard, len(self.states)))

    def path(self, number: int) -> Path:
        """The path of a shard: a file, or a folder."""
        return self.folder / FORMATS[self.format].name(number)

    def labels_path(self, number: int) -> Path:
        """The path of a shard's labels, one frame (JSON) a line."""
        return self.folder / "labels" / f"{number:05d}.jsonl"

    def missing(self) -> list[int]:
        """Numbers of the shards that are not there yet."""
        return [number for number in self.numbers() if not self.path(number).exists()]

    def draw(self, n_processes: int | None = None, pool: AbstractContextManager[Pool] | None = None) -> Iterator[int]:
        """Draw the missing shards; yields the number of each when it is there; then write the files about all shards.

        Parameters
        ----------
        n_processes : int, optional
            By default one for each core; one where the states' courses cannot be sent to others.
        pool : context manager of Pool, optional
            Processes elsewhere, as of `dask_processes`, instead of this machine's.

        Raises
        ------
        GlrenderError
            A shard cannot be drawn or written; shards that are there stay.
        """
        claim_folder(self.folder, self.claim())
        began, totals = time.monotonic(), {"n_frames": 0, "processor_s": 0.0, "renderers": set()}
        missing = self.missing()
        if missing:
            n_processes = processes_of(self.states, self.options, n_processes, pool is not None)
            with pool or own_processes(n_processes, start, (self.setup,), stop) as processes:
                tasks = ((number, *self._task(number, processes, pool is None)) for number in missing)
                for number, drawn in processes.done(tasks):
                    self._put(number, drawn.files, drawn.labels)
                    totals["n_frames"] += len(self.indices(number))
                    totals["processor_s"] += drawn.processor_s
                    totals["renderers"].add(drawn.renderer)
                    yield number
        self._finish({**totals, "wall_s": time.monotonic() - began, "renderers": sorted(totals["renderers"])})

    def claim(self) -> dict[str, Any]:
        """The frames depend on these: versions, digests of scene and states, options."""
        camera = self.scene.camera(self.options.camera)
        keys = {name: value for name, value in self.options.to_dict().items() if name not in ("format", "has_labels")}
        return {"glrender": VERSION, "n_frames": len(self.states), "frames_a_shard": self.frames_a_shard,
                "format": self.format,
                "states_sha256": digest_of_states(self.states, exposures_of(self.scene, self.options)),
                "scene_sha256": digest_of_scene(self.scene), "options": keys, "source": dict(self.source),
                "bodies": [body.name for body in self.scene.bodies],
                "camera": camera_table(camera)}

    def throughput(self) -> dict[str, Any]:
        """Times of the last sitting, as the manifest has them."""
        return manifest_of(self.folder)["throughput"]

    def warnings(self) -> list[str]:
        """The frames' warnings, once all are drawn: the first of each kind, and how many frames have one."""
        return in_words(manifest_of(self.folder)["warnings"], len(self.states))

    def _counted(self) -> dict[str, dict[str, Any]]:
        return counted(json.loads(line) for number in self.numbers()
                       for line in self.labels_path(number).read_text(encoding="utf-8").splitlines())

    def _task(self, number: int, pool: Pool, is_here: bool) -> tuple[Any, tuple]:
        indices = self.indices(number)
        frames = [(index, self._parted[1][index]) for index in indices]
        return (draw_here, (number, frames)) if is_here else (draw_elsewhere, (pool.given(self.setup), number, frames))

    def _put(self, number: int, files: Files, lines: bytes) -> None:
        """Write a shard, whole or not at all; its labels first, so that a shard that is there has them."""
        path = self.path(number)
        try:
            self.labels_path(number).parent.mkdir(exist_ok=True)
            path.parent.mkdir(exist_ok=True)
            write_whole(self.labels_path(number), lines)
            if isinstance(files, bytes):
                write_whole(path, files)
                return
            apart = path.with_name(f".{path.name}.part")
            shutil.rmtree(apart, ignore_errors=True)
            try:
                for name, content in files.items():
                    (apart / name).parent.mkdir(parents=True, exist_ok=True)
                    (apart / name).write_bytes(content)
                apart.replace(path)
            except OSError:
                shutil.rmtree(apart, ignore_errors=True)
                raise
        except OSError as error:
            n_there = len(self.numbers()) - len(self.missing())
            raise GlrenderError(f"{path}: cannot be written: {error.strerror}; {n_there} of {len(self.numbers())} "
                                "shards are there and stay: make room, and start again") from error

    def _finish(self, totals: Mapping[str, Any]) -> None:
        """Write the files about all shards: annotations of COCO, models of BOP, and the manifest with the digests."""
        if self.format == "coco":
            parts = [self.path(number) for number in self.numbers()]
            write_whole(self.folder / "annotations.json", coco.merged(self.scene, self.options.keypoints, parts))
        if self.format == "bop":
            for name, content in bop.models(self.scene, self.scene.camera(self.options.camera)).items():
                (self.folder / name).parent.mkdir(exist_ok=True)
                write_whole(self.folder / name, content)
        shards = [{"path": str(self.path(number).relative_to(self.folder)), "n_frames": len(self.indices(number)),
                   "sha256": digest_of_shard(self.path(number))} for number in self.numbers()]
        before = manifest_of(self.folder)
        n, wall_s, processor_s = totals["n_frames"], totals["wall_s"], totals["processor_s"]
        throughput = before.get("throughput", {}) if not n else {
            "n_frames": n, "wall_s": round(wall_s, 3), "processor_s": round(processor_s, 3),
            "frames_a_second": round(n / wall_s, 3), "frames_a_core_second": round(n / max(processor_s, 1e-9), 3),
            "renderers": totals["renderers"]}
        versions = {"python": platform.python_version(), **{name: version(name) for name in _LIBRARIES}}
        write_whole(self.folder / MANIFEST, json.dumps(
            {**self.claim(), "versions": versions, "scenario": self.scenario, "warnings": self._counted(),
             "shards": shards, "throughput": throughput}, indent=1).encode())


def digest_of_shard(path: Path) -> str:
    """SHA-256 of a file, or of a folder's files and their names."""
    if path.is_file():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    digest = hashlib.sha256()
    for file in sorted(file for file in path.rglob("*") if file.is_file()):
        digest.update(f"{file.relative_to(path).as_posix()} {digest_of_shard(file)}\n".encode())
    return digest.hexdigest()
