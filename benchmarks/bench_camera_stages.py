"""Cost of each stage of the camera model, and its effect on the frame: one JSON line and a chart.

A bare camera (aperture, quantum efficiency, shot noise, full well, converter) looks at a shaded disc
half the frame wide; one stage at a time is added. Cost: least processor time over that of the
bare frame. Effect: RMS change of the frame in the disc's box, bias and noise, over the disc's mean
signal: sqrt(bias^2 + |variance - bare variance|), where pairs of frames tell bias from noise.

    python benchmarks/bench_camera_stages.py [--frames 15] [--size 1024] [--chart docs/img/camera_stages.png]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from glrender_camera import (
    Aberrations,
    BrownConrady,
    CameraModel,
    Detector,
    DistortingLens,
    Optics,
    PinholeCamera,
    PointSources,
    StrayLight,
)

BARE = CameraModel(
    optics=Optics(aperture_diameter_m=0.0151, transmission=0.8),
    detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12,
                      offset_DN=50.0),
    exposure_s=0.1)
PUPIL = {"f_number": 8.0, "pixel_pitch_m": 5e-6}


def stages(size_px: int) -> dict[str, tuple[CameraModel, dict]]:
    """Name -> model with that stage alone, and further arguments of `expose`."""
    def optics(**fields):
        return replace(BARE, optics=replace(BARE.optics, **fields)), {}

    def detector(**fields):
        return replace(BARE, detector=replace(BARE.detector, **fields)), {}

    rng = np.random.default_rng(2)
    per_electron = 1.0 / (BARE.optics.aperture_area_m2 * BARE.electrons_per_joule * BARE.exposure_s)
    stars = PointSources(rng.uniform(0, size_px, (200, 2)), 1e4 * rng.random(200) ** 3 * per_electron)
    cosine = PinholeCamera(name="c", width_px=size_px, height_px=size_px, focal_length_px=2.0 * size_px).cos_field_angle
    corner = 0.4
    return {
        "Gaussian, 0.7 px": optics(psf_sigma_px=0.7),
        "Gaussian, 1.2 px": optics(psf_sigma_px=1.2),
        "diffraction, 15 px": optics(**PUPIL, psf_radius_px=7),
        "diffraction, 31 px": optics(**PUPIL),
        "aberrations, 5 x 5 of 15 px": optics(**PUPIL, psf_radius_px=7, aberrations=Aberrations(
            coma_nm=60.0, tangential_nm=120.0, sagittal_nm=-40.0)),
        "stray light": optics(stray_light=StrayLight(wing_fraction=0.01, veiling_glare=0.002)),
        "200 stars": (optics(psf_sigma_px=0.7)[0], {"points": stars}),
        "foreshortened aperture": (BARE, {"relative_illumination": cosine}),
        "distortion": (BARE, {"lens": DistortingLens(PinholeCamera(
            name="c", width_px=size_px, height_px=size_px, focal_length_px=0.7071 * size_px / corner),
            BrownConrady(k1=-0.05), 2)}),
        "PRNU 1 %": detector(photo_response_nonuniformity=0.01),
        "frame transfer, 1 us": detector(frame_transfer_row_s=1e-6),
        "dark current, 50 e-/s": detector(dark_current_electrons_per_s=50.0),
        "hot pixels, 1e-3": detector(hot_pixel_fraction=1e-3, hot_pixel_electrons_per_s=1e3),
        "DSNU 3 e-": detector(dark_signal_nonuniformity_electrons=3.0),
        "read noise 10 e-": detector(read_noise_electrons=10.0),
        "nonlinearity 1 %": detector(nonlinearity_DN=((0.0, 0.0), (2048.0, 2068.0), (4095.0, 4095.0))),
        "cosmic rays, 1e-4 /(px s)": detector(cosmic_ray_hits_per_px_s=1e-4),
    }


def disc(size_px: int) -> np.ndarray:
    y, x = (np.indices((size_px, size_px)) - 0.5 * size_px) / (0.25 * size_px)
    charge = 5e4 * np.sqrt(np.clip(1.0 - x**2 - y**2, 0.0, None))
    return (charge / (BARE.optics.aperture_area_m2 * BARE.electrons_per_joule * BARE.exposure_s)).astype(np.float32)


def expose(model: CameraModel, image: np.ndarray, seed: int, *, lens: DistortingLens | None = None, **more):
    return model.expose(image if lens is None else lens.apply(image), seed, **more)


def electrons(frame) -> np.ndarray:
    """Electrons that the frame's numbers stand for."""
    return (frame.dn - BARE.detector.offset_DN) / BARE.detector.gain_DN_per_electron


