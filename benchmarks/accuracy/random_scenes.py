"""Random scenes that nothing was fitted to: equal seeds, equal scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from glrender import Body, PinholeCamera, Pose, Scene, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert, LommelSeeliger, LunarLambert

from .scenes import HAPKE, data_file

FRAME_PX = 320
_FILES = {"itokawa 3k": "itokawa/itokawa_16q_3072.obj", "itokawa 12k": "../../glrender/data/itokawa.obj",
          "itokawa 49k": "itokawa/itokawa_64q_49152_uv.obj", "bennu 49k": "bennu/bennu_49k.ply",
          "67p 4k": "67p/67p-4k.obj", "67p 16k": "67p/67p-16k.obj", "eva": "damit/Eva.obj",
          "didymos 49k": "didymos/didymos_49k.obj", "dimorphos 49k": "didymos/dimorphos_49k.ply"}
_MADE: dict[str, Callable[[], Shape]] = {
    "sphere 20k": lambda: generate.icosphere(radius_m=100.0, subdivisions=5),
    "gaussian 20k": lambda: generate.gaussian_random_sphere(radius_m=100.0, seed=11, subdivisions=5),
    "gaussian 82k": lambda: generate.gaussian_random_sphere(radius_m=100.0, sigma=0.25, correlation_deg=15.0, seed=12,
                                                            subdivisions=6),
    "binary 20k": lambda: generate.contact_binary(radius_m=100.0, seed=21, subdivisions=5),
    "binary 82k": lambda: generate.contact_binary(radius_m=100.0, seed=22, subdivisions=6),
    "binary 328k": lambda: generate.subdivide_with_relief(shape("binary 82k"), levels=1, seed=23),
    "three lobes 20k": lambda: generate.three_lobes(radius_m=100.0),
}


@dataclass(frozen=True, kw_only=True)
class Draw:
    """One scene and its random numbers."""

    scene: Scene
    state: State
    body: str
    law: str
    body_px: float
    phase_deg: float
    max_error: float


@cache
def shape(name: str) -> Shape:
    """A body of the list, of its file or generated."""
    if name in _MADE:
        return _MADE[name]()
    return Shape.from_file(data_file(_FILES[name]), length_unit="km")


def names() -> list[str]:
    """The bodies that are there."""
    return [name for name, path in _FILES.items() if data_file(path).is_file()] + list(_MADE)


def draw(seed: int, bodies: list[str] | None = None, frame_px: int = FRAME_PX,
         sizes_px: tuple[float, float] = (3.0, 2000.0), budgets: tuple[float, float] = (0.01, 0.1)) -> Draw:
    """A random body, law, size, phase (0 to 150 deg), attitude, range, place and budget."""
    rng = np.random.default_rng([20261121, seed])
    body_name = str(rng.choice(bodies or names()))
    phase_deg, body_px = (float(rng.uniform(0.0, 150.0)),
                          float(sizes_px[0] * (sizes_px[1] / sizes_px[0]) ** rng.random()))
    law = _law(rng, phase_deg)
    body = Body(name="body", shape=shape(body_name), brdf=law)
    radius = body.shape.radius_m
    range_m = radius * float(3.0 * 300.0 ** rng.random())
    camera = PinholeCamera(name="navcam", width_px=frame_px, height_px=frame_px,
                           focal_length_px=body_px * range_m / (2.0 * radius))
    direction = _direction(rng)
    r_camera = range_m * direction
    # The body's centre anywhere in the middle half of the frame, and at any place within a pixel.
    aside = rng.uniform(-0.25, 0.25, 2) * frame_px / camera.focal_length_px * range_m
    right, down = frames.dcm(frames.look_at(r_camera, np.zeros(3)))[:2]
    target = aside[0] * right + aside[1] * down if body_px < frame_px else 0.3 * radius * _direction(rng)
    turn, phase = rng.uniform(0.0, 2.0 * np.pi), np.radians(phase_deg)
    sideways = np.cos(turn) * right + np.sin(turn) * down
    state = State(
        r_sun_inertial_m=AU_M * float(rng.uniform(0.8, 3.0)) * (np.cos(phase) * direction + np.sin(phase) * sideways),
        spacecraft=Pose(r_inertial_m=r_camera, q_from_inertial=frames.look_at(r_camera, target, _direction(rng))),
        bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=random_quaternion(rng))})
    return Draw(scene=Scene(bodies=[body], cameras=[camera]), state=state, body=body_name, law=law.glsl,
                body_px=body_px, phase_deg=phase_deg,
                max_error=float(budgets[0] * (budgets[1] / budgets[0]) ** rng.random()))


def _law(rng: np.random.Generator, phase_deg: float):
    laws = [Lambert(normal_albedo=0.3), LommelSeeliger(single_scattering_albedo=0.3), HAPKE]
    if phase_deg < 100.0:
        laws.append(LunarLambert(normal_albedo=0.3, weight="mcewen"))
    return laws[rng.integers(len(laws))]


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    """A unit quaternion (4,), even over all rotations."""
    vector = rng.standard_normal(4)
    return vector / np.linalg.norm(vector)
