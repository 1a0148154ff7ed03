"""Frames that flew beside ours, at the pose of each image: real_frames.py [--out FOLDER] [--only NAME ...]

Of images in ../shared/data (or $GLRENDER_SHARED/data). Nothing is shifted, turned or scaled to fit: the residual map
has a gain and an offset fitted, as the images are display values.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from compare import ncc
from figures import beside, body_figure, pair_figure
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, State, frames
from glrender.brdf import Hapke, Lambert, LommelSeeliger, LunarLambert
from glrender.scenario import image_of_sum
from PIL import Image

SHARED = Path(os.environ.get("GLRENDER_SHARED") or Path(__file__).parents[3] / "shared")
SUN_67P_M = 5.3e11  # 3.6 au, August 2014; NCC does not depend on it.
LAWS = {
    "67p": {
        "Lambert": Lambert(normal_albedo=0.065),
        "Lommel-Seeliger": LommelSeeliger(single_scattering_albedo=0.042),
        # oknuutti/visnav-py, missions/rosetta.py: powers of the phase angle in degrees, fitted to NavCam images.
        "Lunar-Lambert": LunarLambert(normal_albedo=0.065, weight=(1.0, -7.4364e-3, 4.0259e-5, -2.2650e-6, 2.1524e-8,
                                                                   -5.7964e-11)),
        # Fornasier et al. (2015), table 4, Hapke (2002) at 649 nm.
        "Hapke": Hapke.one_term(asymmetry=-0.37, single_scattering_albedo=0.042, shoe_amplitude=1.95, shoe_width=0.023,
                                roughness_deg=15.0)},
    "bennu": {
        "Lambert": Lambert(normal_albedo=0.045),
        # OREX1 of Terrasaur, after Takir et al. (2015): f(g) in degrees.
        "Lommel-Seeliger": LommelSeeliger(single_scattering_albedo=0.377,
                                          phase_function=(-4.36e-2, 2.69e-4, -9.90e-7)),
        "Lunar-Lambert": LunarLambert(normal_albedo=0.045, weight="gaskell"),
        # Takir et al. (2015), at 550 nm.
        "Hapke": Hapke.one_term(asymmetry=-0.32, single_scattering_albedo=0.031, shoe_amplitude=3.9, shoe_width=0.11,
                                roughness_deg=20.0)}}
SHOWN_LAW = "Hapke"


@dataclass(frozen=True)
class Frame:
    """An image that flew, and where it was taken from by each of its poses."""

    body: str
    name: str
    pixels: np.ndarray
    is_root: bool  # Display values go as the square root of the light.
    shape: Path
    views: dict[str, tuple[PinholeCamera, State]]


def navcam_frames(data: Path) -> list[Frame]:
    """Rosetta's, by the pose of the label and by one that others refined on the image."""
    found = []
    for name, image in sorted(json.loads((data / "67p" / "poses.json").read_text())["images"].items()):
        pixels = np.asarray(Image.open(data / "67p" / "navcam" / f"{name}.png").convert("L"), float)
        views = {kind: _view(image, image[kind]) for kind in ("label", "refined")}
        found.append(Frame("67p", name, pixels, True, data / "67p" / "67p-16k.obj", views))
    return found


def bennu_frames(data: Path) -> list[Frame]:
    """OSIRIS-REx's, by its SUM file."""
    folder = data / "bennu"
    image = image_of_sum(folder / "M605862153F5.SUM", body="bennu")
    pixels = np.asarray(Image.open(folder / "ocams20190314t190123s972_map_iofl2pan.png"), float)
    return [Frame("bennu", image.name, pixels, False, folder / "bennu_49k.ply", {"SUM": (image.camera, image.state)})]


def _view(image: dict, pose: dict) -> tuple[PinholeCamera, State]:
    camera = PinholeCamera(name="navcam", width_px=image["width"], height_px=image["height"],
                           focal_length_px=image["fx"], principal_point_px=(pose["cx"], pose["cy"]))
    craft = Pose(r_inertial_m=1e3 * np.array(pose["pos_body_km"]),
                 q_from_inertial=frames.quaternion(np.array(pose["R_body_to_cam"])))
    return camera, State(r_sun_inertial_m=SUN_67P_M * np.array(pose["sun_body"]), spacecraft=craft,
                         bodies={"67p": Pose(r_inertial_m=np.zeros(3))})


def drawn(frame: Frame, view: str, law: str) -> np.ndarray:
    """Our frame, float64 irradiance [W/m2]; of display values their root."""
    camera, state = frame.views[view]
    body = Body.from_file(frame.shape, name=frame.body, length_unit="km", brdf=LAWS[frame.body][law])
    with Renderer(Scene(bodies=[body], cameras=[camera])) as renderer:
        light = renderer.render(state).irradiance_W_m2.astype(float)
    return np.sqrt(light) if frame.is_root else light


def main(out: Path, only: list[str]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    data = SHARED / "data"
    if not data.is_dir():
        sys.exit(f"real_frames.py: {data} is not there; set GLRENDER_SHARED to the folder that holds data/67p")
    chosen = [frame for frame in navcam_frames(data) + bennu_frames(data) if not only or frame.name in only]
    if not chosen:
        sys.exit(f"real_frames.py: there is no image {', '.join(only)} in {data}")
    shown: dict[str, list] = {}
    with open(out / "ncc.csv", "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["body", "image", "pose", "law", "ncc"])
        for frame in chosen:
            for view in frame.views:
                for law in LAWS[frame.body]:
                    ours = drawn(frame, view, law)
                    score = ncc(ours, frame.pixels)
                    table.writerow([frame.body, frame.name, view, law, f"{score:.4f}"])
                    if law == SHOWN_LAW:
                        shown.setdefault(frame.body, []).append((frame, view, ours, score))
            sys.stdout.write(f"{frame.name}\n")
    for body, rows in shown.items():
        for frame, view, ours, score in rows:
            pair_figure(out / f"{frame.name}_{view}.png", frame, view, ours, score)
        body_figure(out / f"real_{body}.jpg", rows)
    if rows := shown.get("67p"):
        best = max(rows, key=lambda row: row[3])
        beside(out / "real_beside_rendered.jpg", best[0], best[2])
    for body in shown:
        for view in dict.fromkeys(row[1] for row in shown[body]):
            scores = [row[3] for row in shown[body] if row[1] == view]
            sys.stdout.write(f"{body}, {view}: {len(scores)} images, NCC {min(scores):.3f} to {max(scores):.3f}, "
                             f"median {np.median(scores):.3f}\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/real_frames"))
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="of images; all by default")
    arguments = parser.parse_args()
    main(arguments.out, arguments.only)
