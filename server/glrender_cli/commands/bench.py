"""`glrender bench`: how long frames of a scene take on this machine, by tolerance."""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace

import numpy as np
from glrender import frames, open_renderer
from glrender_camera.validate import within

from ..subject import add_subject, read_subject, state_of

_TOLERANCES = (0.1, 0.05, 0.02, 0.01)
_LEAST_FRAMES = 3
_TURN_RAD = np.radians(0.5)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender bench`."""
    add_subject(parser)
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S", help="for each tolerance (5)")
    parser.add_argument("--backend", default="auto")
    parser.add_argument("--json", action="store_true")


def run(arguments: argparse.Namespace) -> int:
    """Draw frames of a body that turns, and print the medians."""
    seconds = within("--seconds", arguments.seconds, 0.1, 3600.0)
    subject = read_subject(arguments.subject, arguments.unit)
    camera = subject.scene.camera(arguments.camera) if arguments.camera else subject.scene.cameras[0]
    state, rows = state_of(subject, arguments, camera), []
    with open_renderer(subject.scene, arguments.backend) as renderer:
        for max_error in _TOLERANCES:
            renderer.render(_turned(state, -1), camera.name, max_error=max_error)  # tables and maps that are made once
            took_ms, until = [], time.monotonic() + seconds
            while len(took_ms) < _LEAST_FRAMES or time.monotonic() < until:
                turned, began = _turned(state, len(took_ms)), time.perf_counter()
                image = renderer.render(turned, camera.name, max_error=max_error)
                took_ms.append(1e3 * (time.perf_counter() - began))
            row = {"max_error": max_error, "median_ms": float(np.median(took_ms)), "frames": len(took_ms),
                   "p95_ms": float(np.quantile(took_ms, 0.95)), "predicted_error": float(image.plan.predicted_error),
                   "engine": "+".join(dict.fromkeys(window.engine for window in image.plan.windows)) or "none"}
            rows.append(row)
            if not arguments.json:
                sys.stdout.write("max_error {max_error:<5g} {median_ms:8.1f} ms, 95 % within {p95_ms:.1f} ms, by "
                                 "{engine}, predicted error {predicted_error:.2g}\n".format_map(row))
                sys.stdout.flush()
    if arguments.json:
        sys.stdout.write(json.dumps(rows) + "\n")
    return 0


def _turned(state, step: int):
    """The state with all bodies turned by some half degrees about their Z: no frame is drawn twice."""
    angle = _TURN_RAD * (step + 1)
    spin = frames.dcm(np.array([np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)]))
    return replace(state, bodies={
        name: replace(pose, q_from_inertial=frames.quaternion(spin @ frames.dcm(pose.q_from_inertial)))
        for name, pose in state.bodies.items()})
