"""The closed-loop demo: a spacecraft finds its way to a body and round it by its camera alone.

Two servers run in processes of their own: one has the true body, the other its on-board model, of a tenth of
the facets. Each step posts the true state to the first, gets the frame that the navigation camera would have taken,
and steers by the on-board estimate. The on-board side has the second server, frames and its own estimate alone.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from glrender import ConfigError, Pose, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.scenario import Belief, load_believed_scene
from glrender.scenario.belief.decimation import checked_share
from glrender.sequences.contact_sheet import contact_sheet
from glrender.sequences.folder import made
from glrender_camera.validate import integer
from glrender_campaign.onboard import OF_FRAMES, OnBoard
from glrender_client import Client
from glrender_navigation import BelievedBody, Camera, Navigator
from tqdm import tqdm

from ..autopilot import ReferencePath
from ..own_server import OwnServer
from ..tolerance import read_max_error

_FOCAL_LENGTH_PX_PER_WIDTH = 3.2
_APERTURE_M = 0.003
_SPIN_PERIOD_S = 4.0 * 3600.0
_STEP_S = 60.0
_SUN_DISTANCE_AU = 1.0
# What the demo's extras bring, and what a demo without it is.
_MODULES = {"belief": "fast_simplification", "plots": "matplotlib"}
_WITHOUT = {"belief": "the on-board model is the true shape", "plots": "there is no plot of the trajectory"}
# The path is steered back to in a tenth of the flight: of fewer steps the loop overshoots, and loses the body.
_MIN_FRAMES = 24


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `glrender demo`."""
    parser.add_argument("--shape", type=Path, help="shape file; default: a generated contact binary")
    parser.add_argument("--length-unit", default="km", help="of the shape file: m, km, or metres per unit (km)")
    parser.add_argument("--frames", type=int, default=240, help=f"steps of the loop, at least {_MIN_FRAMES} (240)")
    parser.add_argument("--size-px", type=int, default=512, help="side of the image (512)")
    parser.add_argument("--max-error", default="0.1", help="the planner's budget (0.1)")
    parser.add_argument("--estimator", choices=tuple(OF_FRAMES), default="model",
                        help="how the body is found in a frame: `model` renders the estimated state by the on-board "
                             "model, `sphere` takes a sphere for it (model)")
    parser.add_argument("--belief", metavar="SHARE",
                        help="of the true shape's facets that the on-board model has (0.1; exact without the extra "
                             "belief); exact: the true shape")
    parser.add_argument("--seed", type=int, default=1, help="of the body, the sensor and the manoeuvres (1)")
    parser.add_argument("--backend", default="auto", choices=("auto", "egl", "osmesa"))
    parser.add_argument("--view", type=int, metavar="PORT", help="show the frames on a page meanwhile; 0: a free port")
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for pictures and plots")


@dataclass
class _Log:
    """One row a step."""

    t_s: list
    r_true_m: list
    r_estimated_m: list
    latency_ms: list
    pictures: list
    handover_error_m: float


def run(arguments: argparse.Namespace) -> int:
    """Fly the loop and leave pictures, plots and `summary.json`."""
    integer("frames", arguments.frames, _MIN_FRAMES, 100_000)
    integer("size-px", arguments.size_px, 64, 4096)
    read_max_error(arguments.max_error, "max-error")
    lacking = {extra for extra, module in _MODULES.items() if find_spec(module) is None}
    if lacking:
        say(f"Without the extra `demo` {' and '.join(_WITHOUT[extra] for extra in sorted(lacking))}: "
            "pip install 'glrender[demo]'")
    share = _share(arguments.belief or ("exact" if "belief" in lacking else "0.1"))
    with tempfile.TemporaryDirectory(prefix="glrender-demo-") as folder, ExitStack() as stack:
        scene_file, shape = _write_scene(Path(folder), arguments)
        belief_file = scene_file.with_name("belief.toml")
        belief_file.write_text(f'scene = "{scene_file.name}"\n[belief.bodies.body]\nfacets = {share}\n')
        believed = load_believed_scene(belief_file).bodies[0].shape
        made(arguments.out)
        say(f"Body: {len(shape.facets)} facets, {2.0 * shape.radius_m:.4g} m across; its on-board model has "
            f"{len(believed.facets)}{', the same' * (share == 1.0)}")
        options = ["--backend", arguments.backend]
        view = [] if arguments.view is None else ["--view", arguments.view]
        servers = [OwnServer([scene_file, *options, *view]),
                   OwnServer([belief_file, "--belief", "--no-load-scene", *options])]
        # Both start at once.
        for server in servers:
            stack.enter_context(server)
        client, onboard_client = (stack.enter_context(Client(server.endpoint(), timeout_s=30.0)) for server in servers)
        hello = client.hello()
        say(f"Server: {servers[0].endpoint()}, {hello.get('gl_renderer') or hello.get('renderer')}; of the on-board "
            f"model: {servers[1].endpoint()}" + "".join(f"; view: {server.page}" for server in servers if server.page))
        log, elapsed_s = _fly(client, onboard_client, shape, believed, arguments)
    return _report(log, elapsed_s, shape, believed, arguments)


