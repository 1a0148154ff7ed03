"""Plots of the stability sweeps for benchmarks/RESULTS.md: `python benchmarks/stability.py`.

The tests bound the same numbers. Writes out/stability.{png,json}.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "support"))
import sweeps

REPOSITORY = Path(__file__).parent.parent

PHASES_DEG = (0.0, 15.0, 30.0, 60.0, 90.0, 120.0, 140.0, 150.0, 160.0, 165.0, 170.0, 175.0)
SIZES_PX = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 3.0, 3.9, 4.1, 5.0, 6.0, 8.0, 10.0, 14.0, 20.0)
PLACES = ((0.0, 0.0), (0.31, 0.17), (-0.45, 0.49))
CRESCENTS_DEG = (160.0, 165.0, 170.0, 172.0, 174.0, 176.0, 178.0, 179.0)


def main() -> None:
    found = {
        "false_shadow": [sweeps.false_shadow(phase, 200.0, 4) for phase in PHASES_DEG],
        "pillar_px": [sweeps.pillar_shadow(phase) for phase in PHASES_DEG[1:]],
        "small": {str(phase): [[sweeps.small_body(size, phase, place, max_error=0.02) for place in PLACES]
                               for size in SIZES_PX] for phase in (20.0, 90.0)},
        "limb_px": sweeps.limb_offsets().tolist(),
        "crescent": {name: [sweeps.crescent(phase, is_rough)[:2] for phase in CRESCENTS_DEG]
                     for name, is_rough in (("sphere", False), ("rough", True))},
    }
    out = REPOSITORY / "out"
    out.mkdir(exist_ok=True)
    (out / "stability.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    draw(found, out / "stability.png")


def draw(found: dict, path: Path) -> None:
    figure, panels = plt.subplots(2, 3, figsize=(16, 9))
    acne, pillar, limb, flux, centre, crescent = panels.ravel()
    acne.semilogy(PHASES_DEG, np.maximum(np.abs(found["false_shadow"]), 1e-6), "o-")
    acne.axhline(5e-4, color="k", linestyle=":", label="goal")
    acne.set(title="Acne: light that a convex body's own shadow map takes", xlabel="phase [deg]", ylabel="of its flux")
    pillar.plot(PHASES_DEG[1:], found["pillar_px"], "o-")
    pillar.set(title="A pillar's shadow is too long by", xlabel="phase [deg]", ylabel="[px]")
    angle = np.arange(len(found["limb_px"])) * 360.0 / len(found["limb_px"])
    limb.plot(angle, found["limb_px"], "o-")
    limb.axhline(0.05, color="k", linestyle=":")
    limb.axhline(-0.05, color="k", linestyle=":", label="goal")
    limb.set(title="The limb at every orientation", xlabel="direction in the image [deg]", ylabel="outward [px]")
    for phase, rows in found["small"].items():
        values = np.array(rows)
        flux.loglog(SIZES_PX, np.abs(values[:, :, 0]).max(axis=1), "o-", label=f"phase {float(phase):g} deg")
        centre.loglog(SIZES_PX, values[:, :, 1].max(axis=1), "o-", label=f"phase {float(phase):g} deg")
    flux.axhline(0.01, color="k", linestyle=":", label="goal")
    flux.set(title="Small bodies, budget 0.02: largest flux error", xlabel="body [px]", ylabel="relative")
    centre.axhline(0.01, color="k", linestyle=":", label="goal")
    centre.set(title="Small bodies: centre of brightness off by at most", xlabel="body [px]", ylabel="[px]")
    for name, rows in found["crescent"].items():
        error, predicted = np.array(rows, float).T
        crescent.semilogy(CRESCENTS_DEG, np.abs(error), "o-", label=f"{name}: flux error")
        crescent.semilogy(CRESCENTS_DEG, predicted, ":", label=f"{name}: predicted RMS")
    crescent.set(title="Thin crescents, budget 0.02", xlabel="phase [deg]", ylabel="relative")
    for panel in panels.ravel():
        panel.grid(True, which="both", alpha=0.25)
        if panel.get_legend_handles_labels()[0]:
            panel.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
