"""`glrender init`: a scene file or a whole scenario with comments, to start from."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from glrender import ConfigError

from ..new_files import EXAMPLE, SCENARIOS, scenario_text, write_new
from ..subject import read_subject

_SCENE = """\
# A scene: bodies, cameras, and how exact a frame must be. Fields: docs/scene.md. Try it:
#   glrender check {file}
#   glrender render {file} --out frame.png
#   glrender-server {file}
max_error = 0.02                # RMS error of a frame over the mean of its lit pixels
sun_disc = true                 # shadows have penumbras; false: the Sun is a point

[[bodies]]
name = {name}                   # states give its pose under this name
{shape}
brdf = {{ law = "lommel_seeliger", single_scattering_albedo = 0.1 }}   # or {{ preset = "eros_550nm" }}
# albedo_texture = "albedo.jpg"  # for shapes with texture coordinates

[[cameras]]
name = "navcam"
width_px = 1024
height_px = 1024
focal_length_px = 5000.0        # focal length over pixel pitch
# principal_point_px = [511.5, 511.5]                  # the image's centre
# q_camera_from_spacecraft = [1.0, 0.0, 0.0, 0.0]      # scalar first; the camera looks along +Z, x right, y down
# r_camera_spacecraft_m = [0.0, 0.0, 0.0]
# distortion = {{ k1 = -0.01 }}                          # Brown-Conrady
model = {{ preset = "generic_navigation_camera", exposure_s = "auto" }}   # optics and detector: docs/camera_model.md

# [stars]                       # behind the bodies, with digital numbers: pip install 'glrender[stars]'
# magnitude_limit = 7.0
# year = 2031.5
"""
_GENERATED = """\
# shape = "body.obj"            # and length_unit = "km" or "m"
generated = { kind = "contact_binary", radius_m = 300.0, seed = 1 }"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender init`."""
    parser.add_argument("shape", type=Path, nargs="?", help="shape file; default: a generated contact binary")
    parser.add_argument("--unit", help="of the shape file, which carries none: m, km, or metres per unit")
    parser.add_argument("--example", action="store_true", help=f"of Itokawa, whose shape is written as {EXAMPLE} too")
    parser.add_argument("--scenario", choices=SCENARIOS, help="write a whole scenario of the example's body instead, "
                                                              "with the files that it names")
    parser.add_argument("--out", type=Path, metavar="FILE", help="never replaced (scene.toml, or scenario.toml)")


def run(arguments: argparse.Namespace) -> int:
    """Write the file, once the shape of a scene could be read."""
    file = arguments.out or Path("scene.toml" if arguments.scenario is None else "scenario.toml")
    if file.suffix.lower() != ".toml":
        raise ConfigError("--out", "must end in .toml", str(file))
    if not file.parent.is_dir():
        raise ConfigError("--out", "must be in a folder that is there", str(file), f"mkdir -p {file.parent}")
    if arguments.shape is not None and (arguments.example or arguments.scenario):
        raise ConfigError("--example" if arguments.example else "--scenario", "has a shape of its own",
                          str(arguments.shape), "leave one out, and write your shape into the file")
    if arguments.scenario:
        write_new(file, scenario_text(arguments.scenario, file), (EXAMPLE, *SCENARIOS[arguments.scenario]))
        sys.stdout.write(f"{file}: next, `glrender check {file}` and `glrender "
                         f"{'dataset' if arguments.scenario == 'dataset' else 'sequence'} {file} --out frames`\n")
        return 0
    name, shape = "body", _GENERATED
    if arguments.example:
        name, shape = Path(EXAMPLE).stem, _shape(EXAMPLE, "km")
    elif arguments.shape is not None:
        if arguments.shape.suffix.lower() == ".toml":
            raise ConfigError("shape", "must be a shape file", str(arguments.shape))
        read_subject(arguments.shape, arguments.unit)
        name, shape = arguments.shape.stem, _shape(_from_folder(arguments.shape, file.parent), arguments.unit)
    text = _SCENE.format(file=file.name, name=json.dumps(name), shape=shape)
    write_new(file, text, (EXAMPLE,) if arguments.example else ())
    sys.stdout.write(f"{file}: next, `glrender check {file}` and `glrender render {file} --out frame.png`\n")
    return 0


def _shape(path: str | Path, unit: str | None) -> str:
    """A body's lines for a shape file; one that has its own unit comes without."""
    text = f"shape = {json.dumps(str(path))}"
    if unit is None:
        return text
    return f"{text}\nlength_unit = {json.dumps(unit) if unit in ('m', 'km') else unit}"


def _from_folder(shape: Path, folder: Path) -> Path:
    """The shape's path from the scene file's folder, or its absolute path where it lies elsewhere."""
    shape, folder = shape.resolve(), folder.resolve()
    return shape.relative_to(folder) if shape.is_relative_to(folder) else shape
