"""A body of 20,000 facets of 10 m with a landing site of 0.3 m, as one body: pictures from 1.5 km, 150 m and 25 m.

    python examples/terrain/regions.py [FOLDER]

The site is made up: facets of the body itself, cut finer with relief. One of a stereo map or of maplets is a file.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from glrender import Body, PinholeCamera, Pose, Region, Renderer, Scene, Shape, State, frames, generate
from glrender.brdf import Lambert
from PIL import Image

UP = np.array([0.36, -0.48, 0.8])
DISTANCES_M = (1500.0, 150.0, 25.0)


def lander(site_radius_m: float = 25.0, levels: int = 5) -> tuple[Body, np.ndarray]:
    """The body with its site, and the site's middle (3,) [m]."""
    shape = generate.gaussian_random_sphere(radius_m=250.0, sigma=0.12, seed=3, subdivisions=5)
    middles_m = shape.vertices_m[shape.facets].mean(axis=1)
    target_m = middles_m[np.argmax(middles_m @ UP / np.linalg.norm(middles_m, axis=1))]
    near = np.linalg.norm(middles_m - target_m, axis=1) < site_radius_m
    site = generate.subdivide_with_relief(Shape.from_arrays(shape.vertices_m, shape.facets[near]), levels=levels,
                                          relief=0.05, seed=8)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.12), regions=[Region(shape=site)])
    return body, target_m


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    body, target_m = lander()
    for seam in body.shape.report.seams:
        print(f"{seam.n_facets} facets in place of {seam.n_left_out}; the rim is {seam.gap_rms_m:.2f} m RMS and at "
              f"most {seam.gap_max_m:.2f} m off the shape; the strip is {seam.width_m:.2f} m wide")
    camera = PinholeCamera(name="camera", width_px=320, height_px=320, focal_length_px=700.0)
    aside = np.cross(UP, [0.0, 0.0, 1.0])
    pictures = []
    with Renderer(Scene(bodies=[body], cameras=[camera])) as renderer:
        for distance_m in DISTANCES_M:
            place_m = target_m + distance_m * (UP + 0.4 * aside) / np.linalg.norm(UP + 0.4 * aside)
            image = renderer.render(State(
                t_s=0.0, r_sun_inertial_m=1.5e11 * (UP - 1.5 * aside) / np.linalg.norm(UP - 1.5 * aside),
                spacecraft=Pose(r_inertial_m=place_m, q_from_inertial=frames.look_at(place_m, target_m)),
                bodies={"body": Pose(r_inertial_m=[0.0, 0.0, 0.0], q_from_inertial=[1.0, 0.0, 0.0, 0.0])}))
            light = image.irradiance_W_m2
            pictures.append(255.0 * np.clip(light / np.percentile(light[light > 0.0], 99.5), 0.0, 1.0) ** 0.5)
            print(f"{distance_m:g} m: predicted error {image.plan.predicted_error:.3f}")
    Image.fromarray(np.concatenate(pictures, axis=1).astype(np.uint8)).save(folder / "regions.png")


if __name__ == "__main__":
    main()