def effect(bare: list[np.ndarray], other: list[np.ndarray]) -> float:
    """sqrt(bias^2 + |change of variance|) from two frames of each [electrons]."""
    spread = [0.5 * np.mean((pair[0] - pair[1]) ** 2) for pair in (bare, other)]
    bias = np.mean((bare[0] - other[0]) ** 2) - sum(spread)
    return float(np.sqrt(max(bias, 0.0) + abs(spread[1] - spread[0])))


def measure(size_px: int, n_frames: int) -> tuple[float, dict[str, dict[str, float]]]:
    """Processor time of the bare frame [ms]; for each stage the time that it adds [ms], and its effect [1]."""
    image = disc(size_px)
    box = np.s_[size_px // 5:size_px - size_px // 5, size_px // 5:size_px - size_px // 5]
    bare = [electrons(BARE.expose(image, seed))[box] for seed in (1, 2)]
    mean = float(bare[0][image[box] > 0.0].mean())
    result = {}
    for name, (model, more) in stages(size_px).items():
        # A distorting lens is shown the larger image that it asks for, the disc alike in both.
        shown, reference = image, bare
        if "lens" in more:
            source = more["lens"].source
            shown = np.zeros((source.height_px, source.width_px), np.float32)
            y, x = ((np.indices(shown.shape) - np.array(source.principal_point_px)[::-1, None, None])
                    / (source.focal_length_px * 0.25 * size_px / more["lens"].camera.focal_length_px))
            shown += image.max() / 4.0 * np.sqrt(np.clip(1.0 - x**2 - y**2, 0.0, None))
            shown = shown.astype(np.float32)
        times = {True: [], False: []}
        for i in range(n_frames + 2):
            for is_bare in (True, False):
                begun = time.process_time()
                if is_bare:
                    BARE.expose(image, i)
                else:
                    expose(model, shown, i, **more)
                times[is_bare].append(1e3 * (time.process_time() - begun))
        frames = [electrons(expose(model, shown, seed, **more))[box] for seed in (3, 4)]
        cost = min(times[False][2:]) - min(times[True][2:])
        result[name] = {"cost_ms": round(max(cost, 0.0), 2), "effect": round(effect(reference, frames) / mean, 6)}
    return round(min(times[True][2:]), 2), result


def chart(bare_ms: float, result: dict[str, dict[str, float]], path: Path, title: str) -> None:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    figure, axes = plt.subplots(figsize=(9.5, 6.0))
    ranked = sorted(result.items(), key=lambda item: item[1]["effect"])
    for i, (name, point) in enumerate(ranked):
        x, y = max(point["cost_ms"], 0.1), max(100.0 * point["effect"], 1e-3)
        axes.loglog(x, y, "o", color="tab:blue")
        axes.annotate(name, (x, y), xytext=(5, 4 if i % 2 else -10), textcoords="offset points", fontsize=8)
    axes.axvline(bare_ms, color="0.6", linestyle="--", linewidth=1)
    axes.set(xlabel=f"added processor time [ms]; dashed: the bare frame, {bare_ms:.0f} ms",
             ylabel="RMS change of the frame over the mean signal [%]", title=title, xlim=(0.08, 300.0))
    axes.grid(True, which="both", alpha=0.25)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=15)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--chart", type=Path)
    arguments = parser.parse_args()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True,
                            cwd=Path(__file__).parent, check=False).stdout.strip()
    bare_ms, result = measure(arguments.size, arguments.frames)
    if arguments.chart:
        chart(bare_ms, result, arguments.chart, f"Camera model, {arguments.size} px, a disc half the frame wide")
    sys.stdout.write(json.dumps({"benchmark": "camera_stages", "size_px": arguments.size, "commit": commit,
                                 "processors": os.cpu_count(), "bare_ms": bare_ms, "stages": result}) + "\n")


if __name__ == "__main__":
    main()
