"""Errors of an estimator, or of the filter, against truth: navigate.py NAME OUT.png [--frames N] [--size-px N]

The camera's frames are drawn to 1 % and have noise; the believed scene is drawn to 10 %, once with the true shape and
once with one of a sixteenth of its facets. NAME is an estimator of `glrender_navigation.ESTIMATORS`, or `filter`.
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path

import numpy as np
import world
from glrender import frames
from glrender_navigation import ESTIMATORS, Measurement, Navigator, sight
from matplotlib.figure import Figure
from PIL import Image

BELIEFS = {"the true shape": 6, "a sixteenth of its facets": 4}
_COLOURS = ("tab:blue", "tab:orange")
# Gravity of the body at 2 g/cm3, and the steps of the filter's flight past it.
_GM_M3_S2 = 2.9
_STEP_S = 600.0
_RANGE_SIGMA_M = 1.0
_SIZE_SIGMA = 0.005


def measured(name: str, n_frames: int, size_px: int, subdivisions: int) -> tuple[dict[str, np.ndarray], list]:
    """Errors of each frame that was measured, of the centre [px], the range [%] and the place in sigmas of an axis,
    and the sigmas of the first two; and (frame, true centre, found centre).
    """
    true_shape, believed_shape, camera = world.shape(), world.shape(subdivisions), world.camera(size_px)
    estimator = ESTIMATORS[name](camera, world.body(believed_shape))
    # A beam tells something where it is known which ground it hits.
    off = 0.002 if name == "altimeter" else 0.01
    rows, pictures = [], []
    with (world.Local(world.scene(true_shape, size_px)) as truth,
          world.Local(world.scene(believed_shape, size_px), max_error=0.1) as board):
        for index, (true, believed) in enumerate(world.views(n_frames, off=off)):
            frame = truth.render(true, output="dn", exposure_s="auto", seed=index).pixels
            seen = frame if name != "altimeter" else truth.range(true, estimator.directions_camera)
            found, here = estimator.measure(seen, believed, board.render), sight(true, camera, "body")
            if found is None:
                sys.stdout.write(f"frame {index}: {estimator.reason}\n")
                continue
            rows.append([index, *errors(found, here, camera, name == "altimeter")])
            pictures.append((frame, camera.project(here.r_body_camera_m), np.array(found.center_px)))
    return dict(zip(("frame", "px", "percent", "sigmas", "sigma_px", "sigma_percent"), np.array(rows).T,
                    strict=True)), pictures


def errors(found: Measurement, here, camera, is_along_normal: bool) -> list[float]:
    """Of one measurement; of an altimeter along the one axis that it measures, the ground's normal."""
    place, covariance = found.place(here.range_m)
    error = place - here.r_body_camera_m
    if is_along_normal:
        sizes, axes = np.linalg.eigh(covariance)
        along = error @ axes[:, 0]
        return [np.nan, 100.0 * along / here.range_m, abs(along) / sizes[0]**0.5, np.nan,
                100.0 * sizes[0]**0.5 / here.range_m]
    off = np.array(found.center_px) - camera.project(here.r_body_camera_m)
    return [np.linalg.norm(off), 100.0 * (found.range_m / here.range_m - 1.0),
            np.sqrt(error @ np.linalg.solve(covariance, error) / 3.0), found.sigma_rad * camera.focal_length_px,
            100.0 * found.sigma_range]


def flown(names: list[str], n_frames: int, size_px: int, subdivisions: int, seed: int = 1) -> dict[str, np.ndarray]:
    """A free fall past the body, navigated: errors [m], three sigma [m] and NEES of each frame.

    Each of the estimators sees each frame; the altimeter's ranges have a sigma of 1 m.
    """
    rng, camera = np.random.default_rng(seed), world.camera(size_px)
    true_shape, believed_shape = world.shape(), world.shape(subdivisions)
    estimators = [ESTIMATORS[name](camera, world.body(believed_shape)) for name in names]
    r, v = np.array([4500.0, 2000.0, -400.0]), np.array([-0.08, 0.03, 0.012])
    navigator = Navigator(r + 100.0 * rng.standard_normal(3), v + 2e-3 * rng.standard_normal(3), sigma_r_m=100.0,
                          sigma_v_m_s=2e-3, gm_m3_s2=_GM_M3_S2, process_acceleration_m_s2=1e-8, sigma_size=_SIZE_SIGMA)
    rows = []
    with (world.Local(world.scene(true_shape, size_px)) as truth,
          world.Local(world.scene(believed_shape, size_px), max_error=0.1) as board):
        for index in range(n_frames):
            q = frames.look_at(navigator.r_m, np.zeros(3))
            true = world.state(index * _STEP_S, r, q)
            frame = truth.render(true, output="dn", exposure_s="auto", seed=index).pixels
            for estimator in estimators:
                believed, seen = world.state(index * _STEP_S, navigator.r_m, q), frame
                if estimator.name == "altimeter":
                    seen = truth.range(true, estimator.directions_camera) + _RANGE_SIGMA_M * rng.standard_normal(1)
                found = estimator.measure(seen, believed, board.render)
                if found is not None and not found.doubt:
                    navigator.update(found, frames.dcm(q))
            error, covariance = np.concatenate([navigator.r_m - r, navigator.v_m_s - v]), navigator.covariance
            rows.append([np.linalg.norm(error[:3]), 3.0 * np.trace(covariance[:3, :3])**0.5,
                         error @ np.linalg.solve(covariance, error), np.linalg.norm(r)])
            navigator.predict(np.zeros(3), _STEP_S)
            r, v = fallen(r, v)
    refused = sum(not innovation.is_accepted for innovation in navigator.innovations)
    sys.stdout.write(f"{' + '.join(names)}: {refused} of {len(navigator.innovations)} measurements refused\n")
    return dict(zip(("error_m", "three_sigma_m", "nees", "range_m"), np.array(rows).T, strict=True))


