"""Figures of real frames beside ours, with the signed residual."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from compare import fitted, residual_percent
from PIL import Image

plt.switch_backend("Agg")

_SCALE = {"cmap": "RdBu_r", "vmin": -50.0, "vmax": 50.0, "interpolation": "nearest"}
_LABEL = "real minus rendered\n[% of the brightest]"
_N_SHOWN = 4


def pair_figure(path: Path, frame, view: str, ours: np.ndarray, score: float) -> None:
    """One image: real, rendered, residual."""
    figure, axes = plt.subplots(1, 3, figsize=(12.6, 4.4), layout="constrained")
    picture = _panels(axes, frame, ours, (slice(None), slice(None)))
    for axis, title in zip(axes, (frame.name, f"rendered, pose: {view}, NCC {score:.3f}", ""), strict=True):
        axis.set_title(title, fontsize=9)
    figure.colorbar(picture, ax=axes[2], label=_LABEL.replace("\n", " "))
    figure.savefig(path, dpi=80)
    plt.close(figure)


def body_figure(path: Path, rows: list) -> None:
    """A body's images by their best pose, from the lowest NCC to the highest, and the NCC of all."""
    views = list(dict.fromkeys(view for _, view, _, _ in rows))
    best = sorted((row for row in rows if row[1] == views[-1]), key=lambda row: row[3])
    chosen = [best[index] for index in np.unique(np.linspace(0, len(best) - 1, _N_SHOWN).astype(int))]
    if len(chosen) == 1:
        _single(path, *chosen[0])
        return
    figure = plt.figure(figsize=(3.0 * len(chosen) + 0.9, 11.4), layout="constrained")
    grid = figure.add_gridspec(4, len(chosen), height_ratios=(3, 3, 3, 2.4))
    right = []
    for column, (frame, _, ours, score) in enumerate(chosen):
        axes = [figure.add_subplot(grid[row, column]) for row in range(3)]
        picture = _panels(axes, frame, ours, _box(ours, frame.pixels))
        axes[0].set_title(frame.name.removeprefix("ROS_CAM1_"), fontsize=9)
        axes[1].set_title(f"NCC {score:.3f}", fontsize=9)
        if column == 0:
            for axis, text in zip(axes, ("real", "rendered", "residual"), strict=True):
                axis.set_ylabel(text)
        right.append(axes[2])
    figure.colorbar(picture, ax=right[-1], label=_LABEL, shrink=0.9)
    axis = figure.add_subplot(grid[3, :])
    for view, mark in zip(views, "ox", strict=False):
        scores = [row[3] for row in rows if row[1] == view]
        axis.plot(scores, mark, label=f"{view} pose: median {np.median(scores):.3f}")
    axis.set(xlabel=f"image, of {len(best)} in order of time", ylabel="NCC, whole frame", ylim=(None, 1.0))
    axis.grid(True, alpha=0.3)
    axis.legend(loc="lower right")
    figure.savefig(path, dpi=72, pil_kwargs={"quality": 82})
    plt.close(figure)


def beside(path: Path, frame, ours: np.ndarray, size_px: int = 448) -> None:
    """One image and ours, cut to the body, in one scale of grey."""
    box, white = _box(ours, frame.pixels), np.quantile(frame.pixels, 0.9995)
    sheet = Image.new("L", (2 * size_px + 4, size_px), 255)
    for index, pixels in enumerate((frame.pixels, fitted(ours, frame.pixels))):
        grey = (255.0 * (pixels[box] / white).clip(0.0, 1.0)).astype(np.uint8)
        half = Image.fromarray(grey).resize((size_px, size_px), Image.Resampling.LANCZOS)
        sheet.paste(half, (index * (size_px + 4), 0))
    sheet.save(path, quality=88)


def _single(path: Path, frame, view: str, ours: np.ndarray, score: float) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(14.0, 4.9), layout="constrained")
    picture = _panels(axes, frame, ours, (slice(None), slice(None)))
    for axis, title in zip(axes, (f"real: {frame.name}", f"rendered, NCC {score:.3f}", "residual"), strict=True):
        axis.set_title(title)
    figure.colorbar(picture, ax=axes[2], label=_LABEL)
    figure.savefig(path, dpi=90, pil_kwargs={"quality": 82})
    plt.close(figure)


def _panels(axes, frame, ours: np.ndarray, box: tuple[slice, slice]):
    white = np.quantile(frame.pixels, 0.9995)
    for axis, pixels in zip(axes, (frame.pixels, fitted(ours, frame.pixels)), strict=False):
        axis.imshow(pixels[box], cmap="gray", vmin=0.0, vmax=white, interpolation="nearest")
    picture = axes[2].imshow(residual_percent(ours, frame.pixels)[box], **_SCALE)
    for axis in axes:
        axis.set(xticks=[], yticks=[])
    return picture


def _box(ours: np.ndarray, real: np.ndarray) -> tuple[slice, slice]:
    """A square about what is lit, with a margin."""
    rows, columns = np.nonzero(ours > 0.02 * ours.max())
    half = int(0.56 * max(np.ptp(rows), np.ptp(columns))) + 4
    centre = [(rows.min() + rows.max()) // 2, (columns.min() + columns.max()) // 2]
    start = [min(max(c - half, 0), max(size - 2 * half, 0)) for c, size in zip(centre, real.shape, strict=True)]
    return tuple(slice(s, s + 2 * half) for s in start)
