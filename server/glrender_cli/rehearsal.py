"""A dozen frames of a scenario, drawn as its sequence or data set will be, and described."""

from __future__ import annotations

import io
import json
import sys
import tarfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from glrender import PinholeCamera
from glrender.base.errors import error_path
from glrender.scenario import RandomStates, Scenario
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.dataset.shards import FORMATS
from glrender.sequences.options import FrameOptions, options_of
from glrender.sequences.processes import checked_processes
from glrender.sequences.trial import Measured, Trial, tried
from glrender.sequences.warned import in_words

LIMB_POINTS = 64
"""Points of a body's limb that a data set has as labels."""
FOLLOWED = ("camera", "output", "products", "seed", "exposure_s", "max_error")
"""Fields of [output] that a data set follows; it has formats and labels of its own."""


def dataset_table(output: Mapping[str, Any], camera: PinholeCamera) -> dict[str, Any]:
    """The options of a data set's frames, of a scenario's table [output] and of the camera that draws."""
    followed = {name: value for name, value in output.items() if name in FOLLOWED}
    return {"output": "dn" if camera.model else "irradiance", **followed, "labels": True}


def rehearse(scenario: Scenario | RandomStates, n_frames: int, backend: str) -> None:
    """Draw some frames of a scenario and print exposures, numbers, warnings, and the seconds and bytes of the whole.

    Raises
    ------
    ConfigError
        A frame cannot be drawn.
    """
    scene, measured = scenario.scene, None
    states = list(scenario.iter_states())
    with error_path("output"):
        if isinstance(scenario, RandomStates):
            table = dataset_table(scenario.output, scenario.camera)
            options = replace(options_of(scene, table, {"camera": scenario.camera.name}, backend),
                              keypoints=scenario.keypoints, limb_points=LIMB_POINTS)
            options = DataSet(scene=scene, states=states, folder=Path(), options=options).setup.options
            measured = _of_shard(scenario, options)
        else:
            options = options_of(scene, scenario.output, backend=backend)
    trial = tried(scene, states, options, n_frames, measured)
    for warning in in_words(trial.warnings, len(trial.indices)):
        sys.stderr.write(f"glrender: warning: {warning}\n")
    if trial.problem:
        sys.stderr.write(f"glrender: warning: {trial.problem}\n")
    sys.stdout.writelines(f"{line}\n" for line in _described(trial, len(states)))


def _of_shard(scenario: RandomStates, options: FrameOptions) -> Measured:
    """Bytes of a frame in a shard of WebDataset, with the labels that lie next to it."""
    def measured(index: int, state: Any, file: Any) -> int:
        writer = FORMATS["webdataset"].writer(scenario.scene, options, 0)
        writer.add(index, state, file, file.header)
        with tarfile.open(fileobj=io.BytesIO(writer.files())) as shard:
            sizes = [member.size for member in shard]
        # Each has a head and is filled up to whole blocks.
        return sum((1 - -size // tarfile.BLOCKSIZE) * tarfile.BLOCKSIZE for size in sizes) + len(
            json.dumps(file.header))

    return measured


def _described(trial: Trial, n_states: int) -> list[str]:
    parts = [f"{_span(np.concatenate([trial.least, trial.greatest]))} {trial.unit}", f"{trial.n_dark} without light"]
    if trial.exposure_s.size:
        parts = [f"exposure {_span(trial.exposure_s)} s", *parts,
                 f"{_span(100.0 * trial.saturated_share)} % of the lit pixels saturated"]
    n_cores = checked_processes(None)
    core_s = n_states * trial.processor_s
    return [f"tried: {len(trial.indices)} of {n_states} frames: {', '.join(parts)}",
            f"whole: some {trial.processor_s:.2g} s of a core a frame, {core_s:.3g} s in all, {core_s / n_cores:.3g} s "
            f"on {n_cores} cores; some {n_states * trial.n_bytes / 1e6:.3g} MB"]


def _span(values: np.ndarray) -> str:
    least, most = f"{values.min():.3g}", f"{values.max():.3g}"
    return least if least == most else f"{least} to {most}"
