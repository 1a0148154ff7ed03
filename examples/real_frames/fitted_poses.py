"""Poses of 67P's frames by all their pixels, from the labels' poses: fitted_poses.py [--out FILE.csv] [--only NAME ...]

Steps of Gauss and Newton of place and attitude, by the normal equations of `glrender.compare_frame`, of frames that are
blurred less and less. The display values are squared. Prints the NCC of whole frames by label, fitted and refined pose.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from compare import ncc
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, State, compare_frame, draw_still, frames
from glrender_camera import CameraModel, Detector, Optics
from real_frames import LAWS, SHARED, SHOWN_LAW, Frame, navcam_frames
from scipy.spatial.transform import Rotation

# The blurs [px] of the steps, and how far the labels may be off: share of the range, and angle.
BLURS_PX = np.geomspace(8.0, 1.2, 8)
RANGE_SIGMA, ATTITUDE_SIGMA_RAD = 0.02, np.radians(0.6)
# Digital number of a squared display value, within 16 bits: the gain is unknown.
DN_PER_SQUARE = 0.1
MODEL = CameraModel(optics=Optics(aperture_diameter_m=0.07, psf_sigma_px=1.0), exposure_s=1.0, detector=Detector(
    quantum_efficiency=1.0, full_well_electrons=1e9, gain_DN_per_electron=1.0, bit_depth=16, read_noise_electrons=10.0))
QUIET = replace(MODEL, detector=replace(MODEL.detector, read_noise_electrons=0.0))


def fitted(frame: Frame) -> State:
    """The state by all pixels, from the label's."""
    camera, state = frame.views["label"]
    light_DN, known = DN_PER_SQUARE * frame.pixels**2, np.zeros(6)
    sigma = np.repeat([RANGE_SIGMA * np.linalg.norm(state.spacecraft.r_inertial_m), ATTITUDE_SIGMA_RAD], 3)
    with _renderer(frame, camera) as renderer:
        for blur_px in BLURS_PX:
            fit = compare_frame(renderer, state, frame_DN=light_DN, blur_px=float(blur_px), max_error=0.02)
            # All that differs counts as noise, and the label as a measurement.
            noise = fit.chi2 / fit.n_pixels
            prior = np.append(sigma**-2, [0.0, 0.0])
            matrix = fit.matrix / noise + np.diag(prior)
            step = np.linalg.solve(matrix, fit.vector / noise - prior * np.append(known, [0.0, 0.0]))[:6]
            known, state = known + step, _moved(state, step)
    return state


def _moved(state: State, step: np.ndarray) -> State:
    """The state with the spacecraft shifted [m] and turned [rad] along and about the camera's axes."""
    craft = state.spacecraft
    camera_from_body = frames.dcm(craft.q_from_inertial)
    turned = Rotation.from_rotvec(-step[3:]).as_matrix() @ camera_from_body
    return replace(state, spacecraft=Pose(r_inertial_m=craft.r_inertial_m + camera_from_body.T @ step[:3],
                                          q_from_inertial=frames.quaternion(turned)))


def _renderer(frame: Frame, camera: PinholeCamera) -> Renderer:
    body = Body.from_file(frame.shape, name=frame.body, length_unit="km", brdf=LAWS[frame.body][SHOWN_LAW])
    return Renderer(Scene(bodies=[body], cameras=[replace(camera, model=MODEL)], sun_disc=False))


def score(frame: Frame, camera: PinholeCamera, state: State) -> float:
    """NCC of the frame and the root of the light through the camera's optics."""
    with _renderer(frame, camera) as renderer:
        light_W_m2 = draw_still(renderer, state, max_error=0.02).irradiance_W_m2
    electrons = replace(camera, model=QUIET).expose(light_W_m2, 0).electrons
    return ncc(np.sqrt(electrons), frame.pixels)


def main(out: Path, only: list[str]) -> None:
    rows, data = [], SHARED / "data"
    if not data.is_dir():
        sys.exit(f"fitted_poses.py: {data} is not there; set GLRENDER_SHARED to the folder that holds data/67p")
    for frame in navcam_frames(data):
        if only and frame.name not in only:
            continue
        began = time.process_time()
        state = fitted(frame)
        processor_s, camera = time.process_time() - began, frame.views["label"][0]
        scores = {"label": score(frame, *frame.views["label"]), "fitted": score(frame, camera, state),
                  "refined": score(frame, *frame.views["refined"])}
        rows.append({"image": frame.name, **scores, "processor_s": processor_s})
        sys.stdout.write(f"{frame.name}: " + ", ".join(f"{name} {value:.4f}" for name, value in scores.items())
                         + f"; {processor_s:.1f} s\n")
        sys.stdout.flush()
    if not rows:
        sys.exit(f"fitted_poses.py: there is no image {', '.join(only)}")
    out.parent.mkdir(parents=True, exist_ok=True)
    with open(out, "w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, rows[0])
        table.writeheader()
        table.writerows(rows)
    best = sum(row["fitted"] > row["refined"] for row in rows)
    medians = {name: np.median([row[name] for row in rows]) for name in rows[0] if name != "image"}
    sys.stdout.write(", ".join(f"{name} {value:.3f}" for name, value in medians.items())
                     + f"; medians of {len(rows)} images, of which {best} fit better than refined\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/fitted_poses.csv"))
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="of images; all by default")
    arguments = parser.parse_args()
    main(arguments.out, arguments.only)
