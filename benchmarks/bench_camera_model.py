"""Time of the camera model on one megapixel, by the content of the frame, beside a plain NumPy chain.

Prints one JSON line: p50, p95, p99 and max [ms] after warm-up, and the ratio of the medians. Both
chains run alternately in the same process, as these machines are noisy: read the ratios.

    python benchmarks/bench_camera_model.py [--frames 30] [--size 1024]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from glrender_camera import CameraModel, Detector, Optics

MODEL = CameraModel(
    optics=Optics(aperture_diameter_m=0.0151, transmission=0.8, psf_sigma_px=1.2),
    detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04,
                      bit_depth=12, offset_DN=50.0, read_noise_electrons=10.0,
                      dark_current_electrons_per_s=5.0, photo_response_nonuniformity=0.01),
    exposure_s=0.1)
# Medians of one megapixel on two cores that do nothing else.
LIMITS_MS = {"camera_model": 30.0, "optics": 10.0, "optics_diffraction_15_px": 10.0}
DIFFRACTION = Optics(aperture_diameter_m=0.0151, transmission=0.8, f_number=8.0, pixel_pitch_m=5e-6, psf_radius_px=7)


def images(size_px: int) -> dict[str, np.ndarray]:
    """Irradiance [W/m2]: a shaded disc half the frame wide, a gradient over all of it, darkness."""
    y, x = (np.indices((size_px, size_px)) - 0.5 * size_px) / (0.25 * size_px)
    electrons = {
        "disc": 5e4 * np.sqrt(np.clip(1.0 - x**2 - y**2, 0.0, None)),
        "full": 5e4 * (0.1 + 0.2 * (x + 2.0)),
        "dim": 20.0 * (0.1 + 0.2 * (x + 2.0)),
        "dark": np.zeros((size_px, size_px)),
    }
    per_electron = 1.0 / (MODEL.optics.aperture_area_m2 * MODEL.electrons_per_joule * MODEL.exposure_s)
    return {name: (value * per_electron).astype(np.float32) for name, value in electrons.items()}


def plain(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The chain of the camera model in a few lines of NumPy and OpenCV, one thread of random numbers."""
    detector = MODEL.detector
    scale = MODEL.optics.aperture_area_m2 * MODEL.electrons_per_joule * MODEL.exposure_s
    electrons = MODEL.optics.spread(image) * np.float32(scale)
    electrons = electrons * detector.fixed_pattern(image.shape).response + np.float32(0.5)
    electrons = np.minimum(rng.poisson(electrons), detector.full_well_electrons)
    electrons = electrons + rng.normal(0.0, detector.read_noise_electrons, image.shape)
    number = np.rint(electrons * detector.gain_DN_per_electron + detector.offset_DN)
    return np.clip(number, 0, detector.max_DN).astype(np.uint16)


def measure(size_px: int, n_frames: int) -> dict:
    rng = np.random.default_rng(1)
    result = {}
    for name, image in images(size_px).items():
        chains = {"camera_model": lambda i, image=image: MODEL.expose(image, i),
                  "optics": lambda i, image=image: MODEL.optics.spread(image),
                  "optics_diffraction_15_px": lambda i, image=image: DIFFRACTION.spread(image),
                  "plain_numpy": lambda i, image=image: plain(image, rng)}
        times = {chain: [] for chain in chains}
        processor = {chain: [] for chain in chains}
        for i in range(n_frames + 3):
            for chain, run in chains.items():
                begun, used = time.perf_counter(), time.process_time()
                run(i)
                times[chain].append(1e3 * (time.perf_counter() - begun))
                processor[chain].append(1e3 * (time.process_time() - used))
        result[name] = {chain: _percentiles(values[3:]) for chain, values in times.items()}
        result[name]["ratio_plain_numpy_over_camera_model"] = round(
            result[name]["plain_numpy"]["p50"] / result[name]["camera_model"]["p50"], 2)
        # The least: what other work on the machine leaves alone.
        result[name]["processor_ms"] = {chain: round(min(used[3:]), 1) for chain, used in processor.items()}
    return result


def _percentiles(values: list[float]) -> dict[str, float]:
    percentiles = {f"p{q}": round(float(np.percentile(values, q)), 2) for q in (50, 95, 99)}
    return percentiles | {"max": round(max(values), 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--check", action="store_true", help="fail where a median is above the limits")
    arguments = parser.parse_args()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True,
                            cwd=Path(__file__).parent, check=False).stdout.strip()
    line = {"benchmark": "camera_model", "size_px": arguments.size, "commit": commit,
            "processors": os.cpu_count(), "psf_kernel_px": MODEL.optics.psf_kernel.size,
            "ms": measure(arguments.size, arguments.frames)}
    sys.stdout.write(json.dumps(line) + "\n")
    if arguments.check:
        over = [f"{image}: {chain} {times[chain]['p50']} ms, above {limit}" for image, times in line["ms"].items()
                for chain, limit in LIMITS_MS.items() if times[chain]["p50"] > limit]
        sys.exit("\n".join(over) or 0)


if __name__ == "__main__":
    main()
