"""`glrender deviation`: how far a surface lies from the true one, in numbers and as a picture."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
from glrender import ConfigError, Shape
from glrender_photogrammetry import Deviation, Mesh, deviation, posed_frames
from glrender_photogrammetry.deviation import ALIGNMENTS

from ..deviation_picture import write_picture
from ..picture import check_place


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender deviation`."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="a surface in metres: PLY, OBJ, STL, OFF, GLB")
    parser.add_argument("truth", type=Path, metavar="TRUTH", help="the shape that was drawn, of any format of shapes")
    parser.add_argument("--unit", default="m", help="of the truth's file (m)")
    parser.add_argument("--align", choices=ALIGNMENTS, default="none",
                        help="taken off first: scale and shift (attitudes), or turn too (similarity); default: none")
    parser.add_argument("--px-m", type=float, metavar="M",
                        help="pixel on the ground, for completeness; default: of the nearest of --frames")
    parser.add_argument("--frames", type=Path, metavar="FOLDER",
                        help="of `glrender sequence`: completeness is of what three frames saw in light")
    parser.add_argument("--body", help="of the frames; default: the first")
    parser.add_argument("--picture", type=Path, metavar="FILE", help=".png or .jpg: coloured by distance, a histogram")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the deviation, and write its picture."""
    if arguments.picture is not None:
        check_place("--picture", arguments.picture)
    try:
        truth = Shape.from_file(arguments.truth, length_unit=arguments.unit)
        frames = None if arguments.frames is None else posed_frames(arguments.frames, arguments.body)
        px_m = min(frame.px_m for frame in frames) if frames and arguments.px_m is None else arguments.px_m
        found = deviation(Mesh.from_file(arguments.model), truth, px_m=px_m, align=arguments.align, frames=frames)
        if arguments.picture is not None:
            write_picture(arguments.picture, found, f"{arguments.model.name} against {arguments.truth.name}")
    except ConfigError:
        raise
    except ValueError as error:
        field, _, rest = str(error).partition(": ")
        raise ConfigError(field, rest) from None
    table = numbers(found)
    sys.stdout.write(json.dumps(table, indent=1) + "\n" if arguments.json else sentence(found))
    return 0


def numbers(found: Deviation) -> dict[str, float | None]:
    """The numbers of a deviation, by name."""
    table = {field.name: getattr(found, field.name) for field in fields(found)}
    return {name: value for name, value in table.items() if value is None or isinstance(value, float)}


def sentence(found: Deviation) -> str:
    """The numbers of a deviation, for the eye."""
    text = (f"mean {found.mean_m:.3f} m, sigma {found.sigma_m:.3f}, MAD {found.mad_m:.3f}, 95 % within "
            f"{found.p95_m:.3f}, largest {found.max_m:.3f} m\n")
    if found.complete_1px is not None and found.complete_2px is not None:
        text += (f"complete within 1 px: {100.0 * found.complete_1px:.1f} %, 2 px: {100.0 * found.complete_2px:.1f} % "
                 f"of {100.0 * found.seen:.1f} % of the truth's area\n")
    if found.scale != 1.0:
        text += (f"aligned: scale {found.scale:.6f}, turn {np.degrees(found.turn_rad):.4f} deg, "
                 f"shift {found.shift_m:.3f} m\n")
    return text
