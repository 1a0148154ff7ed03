"""The planner's promise on scenes that it was not fitted to: `python benchmarks/heldout.py [--count N] [--first SEED]`.

Writes out/heldout.{json,png,md}: the share of scenes whose true RMS error is within the predicted one and whose
flux error is within a tenth of it, by phase, size, facets per pixel and samples, and the time over the fixed path.
`--units` draws smaller frames instead, and checks what is predicted in every unit: out/heldout_units.{json,md};
`--kind eclipses`, `neighbours`, `tiny`, `plain` or `crescents` those of bodies in penumbras, next to another body, of
0.3 to 3 px, of few large facets, and beyond 145 deg.

Which seeds numbers were fitted to, and which never: `fits/scene_sets.py`; a run says how many of its own were.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from accuracy import units
from accuracy.check import check
from accuracy.eclipses import SpheresBefore, draw_eclipse
from accuracy.hard_scenes import draw_crescent, draw_plain
from accuracy.random_scenes import draw
from fits.scene_sets import n_fitted

OUT = Path(__file__).parent.parent / "out"
_DRAWS = {"bodies": units.draw_small, "eclipses": draw_eclipse, "neighbours": units.draw_neighbours,
          "tiny": units.draw_tiny, "plain": draw_plain, "crescents": draw_crescent}
_EDGES = {"phase_deg": (0.0, 30.0, 60.0, 90.0, 120.0, 150.0), "body_px": (3.0, 10.0, 30.0, 100.0, 320.0, 2000.0),
          "facets_per_px": (0.0, 0.05, 0.5, 5.0, 50.0, np.inf), "max_error": (0.01, 0.02, 0.05, 0.1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--rays", type=float, default=10e6, help="of the truth, for each scene")
    parser.add_argument("--rounds", type=int, default=5, help="of times, for each scene; 0: errors alone")
    parser.add_argument("--units", action="store_true", help="check flux, centre, limb and range as well")
    parser.add_argument("--kind", choices=list(_DRAWS), default="bodies", help="of scenes, with --units")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.count)
    maker = _DRAWS[arguments.kind] if arguments.units else draw
    sys.stdout.write(f"numbers were fitted to {n_fitted(maker.__name__, seeds)} of {len(seeds)} seeds\n")
    if arguments.units:
        by_unit(seeds, arguments.out, arguments.kind, 0.4 * arguments.rays)
        return
    rows = []
    for seed in seeds:
        row = check(draw(seed), arguments.rays, arguments.rounds)
        if row is not None:
            rows.append({"seed": seed, **row})
            sys.stderr.write(json.dumps(rows[-1]) + "\n")
    arguments.out.mkdir(parents=True, exist_ok=True)
    summary = summarise(rows)
    (arguments.out / "heldout.json").write_text(json.dumps({"summary": summary, "rows": rows}, indent=1),
                                                encoding="utf-8")
    (arguments.out / "heldout.md").write_text(tables(rows), encoding="utf-8")
    draw_scatter([row for row in rows if "failure" not in row], arguments.out / "heldout.png")
    sys.stdout.write(tables(rows) + json.dumps(summary) + "\n")


def by_unit(seeds: range, folder: Path, kind: str, most_rays: float) -> None:
    """Check the frames of seeds in each unit, and write rows and table."""
    rows = []
    for seed in seeds:
        case = _DRAWS[kind](seed)
        light_of = SpheresBefore(case.scene, case.state) if kind == "eclipses" else None
        row = units.check_units(case, most_rays, light_of)
        if row is not None:
            rows.append({"seed": seed, **row})
            sys.stderr.write(json.dumps(rows[-1]) + "\n")
    told = units.summary(rows)
    lines = ["| unit | frames | true <= predicted | median of true / predicted | largest | of the truth |",
             "|" + "---|" * 6]
    lines += [f"| {unit} | {row['frames']} | {row['within']:.1%} | {row['median']:.2f} | {row['largest']:.1f} | "
              f"{row['own']:.2f} |" for unit, row in told.items()]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "heldout_units.json").write_text(json.dumps({"summary": told, "rows": rows}, indent=1), encoding="utf-8")
    (folder / "heldout_units.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    sys.stdout.write("\n".join(lines) + "\n")


def summarise(rows: list[dict]) -> dict:
    """Shares that hold, and geometric means of the time ratios."""
    good = [row for row in rows if "failure" not in row]
    mean = lambda values: float(np.mean(list(values)))  # noqa: E731
    times = {} if "fresh" not in good[0] else {
        "time_over_fixed_fresh": float(np.exp(mean(np.log(row["fresh"]) for row in good))),
        "time_over_fixed_reused": float(np.exp(mean(np.log(row["reused"]) for row in good))),
        "slower_than_fixed": mean(row["fresh"] > 1.05 for row in good),
        # Where full fidelity misses the budget, it is no rival.
        "slower_though_fixed_meets_the_budget": mean(row["fresh"] > 1.05 and row["fixed_rms"] <= row["max_error"]
                                                     for row in good),
    }
    return {
        "n": len(rows), "failures": [row["failure"] for row in rows if "failure" in row],
        "rms_within_predicted": mean(row["rms"] <= row["predicted"] for row in good),
        "rms_within_budget": mean(row["rms"] <= row["max_error"] for row in good),
        "flux_within_tenth_of_predicted": mean(abs(row["flux"]) <= 0.1 * row["predicted"] for row in good),
        "flux_within_tenth_of_budget": mean(abs(row["flux"]) <= 0.1 * row["max_error"] for row in good),
        "p95_of_rms_over_predicted": float(np.percentile([row["rms"] / row["predicted"] for row in good], 95)),
        "median_of_rms_over_predicted": float(np.median([row["rms"] / row["predicted"] for row in good])),
        **times,
    }


def tables(rows: list[dict]) -> str:
    """Tables of the scenes in which the prediction holds, by each of the quantities."""
    good = [row for row in rows if "failure" not in row]
    groups = {name: [(f"{low:g} to {high:g}", [row for row in good if low <= row[name] < high])
                     for low, high in zip(edges, edges[1:], strict=False)] for name, edges in _EDGES.items()}
    for name in ("engine", "samples", "law", "body"):
        groups[name] = [(str(value), [row for row in good if row[name] == value])
                        for value in sorted({row[name] for row in good})]
    lines = ["| by | value | scenes | RMS <= predicted | flux <= predicted / 10 | median RMS / predicted | "
             "largest | largest flux error / (predicted / 10) | time / fixed, fresh |", "|" + "---|" * 9]
    for name, parts in groups.items():
        for label, part in parts:
            if part:
                ratio = [row["rms"] / row["predicted"] for row in part]
                flux = [10.0 * abs(row["flux"]) / row["predicted"] for row in part]
                lines.append(
                    f"| {name} | {label} | {len(part)} | {np.mean(np.array(ratio) <= 1.0):.0%} | "
                    f"{np.mean(np.array(flux) <= 1.0):.0%} | {np.median(ratio):.2f} | {max(ratio):.2f} | "
                    f"{max(flux):.1f} | {np.exp(np.mean(np.log([row.get('fresh', np.nan) for row in part]))):.2f} |")
    return "\n".join(lines) + "\n"


def draw_scatter(rows: list[dict], path: Path) -> None:
    """True against predicted, RMS and flux, and the time ratio against the size."""
    has_times = "fresh" in rows[0]
    n_panels = 3 if has_times else 2
    figure, panels = plt.subplots(1, n_panels, figsize=(5.3 * n_panels, 4.8))
    phase = [row["phase_deg"] for row in rows]
    predicted = np.array([row["predicted"] for row in rows])
    flux = np.maximum([abs(row["flux"]) for row in rows], 1e-6)
    for panel, values, factor, label in ((panels[0], [row["rms"] for row in rows], 1.0, "true RMS error"),
                                         (panels[1], flux, 0.1, "true flux error")):
        dots = panel.scatter(predicted, np.maximum(values, 1e-6), c=phase, cmap="viridis", s=22)
        line = np.array([predicted.min(), predicted.max()])
        panel.plot(line, factor * line, "k-", linewidth=1, label="predicted" if factor == 1.0 else "predicted / 10")
        panel.set(xscale="log", yscale="log", xlabel="predicted RMS error", ylabel=label)
        panel.legend()
        panel.grid(True, which="both", alpha=0.25)
        figure.colorbar(dots, ax=panel, label="phase [deg]")
    if has_times:
        size = [row["body_px"] for row in rows]
        for label, colour in (("fresh", "C0"), ("reused", "none")):
            panels[2].scatter(size, [row[label] for row in rows], s=22, facecolors=colour, edgecolors="C0",
                              label=f"shadow map {label}")
        panels[2].axhline(1.0, color="k", linewidth=1)
        panels[2].set(xscale="log", yscale="log", xlabel="body [px]", ylabel="time of the plan / full fidelity")
        panels[2].grid(True, which="both", alpha=0.25)
        panels[2].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    main()
