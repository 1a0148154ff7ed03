"""Comae for tests: a nucleus and its sources, and the columns that a frame draws of them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import OpenEXR
from glrender import Body, PinholeCamera, Pose, Scene, State
from glrender.brdf import Lambert
from glrender.emission import Coma, drawing
from glrender.emission.sources.jets import Jet, Jets
from glrender.emission.sources.volume import Volume
from glrender.scene.shape.generate import contact_binary, icosphere

SUN_M = 1.5e11 * np.array([0.8, 0.3, -0.52])
AU_M = 149_597_870_700.0


@cache
def sphere():
    return Body(name="nucleus", shape=icosphere(radius_m=1000.0), brdf=Lambert(normal_albedo=0.05))


@cache
def lobes():
    return Body(name="nucleus", shape=contact_binary(radius_m=1000.0, seed=3), brdf=Lambert(normal_albedo=0.05))


def camera(size=96, fov_rad=0.2):
    return PinholeCamera(name="camera", width_px=size, height_px=size, focal_length_px=size / fov_rad)


def state(r_spacecraft=(0.0, 0.0, -5e4), q=(1.0, 0.0, 0.0, 0.0), **others):
    still = Pose(r_inertial_m=[0.0, 0.0, 0.0], q_from_inertial=[1.0, 0.0, 0.0, 0.0])
    return State(t_s=0.0, r_sun_inertial_m=SUN_M, spacecraft=Pose(r_inertial_m=r_spacecraft, q_from_inertial=q),
                 bodies={"nucleus": still, **others})


def scene(*sources, body=None, pinhole=None, bodies=(), max_error=0.02, **coma):
    emission = [Coma(body="nucleus", sources=sources, **coma)] if sources else []
    return Scene(bodies=[body or sphere(), *bodies], cameras=[pinhole or camera()], emission=emission,
                 max_error=max_error)


def three_jets():
    made = []
    for x, y, z, width in ((1.0, 0.2, -0.3, 12.0), (-0.5, 1.0, 0.2, 20.0), (-0.2, -1.0, -0.8, 16.0)):
        axis = np.array([x, y, z]) / np.linalg.norm([x, y, z])
        made.append(Jet(vent_m=800.0 * axis, normal=axis, axis=axis, weight_m=3.0, half_width_deg=width,
                        vent_radius_m=150.0))
    return Jets(jets=made)


def grid():
    """Jets and an even outflow in cells."""
    n, half = 64, 6e3
    middle = (np.arange(n) + 0.5) / n * 2.0 * half - half
    r = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    total = three_jets().components(r).sum(axis=0) + 2.0
    return Volume(cross_section_per_m=(total / np.sum(r**2, axis=1)).reshape(n, n, n), low_m=[-half] * 3,
                  high_m=[half] * 3)


def drawn_columns(renderer, at, monkeypatch, **options):
    """Columns of a frame, the image, and the layers that were drawn."""
    taken, layers, add_light, told = [], [], drawing.add_light, drawing.told

    def keep(irradiance, column, hidden, *others):
        taken.append((column.copy(), hidden.copy()))
        add_light(irradiance, column, hidden, *others)

    def tell(coma, drawn, *others, **known):
        layers.extend(layer for layer, _ in drawn)
        return told(coma, drawn, *others, **known)

    with monkeypatch.context() as patch:
        patch.setattr(drawing, "add_light", keep)
        patch.setattr(drawing, "told", tell)
        image = renderer.render(at, **options)
    return (*taken[0], layers, image)


def pixel_rays(pinhole):
    y, x = np.mgrid[:pinhole.height_px, :pinhole.width_px]
    return pinhole.directions(np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64))


TABLE = {
    "bodies": [{"name": "nucleus", "generated": {"kind": "icosphere", "radius_m": 1000.0},
                "brdf": {"law": "lambert", "normal_albedo": 0.05}}],
    "cameras": [{"name": "camera", "width_px": 64, "height_px": 64, "focal_length_px": 320.0}],
}


def coma_table(**changes):
    return {**TABLE, "emission": [{"kind": "coma", "body": "nucleus",
                                   "sources": [{"model": "haser", "afrho_m": 1.0}], **changes}]}


def write_tile_sheet(path: Path, density: np.ndarray, sides_m: np.ndarray) -> None:
    """Write a cube (n, n, n) of dust as JSON and OpenEXR, as ComaCreator does: scaled to a largest value of 1."""
    n = len(density)
    across = int(np.ceil(np.sqrt(n)))
    cells = np.zeros((across * across, n, n), np.float32)
    cells[:n] = density / density.max()
    sheet = cells.reshape(across, across, n, n).transpose(0, 2, 1, 3).reshape(across * n, across * n)
    image = path.with_suffix(".exr")
    write_exr(image, {"R": np.zeros_like(sheet), "G": sheet, "B": np.zeros_like(sheet)})
    path.write_text(json.dumps({
        "dimensions": [float(side) / 1000.0 for side in sides_m], "resolution": n, "tiles_x": across,
        "tiles_y": across, "tiles_file": image.name}, indent=2), encoding="utf-8")


def write_exr(path: Path, channels: dict[str, np.ndarray]) -> None:
    """Write channels (height, width) float32 as an OpenEXR image."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {name: np.ascontiguousarray(pixels, np.float32)
                               for name, pixels in channels.items()}) as file:
        file.write(str(path))
