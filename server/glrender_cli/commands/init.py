"""`glrender init`: a scene file with comments, to start from."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from glrender import ConfigError

from ..new_files import EXAMPLE, write_new
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
    parser.add_argument("--out", type=Path, default=Path("scene.toml"), metavar="FILE",
                        help="never replaced (scene.toml)")


def run(arguments: argparse.Namespace) -> int:
    """Write the scene file, once its shape could be read."""
    file = arguments.out
    if file.suffix.lower() != ".toml":
        raise ConfigError("--out", "must end in .toml", str(file))
    if not file.parent.is_dir():
        raise ConfigError("--out", "must be in a folder that is there", str(file), f"mkdir -p {file.parent}")
    name, shape = "body", _GENERATED
    if arguments.example:
        if arguments.shape is not None:
            raise ConfigError("--example", "has a shape of its own", str(arguments.shape), "leave one out")
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
