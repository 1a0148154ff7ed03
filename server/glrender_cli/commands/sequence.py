"""`glrender sequence`: frames of many states as files, on all cores; started again, it goes on where it was stopped."""

from __future__ import annotations

import argparse
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from glrender import ConfigError, Scene, State
from glrender.base.errors import error_path
from glrender.base.names import OUTPUTS
from glrender.scenario import load_scenario
from glrender.scenario.exports.exports import EXPORTS, exports_of, refuse_others
from glrender.scenario.exports.flight import Flight
from glrender.scenario.files.keypoint_fields import off_surface
from glrender.scenario.files.scenario_file import load_setting
from glrender.sequences.contact_sheet import contact_sheet
from glrender.sequences.folder import write_whole
from glrender.sequences.formats import FORMATS, STREAM
from glrender.sequences.header import offset_DN
from glrender.sequences.options import OUTPUT_KEYS, options_of
from glrender.sequences.read import read_image
from glrender.sequences.sequence import FrameSequence
from glrender.sequences.video import check_video, write_video
from tqdm import tqdm

from ..picture import check_place
from ..tolerance import read_max_error

_ON_SHEET = 25


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender sequence`."""
    parser.add_argument("scene", type=Path, metavar="SCENARIO",
                        help="scenario file (TOML); with --states a scene file too")
    parser.add_argument("--states", type=Path, help="file of state vectors, one (JSON) a line, instead of a scenario's")
    parser.add_argument("--write-states", type=Path, metavar="FILE",
                        help="write the scenario's states there, and no frames")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="made if it is missing")
    parser.add_argument("--camera", help="default: the first")
    parser.add_argument("--output", choices=OUTPUTS, help="default: irradiance")
    parser.add_argument("--format", choices=(*FORMATS, STREAM),
                        help="png: 16 bits, with dn alone; stream: of compressed; default: fits")
    parser.add_argument("--products", nargs="*", metavar="NAME", help="range, body_id, incidence, normal, flow, ...")
    parser.add_argument("--labels", action=argparse.BooleanOptionalAction,
                        help="pose, box, centres and keypoints of each body, in the header")
    parser.add_argument("--seed", type=int, help="of the noise, which each frame has of its own (0)")
    parser.add_argument("--exposure-s", type=exposure, help="of dn and compressed: seconds, or auto; the camera's")
    parser.add_argument("--max-error", metavar="SHARE", help="or units with one each; the scene's")
    parser.add_argument("--video", type=Path, metavar="FILE.mp4", help="write the frames as a video for the eye too")
    parser.add_argument("--video-rate-hz", type=float, default=25.0, metavar="HZ")
    parser.add_argument("--with", dest="exports", metavar="NAMES", default="",
                        help=f"write files of other tools too, out of {','.join(EXPORTS)}")
    parser.add_argument("--ids", nargs="*", metavar="NAME=NUMBER",
                        help="of --with: NAIF's numbers of bodies and, negative, of the spacecraft")
    parser.add_argument("--spacecraft", metavar="NAME", help="of --with: the spacecraft's name (spacecraft)")
    parser.add_argument("--processes", type=int, metavar="N", help="0, the default: one for each core")
    parser.add_argument("--backend", default="auto")


def run(arguments: argparse.Namespace) -> int:
    """Draw the frames that the folder lacks, then a contact sheet, and a video if one is asked for."""
    for option in ("write_states", "video"):
        if getattr(arguments, option) is not None:
            check_place("--" + option.replace("_", "-"), getattr(arguments, option))
    for option in ("ids", "spacecraft", "exports"):
        is_vain = not arguments.exports if option != "exports" else arguments.write_states is not None
        if getattr(arguments, option) and is_vain:
            raise ConfigError(f"--{option}" if option != "exports" else "--with", "has no effect here",
                              getattr(arguments, option), "name files by --with, without --write-states")
    warnings = []
    if arguments.states is None:
        scenario = load_scenario(arguments.scene)
        scene, states, table, keypoints = (scenario.scene, list(scenario.iter_states()), scenario.output,
                                           scenario.keypoints)
        warnings = scenario.check()
    else:
        scene, keypoints, table = load_setting(arguments.scene)
        states = read_states(arguments.states)
    for warning in (*warnings, *off_surface(scene, keypoints)):
        sys.stderr.write(f"glrender: warning: {warning}\n")
    if arguments.write_states is not None:
        lines = (json.dumps(state.to_dict()) + "\n" for state in states)
        arguments.write_states.write_text("".join(lines), encoding="utf-8")
        sys.stdout.write(f"{arguments.write_states}: {len(states)} states\n")
        return 0
    if arguments.out is None:
        raise ConfigError("--out", "missing", hint="name a folder for the frames")
    if arguments.video is not None:
        check_video(arguments.video, arguments.video_rate_hz)
    asked = {key: getattr(arguments, key) for key in OUTPUT_KEYS}
    asked["max_error"] = read_max_error(arguments.max_error)
    with error_path("output"):
        options = options_of(scene, table, asked, arguments.backend)
    if options.has_labels:
        options = replace(options, keypoints=keypoints)
    sequence = FrameSequence(scene=scene, states=states, folder=arguments.out, options=options)
    exports = _exports(arguments, scene, states, options.camera)
    refuse_others(arguments.out, exports)
    n_frames = len(sequence.states)
    n_there = n_frames - len(sequence.missing())
    with tqdm(total=n_frames, initial=n_there, unit="frame", disable=None) as bar:
        for _ in sequence.draw(arguments.processes):
            bar.update()
    for warning in sequence.warnings():
        sys.stderr.write(f"glrender: warning: {warning}\n")
    for name, content in exports.items():
        write_whole(arguments.out / name, content)
    shown = np.unique(np.linspace(0, n_frames - 1, min(n_frames, _ON_SHEET)).astype(int)).tolist()
    sheet = arguments.out / "contact_sheet.png"
    offset = offset_DN(scene.camera(options.camera))
    contact_sheet(sheet, [(str(index), read_image(sequence.path(index))) for index in shown], offset)
    written = str(sheet)
    if arguments.video is not None:
        write_video(arguments.video, [sequence.path(index) for index in range(n_frames)], arguments.video_rate_hz,
                    offset)
        written += f"; {arguments.video}"
    sys.stdout.write(f"{arguments.out}: {n_frames} frames, {n_frames - n_there} drawn now; {written}\n")
    if exports:
        kinds = dict.fromkeys(re.sub(r"_\d{5}", "_*", name) for name in exports)
        sys.stdout.write(f"with {', '.join(kinds)}\n")
    return 0


def _exports(arguments: argparse.Namespace, scene: Scene, states: list[State], camera: str) -> dict[str, bytes]:
    """Contents of the files of `--with`, by their names."""
    if not arguments.exports:
        return {}
    ids = {}
    for word in arguments.ids or ():
        name, mark, number = word.rpartition("=")
        if not mark or not number.removeprefix("-").isdecimal():
            raise ConfigError("--ids", "must be NAME=NUMBER", word)
        if name in ids:
            raise ConfigError("--ids", f"must name {name!r} once", word, "leave one out")
        ids[name] = int(number)
    flight = Flight(states=states, camera=scene.camera(camera), spacecraft=arguments.spacecraft or "spacecraft",
                    radii_m={body.name: body.hull.radius_m for body in scene.bodies}, ids=ids)
    return exports_of(flight, [name.strip() for name in arguments.exports.split(",")])


def exposure(text: str) -> float | str:
    """An exposure of the command line: seconds, or "auto"."""
    try:
        return text if text == "auto" else float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number of seconds, or auto, got {text!r}") from None


def read_states(path: Path) -> list[State]:
    """States of a file with one JSON object a line, as `State.to_dict` gives them; blank lines are passed over.

    Raises
    ------
    ConfigError
        With the number of the line.
    """
    found = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is no UTF-8 text"
        raise ConfigError(str(path), f"cannot be read: {reason}",
                          hint="write one State.to_dict() a line, as JSON") from None
    for number, line in enumerate(lines, start=1):
        if line.strip():
            try:
                table = json.loads(line)
            except (json.JSONDecodeError, RecursionError) as error:
                raise ConfigError(f"{path}, line {number}", f"is not JSON: {error}") from None
            found.append(State.from_dict(table, f"{path.name}[{number}]"))
    if not found:
        raise ConfigError(str(path), "holds no state", hint="write one State.to_dict() a line, as JSON")
    return found
