"""67P with coma and jets, log stretch: comet.py FOLDER_OF_67P_SHAPES OUT.png"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
from glrender import Pose, Renderer, Scene, State, frames
from PIL import Image


def main(shapes: Path, out: Path) -> None:
    table = tomllib.loads((Path(__file__).parent / "comet_67p.toml").read_text(encoding="utf-8"))
    scene = Scene.from_dict(table, shape_dir=shapes)
    r_spacecraft = np.array([0.0, -155e3, 15e3])
    attitude = frames.look_at(r_spacecraft, np.zeros(3))
    # The Sun stands high in the image, 89 deg from the camera, 1.3 au away.
    sun = np.array([0.25, -0.02, 0.97])
    state = State(t_s=0.0, r_sun_inertial_m=1.95e11 * sun / np.linalg.norm(sun),
                  spacecraft=Pose(r_inertial_m=r_spacecraft, q_from_inertial=attitude),
                  bodies={"67p": Pose(r_inertial_m=np.zeros(3), q_from_inertial=[1.0, 0.0, 0.0, 0.0])})
    with Renderer(scene) as renderer:
        image = renderer.render(state)
    light = image.irradiance_W_m2
    low, high = np.percentile(light, 1.0), light.max()
    stretched = np.clip(np.log(np.maximum(light, 0.5 * low) / low) / np.log(high / low), 0.0, 1.0)
    Image.fromarray((255.0 * stretched).astype(np.uint8)).save(out)
    sys.stdout.write(f"{out}: {image.plan.emission[0]}\n{image.timings_ms}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
