"""A real image of Bennu and its twin of a SUM file: bennu_twin.py SUM SHAPE [--map MAP] [--real IMAGE] [--out PNG]"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from glrender import Body, Renderer, Scene
from glrender.brdf import LunarLambert
from glrender.scenario import image_of_sum
from PIL import Image
from scipy.ndimage import gaussian_filter, shift
from scipy.optimize import minimize

# SPC's own law; NCC does not depend on the albedo.
LAW = LunarLambert(normal_albedo=0.045, weight="gaskell")
SMOOTHED_PX, MARGIN_PX = 2.0, 20


def twin(sum_file: Path, shape: Path, length_unit: str = "km", albedo_map: Path | None = None) -> np.ndarray:
    """Irradiance [W/m2] of the image of a SUM file, the Sun at 1 au; with a map of longitudes from -180 degrees."""
    image = image_of_sum(sum_file, body="bennu")
    has_map = {} if albedo_map is None else {
        "albedo_texture": albedo_map, "albedo_projection": {"kind": "equirectangular", "left_edge_deg": -180.0}}
    body = Body.from_file(shape, name="bennu", length_unit=length_unit, brdf=LAW, **has_map)
    with Renderer(Scene(bodies=[body], cameras=[image.camera])) as renderer:
        return renderer.render(image.state).irradiance_W_m2.astype(float)


def ncc(a: np.ndarray, b: np.ndarray) -> float:
    """Normalised cross-correlation."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def remaining_offset_px(ours: np.ndarray, real: np.ndarray) -> tuple[np.ndarray, float]:
    """By how much ours is to move (x, y) for the greatest NCC, and that NCC; both images smoothed by 2 px."""
    ours, real = gaussian_filter(ours, SMOOTHED_PX), gaussian_filter(real, SMOOTHED_PX)
    inner = (slice(MARGIN_PX, -MARGIN_PX),) * 2
    loss = lambda x: -ncc(shift(ours, x[::-1], order=1, mode="nearest")[inner], real[inner])  # noqa: E731
    found = minimize(loss, [0.5, 0.5], method="Nelder-Mead", options={"xatol": 0.05, "fatol": 1e-6, "maxfev": 80})
    return found.x, -float(found.fun)


def main(arguments: argparse.Namespace) -> None:
    ours = twin(arguments.sum, arguments.shape, arguments.length_unit, arguments.map)
    grey = [ours / np.quantile(ours, 0.999)]
    if arguments.real is not None:
        real = np.asarray(Image.open(arguments.real), float)
        if real.shape != ours.shape:
            sys.exit(f"bennu_twin.py: {arguments.real} has {real.shape} pixels, and the SUM file {ours.shape}")
        offset, best = remaining_offset_px(ours, real)
        sys.stdout.write(f"NCC {ncc(ours, real):.4f}; moved by ({offset[0]:+.1f}, {offset[1]:+.1f}) px and smoothed by "
                         f"{SMOOTHED_PX:g} px {best:.4f}\n")
        grey.insert(0, real / np.quantile(real, 0.999))
    Image.fromarray(np.hstack([(255.0 * half.clip(0.0, 1.0)).astype(np.uint8) for half in grey])).save(arguments.out)
    sys.stdout.write(f"{arguments.out}\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sum", type=Path)
    parser.add_argument("shape", type=Path)
    parser.add_argument("--length-unit", default="km")
    parser.add_argument("--map", type=Path)
    parser.add_argument("--real", type=Path)
    parser.add_argument("--out", type=Path, default=Path("twin.png"))
    main(parser.parse_args())
