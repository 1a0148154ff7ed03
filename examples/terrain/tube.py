"""A lava tube by a headlight: rays, and Cycles with and without light between the walls.

    python examples/terrain/tube.py [FOLDER]

Needs Blender (`make blender`) and `pip install 'glrender[demo]'`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from glrender import Body, Lamp, PinholeCamera, Pose, Scene, Shape, State, frames, open_renderer
from glrender.brdf import Lambert
from PIL import Image

ALBEDO, LENGTH_M, RADIUS_M = 0.15, 80.0, 6.0


def tube(n_along: int = 240, n_around: int = 96, seed: int = 3) -> Shape:
    """A closed tube along +x that faces inward: rough walls, a flat floor, two ends."""
    rng = np.random.default_rng(seed)
    along, around = np.linspace(0.0, LENGTH_M, n_along), 2.0 * np.pi * np.arange(n_around) / n_around
    x, turn = np.meshgrid(along, around, indexing="ij")
    radius = np.full_like(x, RADIUS_M)
    for _ in range(60):
        k, m = rng.uniform(0.1, 2.5), rng.integers(0, 12)
        radius += 0.18 / (1.0 + k + 0.3 * m) * np.sin(k * x + m * turn + rng.uniform(0.0, 2.0 * np.pi))
    bend = 3.0 * np.sin(x / 17.0)
    y, floor = radius * np.cos(turn) + bend, -0.55 * RADIUS_M + 0.15 * (radius - RADIUS_M)
    z = np.maximum(radius * np.sin(turn), floor)
    ends = [[x[i, 0], bend[i, 0], 0.0] for i in (0, -1)]
    vertices = np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3), ends])
    here = np.arange(n_along * n_around).reshape(n_along, n_around)
    there = np.roll(here, -1, axis=1)
    a, b, c, d = (each.ravel() for each in (here[:-1], here[1:], there[1:], there[:-1]))
    first, last = here.size, here.size + 1
    facets = np.concatenate([
        np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1),
        np.stack([here[0], there[0], np.full(n_around, first)], axis=1),
        np.stack([there[-1], here[-1], np.full(n_around, last)], axis=1)])
    return Shape.from_arrays(vertices, facets, inside=True)


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    body = Body(name="tube", shape=tube(), brdf=Lambert(normal_albedo=ALBEDO))
    camera = PinholeCamera(name="camera", width_px=384, height_px=256, focal_length_px=260.0)
    lamp = Lamp(name="headlight", intensity_W_sr=20.0, r_spacecraft_m=[0.6, 0.3, 0.0], half_angle_deg=28.0)
    scene = Scene(bodies=[body], cameras=[camera], lamps=[lamp], max_error=0.02)
    place, aim = np.array([8.0, 1.0, -0.5]), np.array([24.0, 3.0, -1.5])
    state = State(r_sun_inertial_m=[0.0, 0.0, 1.5e11], bodies={"tube": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, aim)))
    with open_renderer(scene) as renderer:
        image = renderer.render(state)
        sys.stdout.write(f"{image.plan}\n")
    made = [image.irradiance_W_m2.astype(float)]
    with open_renderer(scene, "cycles") as cycles:
        made += [cycles.render(state, bounces=bounces).irradiance_W_m2.astype(float) for bounces in (0, 8)]
    rays, direct, between = made
    lit = direct > 0.0
    rms = np.sqrt(np.mean((rays - direct)[lit] ** 2)) / direct[lit].mean()
    flux, more = rays.sum() / direct.sum() - 1.0, between.sum() / direct.sum() - 1.0
    sys.stdout.write(f"rays and Cycles without light between walls: RMS {rms:.4f}, flux {flux:+.5f}\n"
                     f"light between walls: {more:+.4f}\n")
    white = np.percentile(between, 99.5)
    grey = [np.rint(255.0 * np.clip(each / white, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8) for each in made]
    Image.fromarray(np.concatenate(grey, axis=1)).save(folder / "terrain_tube.png")


if __name__ == "__main__":
    main()
