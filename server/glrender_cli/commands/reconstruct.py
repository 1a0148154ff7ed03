"""`glrender reconstruct`: a surface from the frames of a sequence; started again, it goes on where it was stopped."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

from glrender import ConfigError
from glrender_photogrammetry import Mesh, posed_frames, reconstruct, textured, vertex_brightness
from glrender_photogrammetry.reconstruction import POSES, STAGES
from tqdm import tqdm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender reconstruct`."""
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of `glrender sequence`: npz or fits")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR",
                        help="of shape.ply, report.json and the stages; made if it is missing")
    parser.add_argument("--body", help="that is reconstructed; default: the first")
    parser.add_argument("--poses", choices=POSES, default="known",
                        help="of the states (known), found from features and laid on them (free), or adjusted to "
                        "both (prior)")
    parser.add_argument("--place-sigma-m", type=float, metavar="M", help="of the states' places, for --poses prior")
    parser.add_argument("--texture", action="store_true", help="vertices grey by the signal over the shading")
    parser.add_argument("--map", action="store_true", help="the same as a map: shape.obj with its picture, shape.glb")
    parser.add_argument("--prior", type=Path, metavar="FILE",
                        help="surface in metres where the first sweep starts; default: that of the sparse points")


def run(arguments: argparse.Namespace) -> int:
    """Reconstruct, with progress and time left."""
    if arguments.place_sigma_m is not None and arguments.poses != "prior":
        raise ConfigError("--place-sigma-m", "must be left out without --poses prior", arguments.place_sigma_m,
                          "add --poses prior")
    with tqdm(total=len(STAGES), unit="stage", disable=None, bar_format="{desc}: {percentage:3.0f} %|{bar}| "
              "[{elapsed}<{remaining}]") as bar:
        def show(stage: str, done: float) -> None:
            bar.set_description(stage, refresh=False)
            bar.n = STAGES.index(stage) + done
            bar.refresh()

        try:
            prior = None if arguments.prior is None else Mesh.from_file(arguments.prior)
            frames = [replace(frame, place_sigma_m=arguments.place_sigma_m)
                      for frame in posed_frames(arguments.folder, arguments.body)]
            found = reconstruct(frames, poses=arguments.poses, prior=prior, folder=arguments.out, progress=show)
        except ConfigError:
            raise
        except ValueError as error:
            field, _, rest = str(error).partition(": ")
            raise ConfigError(field, rest) from None
    brightness = vertex_brightness(found.frames, found.shape) if arguments.texture else None
    found.shape.to_file(arguments.out / "shape.ply", brightness)
    if arguments.map:
        surface = textured(found.frames, found.shape)
        for ending in ("obj", "glb"):
            surface.export(arguments.out / f"shape.{ending}")
    report = found.report
    (arguments.out / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    for text in (*report["warnings"], *(f"{name} is left out: {why}" for name, why in report["left_out"].items())):
        sys.stderr.write(f"glrender: warning: {text}\n")
    sys.stdout.write(f"{arguments.out / 'shape.ply'}: {len(found.shape.facets)} facets of {report['frames']} frames, "
                     f"{report['points']} points, {report['px_m']:.3g} m a pixel\n")
    return 0
