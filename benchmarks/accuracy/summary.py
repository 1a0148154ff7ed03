"""Summary of the rows of the chart in a few numbers: Pareto front, the planner's gain, the lead over the peers."""

from __future__ import annotations

from typing import Any

import numpy as np

Row = dict[str, Any]
OWN = ("fixed", "plan", "raytrace")


def pareto(rows: list[Row]) -> list[Row]:
    """Rows than which none is both faster and more accurate, fastest first."""
    front: list[Row] = []
    for row in sorted(rows, key=lambda r: (r["p50_ms"], r["rms"])):
        if not front or row["rms"] < front[-1]["rms"]:
            front.append(row)
    return front


def lead_over_peers(rows: list[Row], slack: float = 1.02) -> dict[str, float]:
    """For each peer, the least ratio of its time to that of our fastest frame of equal or better accuracy.

    Fresh shadow maps; 0 where none of ours is as accurate.
    """
    ours = [r for r in rows if r["engine"] in OWN and r["map"] != "reused"]
    lead: dict[str, float] = {}
    for row in rows:
        if row["engine"] in OWN:
            continue
        as_good = [r["p50_ms"] for r in ours if r["rms"] <= slack * row["rms"]]
        ratio = row["p50_ms"] / min(as_good) if as_good else 0.0
        lead[row["engine"]] = min(ratio, lead.get(row["engine"], np.inf))
    return lead


def lead_of_plans(rows: list[Row], shadow_map: str = "fresh", slack: float = 1.02) -> dict[str, dict[str, Any] | None]:
    """For each of the planner's frames, the fastest frame of a peer that is as accurate, and the ratio of their times.

    None where no peer's is; `slack` as of `lead_over_peers`.
    """
    found: dict[str, dict[str, Any] | None] = {}
    for row in rows:
        if row["engine"] == "plan" and row["map"] == shadow_map:
            as_good = [r for r in rows if r["engine"] not in OWN and r["rms"] <= slack * row["rms"]]
            peer = min(as_good, key=lambda r: r["p50_ms"], default=None)
            found[row["config"]] = peer and {"peer": f"{peer['engine']} {peer['config']}",
                                             "ratio": peer["p50_ms"] / row["p50_ms"]}
    return found


def planner_gain(rows: list[Row], budget: float, fixed: str = "8 x 8", shadow_map: str = "fresh") -> float:
    """Time of the fixed full-fidelity frame over that of the planner's at a budget."""
    time = {r["config"]: r["p50_ms"] for r in rows if r["map"] == shadow_map}
    return time[fixed] / time[f"plan {budget:g}"]


def misses(rows: list[Row]) -> list[str]:
    """The planner's rows outside their budget or their prediction."""
    found = []
    for row in rows:
        if row["engine"] == "plan" and row["map"] == "fresh":
            if row["rms"] > row["max_error"]:
                found.append(f"{row['config']}: RMS {row['rms']:.3f}, predicted {row['predicted']:.3f}")
            if abs(row["flux"]) > 0.1 * row["max_error"]:
                found.append(f"{row['config']}: flux {row['flux']:+.2%}")
    return found


def markdown(cases: list[dict[str, Any]]) -> str:
    """Tables for RESULTS.md."""
    lines = []
    for case in cases:
        lines += [f"### {case['name']}", "", f"Truth: {case['truth_samples']} x {case['truth_samples']} rays a pixel, "
                  f"own RMS error {case['truth_error']:.1e}.", "",
                  "| engine | configuration | map | p50 ms | p95 ms | RMS | flux | centroid px | limb px | "
                  "shadow wrong |", "|" + "---|" * 10]
        for r in sorted(case["rows"], key=lambda r: (r["engine"] not in OWN, r["engine"], r["map"], r["p50_ms"])):
            shadow = "" if np.isnan(r["shadow"]) else f"{r['shadow']:.2%}"
            lines.append(f"| {r['engine']} | {r['config']} | {r['map']} | {r['p50_ms']:.1f} | {r['p95_ms']:.1f} | "
                         f"{r['rms']:.4f} | {r['flux']:+.2%} | {r['centroid_px']:.3f} | {r['limb_px']:.3f} | "
                         f"{shadow} |")
        lines.append("")
    return "\n".join(lines)
