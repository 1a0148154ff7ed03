"""`glrender`: info, render, check, sequence, demo, top, keygen."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import time
from pathlib import Path

import numpy as np
from glrender import (
    ConfigError,
    GlrenderError,
    Pose,
    Scene,
    State,
    __version__,
    draw_still,
    frames,
    load_scene,
    open_renderer,
    take_frame,
)
from glrender.base.constants import AU_M
from glrender.engines.advice import scene_advice
from glrender.scene.plugins import registry as plugins
from glrender.sequences.contact_sheet import grey_levels
from glrender_camera.validate import within

from .logs import is_ours

_STARTED = time.monotonic()


def _waited_s() -> float:
    """Seconds since this process began: by Linux' own count, elsewhere since this module was imported."""
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, ValueError, IndexError):
        return time.monotonic() - _STARTED


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script."""
    parser = argparse.ArgumentParser(prog="glrender", description=__doc__)
    parser.add_argument("--version", action="version", version=f"glrender {__version__}")
    parser.add_argument("-v", "--verbose", action="store_true", help="log what happens inside")
    commands = parser.add_subparsers(dest="command", required=True)

    info = commands.add_parser("info", help="which OpenGL was found, its limits, and what to install if none")
    info.add_argument("--json", action="store_true")
    info.set_defaults(run=_info)

    render = commands.add_parser("render", help="draw one frame of a scene file")
    render.add_argument("scene", type=Path, help="scene file (TOML)")
    render.add_argument("--state", type=Path,
                        help="state vector (JSON); default: the first body from the side, filling half the frame")
    render.add_argument("--phase-deg", type=float, default=60.0, help="of the default state (60)")
    render.add_argument("--camera", help="default: the first")
    render.add_argument("--max-error", type=float)
    render.add_argument("--samples", type=int, help="along a pixel's side; default: what the budget needs")
    render.add_argument("--output", default="irradiance", choices=("irradiance", "dn"),
                        help="irradiance, or the digital numbers of the camera's detector")
    render.add_argument("--exposure-s", help="with dn: seconds, or auto; default: the camera's")
    render.add_argument("--seed", type=int, default=0, help="of the noise, with dn (0)")
    render.add_argument("--backend", default="auto", help="auto, egl, osmesa, or a plug-in such as raytrace or cycles")
    render.add_argument("--out", type=Path, default=Path("frame.png"),
                        help=".npy: float32 irradiance [W/m2 per pixel] or DN; .png: a display picture, gamma 2.2")
    render.set_defaults(run=_render)

    check = commands.add_parser("check", help="what a scenario is, and what is odd in it; draws nothing")
    check.add_argument("scenario", type=Path, help="scenario file (TOML)")
    sequence = commands.add_parser("sequence", help="draw frames of many states as files, on all cores")
    from . import sequence_command

    sequence_command.add_arguments(sequence)
    sequence.set_defaults(run=sequence_command.run_sequence)
    check.set_defaults(run=sequence_command.run_check)

    demo = commands.add_parser("demo", help="fly a closed loop around a body through the server")
    from .demo import add_arguments, run_demo

    add_arguments(demo)
    demo.set_defaults(run=run_demo)

    top = commands.add_parser("top", help="how a running server does, on one screen")
    from . import top as top_command

    top_command.add_arguments(top)
    top.set_defaults(run=top_command.run_top)

    keygen = commands.add_parser("keygen", help="make CURVE keys: the server's, and one pair for each client")
    keygen.add_argument("folder", type=Path)
    keygen.add_argument("--client", action="append", default=[], metavar="NAME", help="may be given several times")
    keygen.set_defaults(run=_keygen)

    arguments = parser.parse_args(argv)
    handler = logging.StreamHandler()
    handler.addFilter(is_ours)
    logging.basicConfig(level=logging.INFO if arguments.verbose else logging.WARNING, handlers=[handler],
                        format="%(levelname)s %(name)s: %(message)s")
    try:
        return arguments.run(arguments) or 0
    except (GlrenderError, OSError) as error:
        sys.stderr.write(f"glrender: {error}\n")
        return 1


def _info(arguments: argparse.Namespace) -> int:
    from glrender.engines.raster.gl.context import INSTALL_HINT, probe

    found = probe()
    works = any("error" not in entry for entry in found)
    if arguments.json:
        sys.stdout.write(json.dumps(found, indent=2) + "\n")
        return 0 if works else 1
    for entry in found:
        backend = entry.pop("backend")
        if "error" in entry:
            sys.stdout.write(f"{backend}: does not work: {entry['error']}\n")
            continue
        sys.stdout.write(f"{backend}: works\n")
        sys.stdout.writelines(f"  {key:24} {value}\n" for key, value in entry.items())
    sys.stdout.writelines(f"plug-in: {problem}\n" for problem in plugins.problems())
    if not works:
        sys.stdout.write(f"Nothing works: {INSTALL_HINT}\n")
    return 0 if works else 1


def _keygen(arguments: argparse.Namespace) -> int:
    from . import keys

    for path in keys.generate(arguments.folder, arguments.client):
        sys.stdout.write(f"{path}\n")
    return 0


def _render(arguments: argparse.Namespace) -> int:
    ending = arguments.out.suffix.lower()
    if ending not in (".png", ".npy"):
        raise ConfigError(str(arguments.out), "must end in .png or .npy")
    scene = load_scene(arguments.scene)
    camera = scene.camera(arguments.camera) if arguments.camera else scene.cameras[0]
    if arguments.state is not None:
        try:
            state = State.from_dict(json.loads(arguments.state.read_text(encoding="utf-8")))
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            raise ConfigError(str(arguments.state), f"is not JSON: {error}") from None
    else:
        phase_deg = within("phase-deg", arguments.phase_deg, 0.0, 180.0)
        state = default_state(scene, camera.name, np.radians(phase_deg))
    options = {"max_error": arguments.max_error, "samples": arguments.samples}
    with open_renderer(scene, arguments.backend) as renderer:
        if arguments.output == "dn":
            exposure_s = arguments.exposure_s
            if exposure_s not in (None, "auto"):
                exposure_s = _number("exposure-s", exposure_s)
            capture = take_frame(renderer, state, camera.name, seed=arguments.seed, exposure_s=exposure_s, **options)
            pixels, dark = capture.frame.dn, camera.model.detector.offset_DN
        else:
            capture = draw_still(renderer, state, camera.name, **options)
            pixels, dark = capture.irradiance_W_m2, 0.0
    for advice in (*scene_advice(scene), *capture.warnings):
        sys.stderr.write(f"glrender: warning: {advice}\n")
    for stage, text in capture.stages.items():
        logging.getLogger(__name__).info("%s: %s", stage, text)
    if ending == ".npy":
        with open(arguments.out, "wb") as file:  # given a name, NumPy would add its own ending to .NPY
            np.save(file, pixels)
    else:
        write_picture(arguments.out, pixels.astype(np.float32) - np.float32(dark))
    sys.stdout.write(f"{arguments.out}: {camera.width_px} x {camera.height_px}, error "
                     f"{capture.plan.predicted_error:.2g} of {capture.plan.max_error:g} allowed, "
                     f"{_waited_s():.1f} s with start-up\n")
    return 0


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(name, "must be a number of seconds, or auto", text) from None


def default_state(scene: Scene, camera_name: str, phase_rad: float) -> State:
    """The scene's first body at the origin, 1 au from the Sun, filling about half of a camera's frame.

    Other bodies stand in a row beside it, out of the way.
    """
    camera = scene.camera(camera_name)
    body, *others = scene.bodies
    range_m = 4.0 * body.hull.radius_m * camera.focal_length_px / min(camera.width_px, camera.height_px)
    r_camera = np.array([0.0, -range_m, 0.0])
    r_sun = AU_M * np.array([np.sin(phase_rad), -np.cos(phase_rad), 0.0])
    poses = {body.name: Pose(r_inertial_m=-body.shape.centre_m)}
    offset = body.hull.radius_m
    for other in others:
        offset += 1.5 * other.hull.radius_m
        poses[other.name] = Pose(r_inertial_m=np.array([offset, 0.0, 0.0]) - other.shape.centre_m)
        offset += 1.5 * other.hull.radius_m
    q_camera = frames.look_at(r_camera, np.zeros(3))
    q_spacecraft = frames.quaternion(frames.dcm(camera.q_camera_from_spacecraft).T @ frames.dcm(q_camera))
    r_spacecraft = r_camera - frames.dcm(q_spacecraft).T @ camera.r_camera_spacecraft_m
    return State(r_sun_inertial_m=r_sun, bodies=poses,
                 spacecraft=Pose(r_inertial_m=r_spacecraft, q_from_inertial=q_spacecraft))


def write_picture(path: Path, irradiance: np.ndarray) -> None:
    """An 8-bit picture for the eye: scaled to the brightest 0.1 %, gamma 2.2."""
    from PIL import Image

    lit = irradiance[irradiance > 0.0]
    white = np.quantile(lit, 0.999) if lit.size else 1.0
    Image.fromarray(grey_levels(irradiance, white)).save(path)


if __name__ == "__main__":
    sys.exit(main())
