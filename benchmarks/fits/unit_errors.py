"""Fit the errors in other units to the RMS error: `python benchmarks/fits/unit_errors.py [--first SEED] [--count N]`.

Frames of one body of 60 to 450 px are drawn by several tolerances and compared with float64 rays. Prints, by how they
were drawn, percentiles of the true error over the predicted one in each unit: the numbers of
`glrender/planner/predicted.py` are right where 95 % are below 1. An error that is normal and as likely of either sign
has a median of 0.34 then. Seeds: `scene_sets.py`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from accuracy import units
from accuracy.random_scenes import draw
from glrender import Renderer
from scene_sets import UNITS_FITTED

_PERCENTILES = (50, 90, 95, 100)
_TOLERANCES = (0.1, 0.05, 0.025, 0.008, {"limb_px": 0.1}, {"range": 3e-4})


def ratios(seed: int, most_rays: float) -> list[tuple[str, dict[str, float]]]:
    """How each frame of a scene was drawn, and its true over its predicted errors; none where nothing is lit."""
    case, found = draw(seed, frame_px=300, sizes_px=(60.0, 450.0)), []
    exact = units.dense_truth(case.scene, case.state, most_rays)
    if exact is None:
        return found
    with Renderer(case.scene) as renderer:
        for tolerance in _TOLERANCES:
            image = renderer.render(case.state, max_error=tolerance)
            true = exact.errors(image.irradiance_W_m2)
            found.append((image.plan.windows[0].how, {unit: true[unit] / np.hypot(predicted, exact.own[unit])
                                                      for unit, predicted in image.plan.predicted.items()}))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=UNITS_FITTED.start)
    parser.add_argument("--count", type=int, default=len(UNITS_FITTED))
    parser.add_argument("--rays", type=float, default=3e6, help="of the truth, for each scene")
    arguments, by_how = parser.parse_args(), defaultdict(list)
    for seed in range(arguments.first, arguments.first + arguments.count):
        for how, row in ratios(seed, arguments.rays):
            by_how[how].append(row)
            sys.stderr.write(json.dumps({"seed": seed, "how": how, **row}) + "\n")
    sys.stdout.write("| frames | unit | " + " | ".join(f"{each} %" for each in _PERCENTILES) + " |\n")
    sys.stdout.write("|" + "---|" * (2 + len(_PERCENTILES)) + "\n")
    for how, rows in by_how.items():
        for unit in units.UNITS:
            found = np.percentile([row[unit] for row in rows if np.isfinite(row[unit])] or [0.0], _PERCENTILES)
            sys.stdout.write(f"| {len(rows)} {how} | {unit} | " + " | ".join(f"{each:.2f}" for each in found) + " |\n")


if __name__ == "__main__":
    main()
