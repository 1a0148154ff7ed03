"""`glrender dataset`: labelled frames in shards, by the cores of this machine or by a Dask cluster."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from glrender import ConfigError
from glrender.base.errors import error_path
from glrender.scenario import RandomStates, load_scenario
from glrender.scenario.files.keypoint_fields import off_surface
from glrender.scenario.files.random_fields import with_changes
from glrender.scenario.files.scenario_file import load_setting
from glrender.sequences.dask_processes import dask_processes
from glrender.sequences.dataset.dataset import FRAMES_A_SHARD, DataSet
from glrender.sequences.dataset.shards import FORMATS
from glrender.sequences.dataset.sheet import label_sheet
from glrender.sequences.options import options_of
from tqdm import tqdm

from ..rehearsal import FOLLOWED, LIMB_POINTS, dataset_table
from ..tolerance import read_max_error
from .sequence import exposure, read_states


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender dataset`."""
    parser.add_argument("scenario", type=Path, metavar="SCENARIO",
                        help="scenario file (TOML), with [random] or a trajectory; with --states a scene file too")
    parser.add_argument("--frames", type=int, help="of [random] (those of the file)")
    parser.add_argument("--states", type=Path, help="file of state vectors, one (JSON) a line, instead of a scenario's")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="made if it is missing")
    parser.add_argument("--format", default="webdataset", choices=FORMATS)
    parser.add_argument("--camera", help="default: that of [output] or [random], or the first")
    parser.add_argument("--output", choices=("irradiance", "dn"), help="default: dn where the camera has a model")
    parser.add_argument("--products", nargs="*", metavar="NAME",
                        help="range, incidence, emission, phase, ... of each pixel, with the mask")
    parser.add_argument("--limb-points", type=int, default=LIMB_POINTS, metavar="N", help="of a body (64)")
    parser.add_argument("--seed", type=int, help="of [random] and of the frames' noise (the file's, and 0)")
    parser.add_argument("--exposure-s", type=exposure, help="with dn: seconds, or auto; default: the camera's")
    parser.add_argument("--max-error", metavar="SHARE", help="or units with one each; the scene's")
    parser.add_argument("--shard-frames", type=int, default=FRAMES_A_SHARD, metavar="N", help="in each shard (50)")
    parser.add_argument("--processes", type=int, metavar="N", help="0, the default: one for each core")
    parser.add_argument("--dask", metavar="ADDRESS", help="of a Dask scheduler, whose workers draw")
    parser.add_argument("--backend", default="auto")


def run(arguments: argparse.Namespace) -> int:
    """Draw the frames that the folder lacks, then a contact sheet with the labels."""
    dataset, warnings = _dataset(arguments)
    for warning in warnings:
        sys.stderr.write(f"glrender: warning: {warning}\n")
    n_frames = len(dataset.states)
    n_left = sum(len(dataset.indices(number)) for number in dataset.missing())
    pool = dask_processes(arguments.dask) if arguments.dask else None
    with tqdm(total=n_frames, initial=n_frames - n_left, unit="frame", disable=None) as bar:
        for number in dataset.draw(arguments.processes, pool):
            bar.update(len(dataset.indices(number)))
    for warning in dataset.warnings():
        sys.stderr.write(f"glrender: warning: {warning}\n")
    sheet, told = arguments.out / "contact_sheet.png", ""
    label_sheet(sheet, dataset)
    if n_left:
        took = dataset.throughput()
        told = (f", {took['frames_a_second']:.3g} frames a second, {took['frames_a_core_second']:.3g} a second a core "
                f"({took['processor_s'] / took['n_frames']:.3f} s each)")
    sys.stdout.write(f"{arguments.out}: {n_frames} frames in {len(dataset.numbers())} shards, {n_left} drawn now"
                     f"{told}; {sheet}\n")
    return 0


def _dataset(arguments: argparse.Namespace) -> tuple[DataSet, list[str]]:
    """The data set that the arguments ask for, and its warnings."""
    if arguments.states is not None:
        if arguments.frames is not None:
            raise ConfigError("--frames", "is given with --states", arguments.frames, "leave one out")
        scenario, (scene, keypoints, output) = None, load_setting(arguments.scenario)
    else:
        scenario = load_scenario(arguments.scenario)
        scene, keypoints, output = scenario.scene, scenario.keypoints, scenario.output
    with error_path("output"):
        options_of(scene, output)
    camera_name, warnings = arguments.camera or output.get("camera"), []
    if scenario is None:
        states, source = read_states(arguments.states), {"states": "file"}
    else:
        source = {"states": "trajectory"}
        if isinstance(scenario, RandomStates):
            camera = scene.camera(camera_name) if camera_name else None
            scenario = with_changes(scenario, frames=arguments.frames, seed=arguments.seed, camera=camera)
            camera_name = scenario.camera.name
            source = {"states": "random", **scenario.told(), "rejected": dict(scenario.rejected)}
        elif arguments.frames is not None:
            raise ConfigError("--frames", "is of [random]: this scenario has its own", arguments.frames,
                              "change its `frames`, or give it [random] instead of a trajectory")
        warnings, states = scenario.check(), list(scenario.iter_states())
    camera = scene.camera(camera_name) if camera_name else scene.cameras[0]
    asked = {name: getattr(arguments, name) for name in FOLLOWED} | {
        "camera": camera.name, "max_error": read_max_error(arguments.max_error)}
    options = replace(options_of(scene, dataset_table(output, camera), asked, arguments.backend), keypoints=keypoints,
                      limb_points=arguments.limb_points)
    dataset = DataSet(scene=scene, states=states, folder=arguments.out, options=options, format=arguments.format,
                      frames_a_shard=arguments.shard_frames, source=source,
                      scenario=arguments.scenario.read_text(encoding="utf-8"))
    return dataset, [*warnings, *off_surface(scene, keypoints)]