def _share(text: str) -> float:
    try:
        return 1.0 if text == "exact" else checked_share("belief", float(text))
    except ValueError as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError("belief", "must be a share of the facets, or exact", text, "0.1 is a tenth") from None


def _toml(max_error: float | dict[str, float]) -> str:
    if not isinstance(max_error, dict):
        return str(max_error)
    return f"{{ {', '.join(f'{unit} = {number}' for unit, number in max_error.items())} }}"


def _write_scene(folder: Path, arguments: argparse.Namespace) -> tuple[Path, Shape]:
    if arguments.shape is None:
        shape = generate.contact_binary(radius_m=300.0, seed=arguments.seed)
    else:
        shape = Shape.from_file(arguments.shape, length_unit=_length_unit(arguments.length_unit))
    shape.to_file(folder / "body.obj")
    size = arguments.size_px
    scene = f"""
max_error = {_toml(read_max_error(arguments.max_error))}

[[bodies]]
name = "body"
shape = "body.obj"
length_unit = "m"
brdf = {{ law = "hapke", single_scattering_albedo = 0.33, b = 0.25, c = 1.0, shoe_amplitude = 1.0, \
shoe_width = 0.05, roughness_deg = 28.0 }}

[[cameras]]
name = "navcam"
width_px = {size}
height_px = {size}
focal_length_px = {_FOCAL_LENGTH_PX_PER_WIDTH * size}

[cameras.model]
exposure_s = "auto"
optics = {{ aperture_diameter_m = {_APERTURE_M}, transmission = 0.8, psf_sigma_px = 0.6 }}

[cameras.model.detector]
quantum_efficiency = 0.5
full_well_electrons = 30000.0
gain_DN_per_electron = 0.008
bit_depth = 8
offset_DN = 5.0
read_noise_electrons = 40.0
dark_current_electrons_per_s = 20.0
photo_response_nonuniformity = 0.01
"""
    scene_file = folder / "scene.toml"
    scene_file.write_text(scene, encoding="utf-8")
    return scene_file, shape


def _length_unit(text: str) -> str | float:
    if text in ("m", "km"):
        return text
    try:
        return float(text)
    except ValueError:
        raise ConfigError("length-unit", "must be m, km, or metres per unit", text) from None


def _fly(client: Client, onboard_client: Client, shape: Shape, believed: Shape,
         arguments: argparse.Namespace) -> tuple[_Log, float]:
    rng = np.random.default_rng(arguments.seed)
    size = arguments.size_px
    focal_length_px = _FOCAL_LENGTH_PX_PER_WIDTH * size
    sun_direction = np.array([np.cos(0.6), -np.sin(0.6), 0.1])
    sun_direction /= np.linalg.norm(sun_direction)
    path = ReferencePath(radius_m=shape.radius_m, sun_direction=sun_direction, n_steps=arguments.frames,
                         step_s=_STEP_S, fill=0.5 / (size / focal_length_px))
    r_true, v_true = path(0.0)
    # The navigator starts with the position to a tenth of the range.
    handover_m = 0.1 * np.linalg.norm(r_true)
    navigator = Navigator(r_true + handover_m * rng.standard_normal(3) / np.sqrt(3.0),
                          v_true + 1e-4 * handover_m / _STEP_S * rng.standard_normal(3),
                          sigma_r_m=handover_m, sigma_v_m_s=0.002 * handover_m / _STEP_S)
    estimator = OF_FRAMES[arguments.estimator](
        Camera(width_px=size, height_px=size, focal_length_px=focal_length_px),
        BelievedBody.from_mesh("body", believed.vertices_m, believed.facets))
    # The on-board model: one sample a pixel, noise of its own, from where it believes to be.
    onboard = OnBoard(estimator, navigator, partial(onboard_client.render, camera="navcam", samples=1))
    log = _Log([], [], [], [], [], float(np.linalg.norm(onboard.r_m - r_true)))
    began = time.perf_counter()
    for step in tqdm(range(arguments.frames), desc="closed loop", unit="frame"):
        t_s = step * _STEP_S
        # Attitude follows the estimate; the star tracker is exact here.
        q_camera = frames.look_at(onboard.r_m, np.zeros(3))
        spin = 2.0 * np.pi * t_s / _SPIN_PERIOD_S
        state = State(
            t_s=t_s, r_sun_inertial_m=sun_direction * _SUN_DISTANCE_AU * AU_M,
            spacecraft=Pose(r_inertial_m=r_true, q_from_inertial=q_camera),
            bodies={"body": Pose(r_inertial_m=np.zeros(3),
                                 q_from_inertial=[np.cos(spin / 2), 0.0, 0.0, -np.sin(spin / 2)])})
        asked = time.perf_counter()
        reply = client.render(state.to_dict(), camera="navcam", output="dn", exposure_s="auto",
                              seed=arguments.seed * 1_000_003 + step)
        log.latency_ms.append(1e3 * (time.perf_counter() - asked))
        estimated = Pose(r_inertial_m=onboard.r_m, q_from_inertial=q_camera)
        found = onboard.take(reply.pixels, Belief().state(state, estimated))
        log.t_s.append(t_s)
        log.r_true_m.append(r_true.copy())
        log.r_estimated_m.append(onboard.r_m)
        log.pictures.append((reply.pixels, None if found is None else found.center_px))
        # Steer the estimate onto the path; the thrusters err by 2 %.
        command = path.steer(t_s, onboard.r_m, onboard.v_m_s)
        onboard.fly(command, _STEP_S)
        actual = command * (1.0 + 0.02 * rng.standard_normal(3))
        r_true = r_true + v_true * _STEP_S + 0.5 * actual * _STEP_S**2
        v_true = v_true + actual * _STEP_S
    return log, time.perf_counter() - began


