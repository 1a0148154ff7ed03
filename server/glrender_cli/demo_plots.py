"""Plots that the demo leaves to look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle


def centres_sheet(path: Path, pictures: list, t_s: list[float], range_m: np.ndarray, n_shown: int = 12) -> None:
    """Frames spread over the flight, each with its measured centre."""
    chosen = np.unique(np.linspace(0, len(pictures) - 1, n_shown).astype(int))
    columns = 4
    rows = -(-len(chosen) // columns)
    figure = Figure(figsize=(3.2 * columns, 3.4 * rows))
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, index in zip(axes.flat, chosen, strict=False):
        pixels, center_px = pictures[index]
        axis.imshow(pixels, cmap="gray", vmin=0, vmax=np.iinfo(pixels.dtype).max, interpolation="nearest")
        if center_px is not None:
            axis.plot(*center_px, "+", color="tab:orange", markersize=12)
        axis.set_title(f"frame {index}, {t_s[index] / 3600.0:.1f} h, {range_m[index] / 1e3:.2f} km", fontsize=9)
    figure.suptitle("What the camera saw (+: centre found on board)")
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def trajectory_plot(path: Path, t_s: np.ndarray, r_true_m: np.ndarray, r_estimated_m: np.ndarray,
                    radius_m: float, latency_ms: np.ndarray) -> None:
    """True and estimated trajectory, navigation error, and latency."""
    figure = Figure(figsize=(15, 4.6))
    plane, error, latency = figure.subplots(1, 3)
    plane.plot(r_true_m[:, 0] / 1e3, r_true_m[:, 1] / 1e3, label="true")
    plane.plot(r_estimated_m[:, 0] / 1e3, r_estimated_m[:, 1] / 1e3, "--", label="estimated")
    plane.add_patch(Circle((0.0, 0.0), radius_m / 1e3, color="0.6"))
    plane.set(xlabel="x inertial [km]", ylabel="y inertial [km]", title="Trajectory", aspect="equal")
    plane.legend()
    hours = t_s / 3600.0
    error.semilogy(hours, np.linalg.norm(r_estimated_m - r_true_m, axis=1))
    error.set(xlabel="time [h]", ylabel="|estimate - truth| [m]", title="Navigation error")
    error.grid(True, which="both", alpha=0.3)
    latency.plot(latency_ms, ".", markersize=3)
    latency.set(xlabel="frame", ylabel="request to frame [ms]", title="Latency", ylim=(0.0, None))
    latency.grid(True, alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=90)
