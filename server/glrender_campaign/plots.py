"""Plots of a campaign's report, as SVG."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_COLOURS = ("#1f6fb4", "#d9730d", "#3a9a4b", "#8a4fb0", "#7a7a7a", "#b8860b", "#0e8f8f", "#c2427f")
_LOST_COLOUR = "#c62828"
# Tracks that are drawn of a campaign; more are a blot.
_MOST_TRACKS = 200


def error_against(axis: str, values: Sequence[str], results: Sequence[Mapping[str, Any]],
                  places: Sequence[int], groups: Sequence[str]) -> str:
    """The navigation error of each case against an axis, and the medians; cases that lost the body stand on top.

    Parameters
    ----------
    axis : str
    values : sequence of str
        The axis' own, as text.
    results : sequence of mappings
    places : sequence of int
        Of each result, which value it has.
    groups : sequence of str
        Of each result, what it is coloured by; all equal for one colour.
    """
    plt = _pyplot(axis)
    names = list(dict.fromkeys(groups))
    figure, plot = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
    # Next to each other, in their order: the same picture each time.
    for number, name in enumerate(names):
        shift = 0.0 if len(names) == 1 else 0.5 * (number / (len(names) - 1) - 0.5)
        for place in range(len(values)):
            own = [result for result, at, group in zip(results, places, groups, strict=True)
                   if at == place and group == name]
            kept = [_percent(result) for result in own if result["status"] == "kept"]
            colour = _COLOURS[number % len(_COLOURS)]
            if kept:
                spread = np.linspace(-0.07, 0.07, len(kept)) if len(kept) > 1 else [0.0]
                plot.plot(place + shift + np.array(spread), kept, ".", color=colour, alpha=0.5, markersize=5)
                plot.hlines(np.median(kept), place + shift - 0.1, place + shift + 0.1, color=colour, linewidth=2.5)
            if lost := len(own) - len(kept):
                plot.annotate(f"{lost} lost", (place + shift, 0.97), xycoords=("data", "axes fraction"), ha="center",
                              va="top", fontsize=8, color=_LOST_COLOUR)
    for number, name in enumerate(names if len(names) > 1 else ()):
        plot.plot([], [], ".-", color=_COLOURS[number % len(_COLOURS)], label=name)
    if len(names) > 1:
        figure.legend(fontsize=8, ncols=4, loc="outside upper right", frameon=False)
    if any(result["status"] == "kept" for result in results):
        plot.set_yscale("log")
    # Room for the count of those that are lost.
    plot.set_ylim(top=3.0 * plot.get_ylim()[1])
    plot.set(xticks=range(len(values)), xticklabels=values, xlim=(-0.6, len(values) - 0.4), xlabel=axis,
             ylabel="error, % of the range")
    plot.grid(True, axis="y", which="both", alpha=0.25)
    return _svg(plt, figure)


def tracks(results: Sequence[Mapping[str, Any]]) -> str:
    """The navigation error after each frame, of all cases."""
    plt = _pyplot("tracks")
    figure, plot = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
    shown = results[::-(-len(results) // _MOST_TRACKS)]
    for result in sorted(shown, key=lambda each: each["status"] == "lost"):
        is_lost = result["status"] == "lost"
        plot.semilogy(100.0 * np.array(result["track"]), color=_LOST_COLOUR if is_lost else "0.6", linewidth=1.0,
                      alpha=0.8 if is_lost else 0.5)
    longest = max(len(result["track"]) for result in results)
    of_frame = [[result["track"][index] for result in results if len(result["track"]) > index]
                for index in range(longest)]
    plot.semilogy([100.0 * np.median(each) for each in of_frame], color=_COLOURS[0], linewidth=2.5, label="median")
    plot.legend(fontsize=8)
    plot.set(xlabel="frame", ylabel="error, % of the range")
    plot.grid(True, which="both", alpha=0.25)
    return _svg(plt, figure)


def _percent(result: Mapping[str, Any]) -> float:
    return 100.0 * result["error_over_range"]["rms_settled"]


def _svg(plt: Any, figure: Any) -> str:
    file = io.StringIO()
    # Without a date: the same results give the same bytes.
    figure.savefig(file, format="svg", metadata={"Date": None})
    plt.close(figure)
    return file.getvalue()


def _pyplot(salt: str) -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"svg.hashsalt": salt, "font.size": 9})
    return plt
