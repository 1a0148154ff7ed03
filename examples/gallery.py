"""The pictures of docs/img: what to look at when something in the renderer has changed.

    python examples/gallery.py [OUT_FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, State, frames, generate, take_frame
from glrender.base.constants import AU_M
from glrender.brdf import Hapke, Lambert
from glrender_camera import CameraModel
from glrender_camera.faults.frame_faults import KINDS
from PIL import Image, ImageDraw

# Itokawa's 1.57 um set of Kitazato et al. (2008), as photometric_sets.csv has it.
S_TYPE = Hapke(single_scattering_albedo=0.42, b=0.35, c=1.0, shoe_amplitude=0.87, shoe_width=0.01,
               roughness_deg=26.0)


def picture(body: Body, sun_in_image: tuple[float, float], phase_deg: float, size_px: int = 512,
            fill: float = 0.7, direction: tuple[float, float, float] = (0.2, -0.95, 0.25)) -> np.ndarray:
    """A display picture (uint8): the Sun stands at `phase_deg`, in the image's direction (x right, y down)."""
    direction = np.asarray(direction) / np.linalg.norm(direction)
    range_m = 10.0 * body.shape.radius_m
    camera = PinholeCamera(name="navcam", width_px=size_px, height_px=size_px,
                           focal_length_px=0.5 * fill * size_px * range_m / body.shape.radius_m)
    q = frames.look_at(range_m * direction, np.zeros(3))
    right, down, _ = frames.dcm(q)
    aside = sun_in_image[0] * right + sun_in_image[1] * down
    length = np.linalg.norm(aside)
    phase = np.radians(phase_deg)
    sun = np.cos(phase) * direction + np.sin(phase) * (aside / length if length else aside)
    state = State(r_sun_inertial_m=AU_M * sun, spacecraft=Pose(r_inertial_m=range_m * direction, q_from_inertial=q),
                  bodies={body.name: Pose(r_inertial_m=np.zeros(3))})
    with Renderer(Scene(bodies=[body], cameras=[camera])) as renderer:
        irradiance = renderer.render(state, samples=4).irradiance_W_m2
    white = np.quantile(irradiance[irradiance > 0.0], 0.999)
    return np.rint(255.0 * np.clip(irradiance / white, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)


def sheet(path: Path, pictures: list[tuple[str, np.ndarray]], n_columns: int = 4) -> None:
    """Pictures in rows, each with its caption."""
    height, width = pictures[0][1].shape
    canvas = Image.new("L", (width * n_columns, height * -(-len(pictures) // n_columns)))
    for index, (caption, pixels) in enumerate(pictures):
        left, top = index % n_columns * width, index // n_columns * height
        canvas.paste(Image.fromarray(pixels), (left, top))
        ImageDraw.Draw(canvas).text((left + 6, top + 4), caption, fill=255)
    canvas.save(path, optimize=True)


def faults(path: Path) -> None:
    """One body in a camera with each fault, on its limb where it can be: docs/camera_model.md."""
    body = Body(name="body", shape=generate.three_lobes(radius_m=100.0, subdivisions=6), brdf=S_TYPE)
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": "auto",
                                   "optics": {"aperture_diameter_m": 0.002}})
    camera = PinholeCamera(name="navcam", width_px=230, height_px=230, focal_length_px=1150.0, model=model)
    place = np.array([0.0, -1200.0, 0.0])
    state = State(r_sun_inertial_m=AU_M * np.array([-0.8, -0.6, 0.1]), bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, np.zeros(3))))
    own = {"sun_blinding": {"radius_px": 25.0, "bloom_px": 60.0, "seed": 2}, "stuck_exposure": {"exposure_s": 0.01},
           "garbled_bytes": {"n_runs": 12}, "dust": {"n_spots": 20}}
    pictures = []
    with Renderer(Scene(bodies=[body], cameras=[camera])) as renderer:
        for kind, fixed in ((kind, of.is_fixed) for kind, of in KINDS.items()):
            fault = {"kind": kind, "place": "random" if fixed else "limb", **own.get(kind, {})}
            frame = take_frame(renderer, state, seed=4, faults=[fault]).frame
            share = np.clip((frame.dn / 4095.0 - 0.03) / 0.8, 0.0, 1.0)
            # Few grey levels: noise is dear in a PNG.
            pictures.append((kind, np.rint(31.0 * share ** (1.0 / 2.2)).astype(np.uint8) * np.uint8(8)))
    sheet(path, pictures, 5)


def main(out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    sphere = Body(name="sphere", shape=generate.icosphere(radius_m=100.0, subdivisions=6),
                  brdf=Lambert(normal_albedo=0.5))
    lobes = Body(name="lobes", shape=generate.three_lobes(radius_m=100.0), brdf=S_TYPE)
    binary = Body(name="binary", shape=generate.contact_binary(radius_m=100.0, seed=1), brdf=S_TYPE)
    suns = [("Sun +x (right)", (1, 0), 70), ("Sun +y (down)", (0, 1), 70), ("Sun -x (left)", (-1, 0), 70),
            ("Sun behind the camera", (0, 0), 0)]
    for name, body in (("sphere", sphere), ("three_lobes", lobes), ("contact_binary", binary)):
        sheet(out / f"{name}.png", [(caption, picture(body, sun, phase, 320)) for caption, sun, phase in suns])
    faults(out / "faults.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs/img"))
