"""Frames that take far longer than their neighbours: `python benchmarks/cliffs.py [--count N] [--first SEED]`.

Each seed is a random frame: a shape, a law, one body or two, 1 to 2000 px, 0 to 180 deg of phase, a tolerance of 0.1
to 0.005, with the Sun's disc or without, at times behind a distorting lens. Processor times are held against the median
of frames whose largest body has a like size in the image. Writes out/cliffs.json, prints the slowest, and fails where
one takes more than `MOST_TIMES` times the median of its size, or more than `MOST_S` at a tolerance of 0.01 or more.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from accuracy.random_scenes import names, shape
from accuracy.scenes import HAPKE
from glrender import Body, Pose, Renderer, Scene, State, draw_still, frames
from glrender.base.constants import AU_M
from glrender.brdf import Lambert, LommelSeeliger, LunarLambert, Minnaert
from glrender_camera import BrownConrady, PinholeCamera

MOST_TIMES = 30.0
"""Largest processor time over the median of frames of a like size."""
MOST_S = 1.0
"""Processor time [s] of a frame of 1024 x 1024 px at a tolerance of 0.01 or more."""
FRAME_PX = 1024
# The largest size that is drawn by lot [px], and edges of sizes whose frames are alike.
_MOST_PX = 2000.0
_SIZES_PX = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, _MOST_PX + 0.1)
_LAWS = (Lambert(normal_albedo=0.3), LommelSeeliger(single_scattering_albedo=0.06), LunarLambert(normal_albedo=0.2),
         Minnaert(normal_albedo=0.2, exponent=0.7), HAPKE)
_LENS = BrownConrady(k1=-0.05)


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A random frame and its random numbers."""

    scene: Scene
    state: State
    told: dict


def draw(seed: int, shapes: list[str]) -> Frame:
    """A random frame; equal seeds, equal frames."""
    rng = np.random.default_rng([20261126, seed])
    names_drawn = [str(rng.choice(shapes)) for _ in range(2 if rng.random() < 0.25 else 1)]
    bodies = [Body(name=f"body{k}", shape=shape(name), brdf=_LAWS[rng.integers(len(_LAWS))])
              for k, name in enumerate(names_drawn)]
    size_px, phase = float(_MOST_PX ** rng.random()), float(np.radians(rng.uniform(0.0, 180.0)))
    radius_m = bodies[0].shape.radius_m
    range_m = radius_m * float(2.5 * 400.0 ** rng.random())
    has_lens = bool(rng.random() < 0.1)
    camera = PinholeCamera(name="camera", width_px=FRAME_PX, height_px=FRAME_PX,
                           focal_length_px=max(size_px * range_m / (2.0 * radius_m), 1000.0),
                           distortion=_LENS if has_lens else None)
    direction, up = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
    q = frames.look_at(range_m * direction, np.zeros(3), up)
    sideways = frames.dcm(q)[0]
    poses = {"body0": Pose(r_inertial_m=np.zeros(3), q_from_inertial=_turn(rng))}
    if len(bodies) > 1:
        aside = (radius_m + bodies[1].shape.radius_m) * (1.1 + rng.random()) * frames.dcm(_turn(rng))[0]
        if range_m < 2.0 * np.linalg.norm(aside):
            aside -= direction * float(aside @ direction)
        poses["body1"] = Pose(r_inertial_m=aside, q_from_inertial=_turn(rng))
    state = State(r_sun_inertial_m=AU_M * float(rng.uniform(0.7, 4.0)) * (
        np.cos(phase) * direction + np.sin(phase) * sideways),
        spacecraft=Pose(r_inertial_m=range_m * direction, q_from_inertial=q), bodies=poses)
    tolerance, disc = float(0.005 * 20.0 ** rng.random()), bool(rng.random() < 0.5)
    return Frame(scene=Scene(bodies=bodies, cameras=[camera], sun_disc=disc, max_error=tolerance), state=state,
                 told={"seed": seed, "shapes": names_drawn, "laws": [type(body.brdf).__name__ for body in bodies],
                       "size_px": size_px, "phase_deg": float(np.degrees(phase)), "tolerance": tolerance,
                       "sun_disc": disc, "lens": has_lens})


def timed(frame: Frame) -> dict:
    """Processor time [s] of the second of two frames, and how it was drawn."""
    with Renderer(frame.scene) as renderer:
        for _ in range(2):
            begin = time.process_time()
            if frame.told["lens"]:
                plan = draw_still(renderer, frame.state).plan
            else:
                plan = renderer.render(frame.state).plan
            seconds = time.process_time() - begin
    # What the camera is near is larger than was drawn by lot.
    size_px = max((body.size_px for body in plan.bodies if body.is_visible), default=1.0)
    return frame.told | {"size_px": min(max(size_px, 1.0), _MOST_PX), "seconds": seconds,
                         "predicted_error": plan.predicted_error, "engines": [window.engine for window in plan.windows]}


def ranked(rows: list[dict]) -> list[dict]:
    """The frames, slowest first over the median of their size."""
    done = []
    for low, high in zip(_SIZES_PX, _SIZES_PX[1:], strict=False):
        part = [row for row in rows if low <= row["size_px"] < high]
        median = float(np.median([row["seconds"] for row in part])) if part else 0.0
        done += [row | {"times": row["seconds"] / max(median, 1e-3)} for row in part]
    return sorted(done, key=lambda row: -row["times"])


def _turn(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(4)
    return vector / np.linalg.norm(vector)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=600)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent.parent / "out")
    arguments = parser.parse_args()
    shapes, rows = names(), []
    for seed in range(arguments.first, arguments.first + arguments.count):
        try:
            rows.append(timed(draw(seed, shapes)))
            sys.stderr.write(f"{seed}: {rows[-1]['seconds']:.3f} s\n")
        except ValueError as error:
            sys.stderr.write(f"{seed}: {error}\n")
    rows = ranked(rows)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "cliffs.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    for row in rows[:20]:
        sys.stdout.write(json.dumps(row) + "\n")
    slow = [row for row in rows if row["times"] > MOST_TIMES or (row["tolerance"] >= 0.01 and row["seconds"] > MOST_S)]
    sys.stdout.write(f"{len(rows)} frames, {len(slow)} too slow\n")
    sys.exit(1 if slow else 0)


if __name__ == "__main__":
    main()