def _report(log: _Log, elapsed_s: float, shape: Shape, believed: Shape, arguments: argparse.Namespace) -> int:
    r_true, r_estimated = np.array(log.r_true_m), np.array(log.r_estimated_m)
    error_m = np.linalg.norm(r_estimated - r_true, axis=1)
    range_m = np.linalg.norm(r_true, axis=1)
    settled = slice(len(error_m) // 3, None)  # the loop has converged by then
    rms_m = float(np.sqrt(np.mean(error_m[settled] ** 2)))
    p50, p95, p99 = np.percentile(log.latency_ms[1:], [50, 95, 99])
    summary = {
        "frames": len(error_m), "frames_per_second": len(error_m) / elapsed_s,
        "estimator": arguments.estimator, "facets": {"true": len(shape.facets), "on_board": len(believed.facets)},
        "latency_ms": {"p50": p50, "p95": p95, "p99": p99},
        "navigation_error_m": {"handover": log.handover_error_m, "rms_settled": rms_m,
                               "final": float(error_m[-1])},
        "navigation_error_over_range": float(np.sqrt(np.mean((error_m / range_m)[settled] ** 2))),
        "range_m": {"first": float(range_m[0]), "last": float(range_m[-1])},
    }
    (arguments.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    pictures = _write_pictures(arguments.out, log, shape)
    say(f"{summary['frames']} frames, {summary['frames_per_second']:.1f} frames per second; request to frame "
        f"p50 {p50:.1f} ms, p95 {p95:.1f} ms, p99 {p99:.1f} ms")
    say(f"Navigation error, with an on-board model of {len(believed.facets)} of {len(shape.facets)} facets: "
        f"{log.handover_error_m:.1f} m at handover, {rms_m:.1f} m RMS "
        f"once settled ({100.0 * summary['navigation_error_over_range']:.2f} % of the range), "
        f"{error_m[-1]:.1f} m at the end")
    say(f"Pictures: {', '.join(map(str, pictures))}; numbers: {arguments.out}/summary.json")
    lost = not error_m[-1] < 0.1 * range_m[-1]
    if lost:
        say("The loop lost the body: the navigation error is above 10 % of the range.")
    return 1 if lost else 0


def _write_pictures(folder: Path, log: _Log, shape: Shape) -> list[Path]:
    """Write frames of the flight and, with matplotlib, their found centres and the trajectory."""
    r_true, sheet, plot = np.array(log.r_true_m), folder / "contact_sheet.png", folder / "trajectory.png"
    try:
        from ..demo_plots import centres_sheet, trajectory_plot
    except ImportError:
        chosen = np.unique(np.linspace(0, len(log.pictures) - 1, 20).astype(int))
        contact_sheet(sheet, [(f"frame {index}", log.pictures[index][0]) for index in chosen])
        return [sheet]
    centres_sheet(sheet, log.pictures, log.t_s, np.linalg.norm(r_true, axis=1))
    trajectory_plot(plot, np.array(log.t_s), r_true, np.array(log.r_estimated_m), shape.radius_m,
                    np.array(log.latency_ms))
    return [sheet, plot]


def say(line: str) -> None:
    """Write a line to the person at the terminal."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