def fallen(r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity a step later, by leapfrog."""
    step = _STEP_S / 20
    for _ in range(20):
        v = v - 0.5 * step * _GM_M3_S2 * r / np.linalg.norm(r)**3
        r = r + step * v
        v = v - 0.5 * step * _GM_M3_S2 * r / np.linalg.norm(r)**3
    return r, v


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main(name: str, out: Path, n_frames: int, size_px: int) -> None:
    (_filter_figure if name == "filter" else _estimator_figure)(name, out, n_frames, size_px)
    sys.stdout.write(f"{out}\n")


def _estimator_figure(name: str, out: Path, n_frames: int, size_px: int) -> None:
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 2.0))
    picture, upper, lower = (figure.add_subplot(grid[where]) for where in (np.s_[:, 0], (0, 1), (1, 1)))
    for colour, (belief, subdivisions) in zip(_COLOURS, BELIEFS.items(), strict=True):
        rows, pictures = measured(name, n_frames, size_px, subdivisions)
        said = (f"{rms(rows['px']):.2f} px, " if np.isfinite(rows["px"]).all() else "") + (
            f"{rms(rows['percent']):.3f} % of the range, {rms(rows['sigmas']):.2f} sigma")
        sys.stdout.write(f"{name}, belief has {belief}: {said}; RMS of {len(rows['frame'])} of {n_frames} frames\n")
        for axis, quantity in ((upper, "px"), (lower, "percent")):
            axis.plot(rows["frame"], np.abs(rows[quantity]), ".-", color=colour, lw=0.8, ms=4, label=belief)
            axis.plot(rows["frame"], 3.0 * rows[f"sigma_{quantity}"], "--", color=colour, lw=0.7)
    frame, true_px, found_px = pictures[2 * len(pictures) // 3]
    # Without the sky's noise, which makes large files.
    picture.imshow(np.sqrt(np.clip(frame - 70.0, 0.0, None) / frame.max()), cmap="gray")
    picture.plot(*true_px, "o", ms=12, mew=2, mfc="none", mec="tab:green", label="true centre")
    if name != "altimeter":
        picture.plot(*found_px, "x", ms=7, mew=2, color="tab:red", label="found")
    picture.set(xticks=[], yticks=[])
    picture.legend(loc="lower right", fontsize=7)
    upper.set(ylabel="centre [px]", xticklabels=[])
    figure.legend(*lower.get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=7, title_fontsize=7,
                  title="error (dots) and 3 sigma (dashed); the belief has")
    lower.set(ylabel="range [%]" if name != "altimeter" else "along normal\n[% of range]", xlabel="frame")
    for axis in (upper, lower):
        axis.set_yscale("log")
        axis.grid(True, which="both", alpha=0.2)
    if name == "altimeter":
        upper.remove()
        lower.set_subplotspec(grid[:, 1])
    _save(figure, out)


def _filter_figure(name: str, out: Path, n_frames: int, size_px: int) -> None:
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    error, nees = figure.subplots(1, 2, width_ratios=(2.0, 1.0))
    t_h = np.arange(n_frames) * _STEP_S / 3600.0
    for colour, names in zip(("tab:green", "tab:orange", "tab:blue"), (
            ["sphere"], ["limb_ellipse", "altimeter"], ["limb_shape", "landmarks", "altimeter"]), strict=True):
        rows = flown(names, n_frames, size_px, BELIEFS["a sixteenth of its facets"])
        late = slice(n_frames // 3, None)
        percent = 100.0 * rms(rows["error_m"][late] / rows["range_m"][late])
        focal_length_px = world.camera(size_px).focal_length_px
        sys.stdout.write(f"{' + '.join(names)}: {rms(rows['error_m'][late]):.2f} m, {percent:.3f} % of the range, "
                         f"{rms(rows['error_m'][late] / rows['range_m'][late]) * focal_length_px:.2f} px, NEES "
                         f"{rows['nees'][late].mean():.1f} of 6; last two thirds of {n_frames} frames\n")
        error.plot(t_h, rows["error_m"], color=colour, label=" + ".join(names))
        error.plot(t_h, rows["three_sigma_m"], "--", color=colour, lw=0.7)
        nees.plot(t_h, rows["nees"], color=colour)
    error.set(yscale="log", xlabel="time [h]", ylabel="position [m]: error, 3 sigma (dashed)")
    figure.legend(*error.get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=7)
    nees.axhline(6.0, color="k", lw=0.7, ls=":")
    nees.set(ylim=(0.0, 12.0), xlabel="time [h]", ylabel="NEES; 6 is consistent")
    for axis in (error, nees):
        axis.grid(True, which="both", alpha=0.2)
    _save(figure, out)


def _save(figure: Figure, out: Path) -> None:
    """Of 128 colours: a small file."""
    with io.BytesIO() as drawn:
        figure.savefig(drawn, dpi=80)
        Image.open(drawn).convert("RGB").quantize(128).save(out, optimize=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", choices=[*ESTIMATORS, "filter"])
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--size-px", type=int, default=256)
    arguments = parser.parse_args()
    main(arguments.name, arguments.out, arguments.frames, arguments.size_px)
