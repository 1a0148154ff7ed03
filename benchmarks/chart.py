"""Charts and a table from a pytest-benchmark JSON file: chart.py FRAME.json OUT_FOLDER."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

STAGES = ("plan", "shadow", "surface", "readback")


def main(source: Path, out: Path) -> None:
    entries = json.loads(source.read_text(encoding="utf-8"))["benchmarks"]
    frames = [e for e in entries if e["name"].startswith("test_frame")]
    rays = {e["extra_info"]["facets"]: e["stats"]["median"] for e in entries if e["name"].startswith("test_embree")}
    lines = ["| facets | law | image | samples | shadow map | median ms | " + " | ".join(STAGES)
             + " | over Embree, 1 sample |", "|" + "---|" * (7 + len(STAGES))]
    for entry in sorted(frames, key=lambda e: (e["extra_info"]["samples"], e["extra_info"]["size_px"],
                                               e["extra_info"]["facets"], e["extra_info"]["law"],
                                               e["extra_info"]["is_reused"])):
        info, median = entry["extra_info"], entry["stats"]["median"]
        ray = rays.get(info["facets"]) if info["size_px"] == 1024 else None
        stages = " | ".join(f"{info['stages_ms'].get(stage, 0.0):.1f}" for stage in STAGES)
        lines.append(f"| {info['facets']} | {info['law']} | {info['size_px']} | {info['samples']} | "
                     f"{'reused' if info['is_reused'] else 'fresh'} {info['shadow_map_px']} | {1e3 * median:.1f} | "
                     f"{stages} | {'' if ray is None else f'{median / ray:.3f}'} |")
    table = "\n".join(lines) + "\n"
    (out / "frame.md").write_text(table, encoding="utf-8")
    sys.stdout.write(table)

    figure, (by_size, split) = plt.subplots(1, 2, figsize=(13, 4.8))
    for samples in (1, 2):
        for is_reused in (False, True):
            chosen = sorted((e["extra_info"]["facets"], 1e3 * e["stats"]["median"]) for e in frames
                            if e["extra_info"]["law"] == "hapke" and e["extra_info"]["size_px"] == 1024
                            and e["extra_info"]["samples"] == samples and e["extra_info"]["is_reused"] == is_reused)
            by_size.loglog(*zip(*chosen, strict=True), "o-",
                           label=f"{samples} x {samples}, shadow map {'reused' if is_reused else 'fresh'}")
    if rays:
        by_size.loglog(list(rays), [1e3 * t for t in rays.values()], "k^", label="Embree rays, 1 sample")
    by_size.set(xlabel="facets", ylabel="median [ms]", title="A frame of 1024 x 1024, Hapke")
    by_size.grid(True, which="both", alpha=0.3)
    by_size.legend(fontsize=8)
    chosen = sorted((e for e in frames if e["extra_info"]["law"] == "hapke" and e["extra_info"]["samples"] == 1
                     and e["extra_info"]["size_px"] == 1024 and not e["extra_info"]["is_reused"]),
                    key=lambda e: e["extra_info"]["facets"])
    bottom = [0.0] * len(chosen)
    labels = [f"{e['extra_info']['facets'] / 1e3:.0f}k" for e in chosen]
    totals = [sum(e["extra_info"]["stages_ms"].values()) for e in chosen]
    for stage in STAGES:
        shares = [100.0 * e["extra_info"]["stages_ms"].get(stage, 0.0) / total
                  for e, total in zip(chosen, totals, strict=True)]
        split.bar(labels, shares, bottom=bottom, label=stage)
        bottom = [a + b for a, b in zip(bottom, shares, strict=True)]
    split.set(xlabel="facets", ylabel="share of the frame [%]", ylim=(0, 100),
              title="Where the time goes (1 sample, fresh shadow map)")
    split.legend()
    figure.tight_layout()
    figure.savefig(out / "frame.png", dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
