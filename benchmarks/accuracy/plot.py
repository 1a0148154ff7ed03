"""The chart: time against error, a panel for each scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from .summary import OWN, pareto

COLOURS = {"fixed": "#1f4e9c", "plan": "#d62728", "raytrace": "#2ca02c", "embree": "#8c564b", "mitsuba": "#ff7f0e",
           "open3d": "#9467bd", "pyrender": "#7f7f7f", "pyvista": "#bcbd22", "cycles": "#17becf"}
LABELS = {"fixed": "glrender, 1, 2, 4, 8 samples", "plan": "glrender, planner at 0.1, 0.05, 0.02, 0.01",
          "raytrace": "glrender, backend raytrace", "embree": "Embree rays (embreex)", "mitsuba": "Mitsuba 3 (LLVM)",
          "open3d": "Open3D rays", "pyrender": "pyrender", "pyvista": "PyVista", "cycles": "Cycles (bpy)"}
MARKERS = {"fixed": "o", "plan": "*", "raytrace": "P"}


def draw(cases: list[dict[str, Any]], path: Path, title: str) -> None:
    """Write the figure."""
    columns = min(len(cases), 4)
    rows = -(-len(cases) // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(4.6 * columns, 3.7 * rows + 1.2), squeeze=False)
    for panel, case in zip(panels.ravel(), cases, strict=False):
        _panel(panel, case)
    for panel in panels.ravel()[len(cases):]:
        panel.set_axis_off()
    for panel in panels[-1]:
        panel.set_xlabel("median time of a frame [ms]")
    for panel in panels[:, 0]:
        panel.set_ylabel("RMS irradiance error [1]")
    handles = {}
    for panel in panels.ravel():
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(handles.values(), handles.keys(), loc="lower center", ncols=min(columns + 1, 4), fontsize=9,
                  frameon=False)
    figure.suptitle(title, fontsize=12)
    figure.tight_layout(rect=(0.0, 0.09 if rows > 1 else 0.2, 1.0, 0.98))
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _panel(panel, case: dict[str, Any]) -> None:
    for engine, colour in COLOURS.items():
        for shadow_map in ("fresh", "reused", ""):
            chosen = sorted((r["p50_ms"], r["rms"], r["p95_ms"]) for r in case["rows"]
                            if r["engine"] == engine and r["map"] == shadow_map)
            if not chosen:
                continue
            time, error, slow = zip(*chosen, strict=True)
            is_reused = shadow_map == "reused"
            marker = MARKERS.get(engine, "s")
            panel.plot(time, error, marker, color=colour, markersize=10 if engine == "plan" else 6,
                       markerfacecolor="none" if is_reused else colour,
                       label=LABELS[engine] + (", shadow map reused" if is_reused else ""))
            panel.hlines(error, time, slow, color=colour, linewidth=0.7, alpha=0.6)
    front = pareto([r for r in case["rows"] if r["engine"] in OWN and r["map"] != "reused"])
    panel.plot([r["p50_ms"] for r in front], [r["rms"] for r in front], "-", color="0.3", linewidth=1.0,
               drawstyle="steps-post", label="Pareto front of glrender, fresh maps")
    panel.axhline(case["truth_error"], color="0.6", linestyle=":", linewidth=1.0, label="the truth's own error")
    panel.set(xscale="log", yscale="log", title=case["name"])
    panel.title.set_fontsize(10)
    for axis in (panel.xaxis, panel.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    panel.grid(True, which="both", alpha=0.25)
