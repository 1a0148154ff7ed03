"""Frames that get worse by a tighter tolerance: `python benchmarks/tighter.py [--count N] [--first SEED]`.

Each seed is a scene of one of four kinds in turn: a body, a body next to another, few large facets, a crescent. It is
drawn at six tolerances. A frame is worse if its predicted error exceeds the least of the looser ones' by
`WORSE_PREDICTED`, or its true error by `WORSE_TRUE` and the truth's own error. Prints the worse ones, and the processor
time of all; fails where there is one. No number was fitted to these seeds (`fits/scene_sets.py`).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from accuracy import units
from accuracy.hard_scenes import draw_crescent, draw_plain
from fits.scene_sets import NEVER_FITTED
from glrender import Renderer

TOLERANCES = (0.05, 0.02, 0.012, 0.01, 0.005, 0.002)
WORSE_PREDICTED, WORSE_TRUE = 1.2, 1.5
"""Ratios to the least error of the looser tolerances from which a frame is worse: predicted, and true."""
KINDS = (units.draw_small, units.draw_neighbours, draw_plain, draw_crescent)


def frames_of(case, exact: units.DenseTruth, tolerances: Iterable[float] = TOLERANCES) -> list[dict]:
    """A scene's frames by tolerance, the loosest first."""
    rows = []
    with Renderer(case.scene) as renderer:
        for tolerance in tolerances:
            begin = time.process_time()
            image = renderer.render(case.state, max_error=tolerance)
            seconds = time.process_time() - begin
            squared = exact.errors(image.irradiance_W_m2)["rms"]**2 - exact.own["rms"]**2
            rows.append({"tolerance": tolerance, "predicted": image.plan.predicted_error,
                         "true": float(np.sqrt(max(squared, 0.0))), "own": exact.own["rms"], "seconds": seconds,
                         "how": [window.how for window in image.plan.windows]})
    return rows


def worse(rows: list[dict]) -> list[dict]:
    """The frames that are worse than one of a looser tolerance."""
    found = []
    for k, row in enumerate(rows[1:], 1):
        predicted, true = (min(each[name] for each in rows[:k]) for name in ("predicted", "true"))
        if row["predicted"] > WORSE_PREDICTED * predicted or row["true"] > WORSE_TRUE * true + row["own"]:
            found.append(row)
    return found


def truth_of(kind: str, seed: int, case, most_rays: float, folder: Path) -> units.DenseTruth | None:
    """The truth of a scene, kept in a folder."""
    path = folder / f"{kind}_{seed}_{most_rays:g}.npz"
    if not path.exists():
        made = units.dense_truth(case.scene, case.state, most_rays)
        if made is None:
            np.savez(path, exact=np.zeros(0))
        else:
            np.savez_compressed(path, exact=made.exact, body=made.body, own=json.dumps(made.own))
    with np.load(path) as stored:
        if not stored["exact"].size:
            return None
        return units.DenseTruth(exact=stored["exact"], body=stored["body"], own=json.loads(str(stored["own"])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=NEVER_FITTED["draw_plain"][0].start, help="the first seed")
    parser.add_argument("--rays", type=float, default=2e6, help="of the truth, for each scene")
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent.parent / "out" / "tighter")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    n_scenes, bad, seconds, missed = 0, [], 0.0, 0
    for seed in range(arguments.first, arguments.first + arguments.count):
        draw = KINDS[seed % len(KINDS)]
        case = draw(seed)
        exact = truth_of(draw.__name__, seed, case, arguments.rays, arguments.folder)
        if exact is None:
            continue
        rows, n_scenes = frames_of(case, exact), n_scenes + 1
        seconds += sum(row["seconds"] for row in rows)
        above = [row for row in rows if row["true"] > np.hypot(row["predicted"], row["own"])]
        missed += len(above)
        if worse(rows):
            bad.append(seed)
        if above or worse(rows):
            sys.stdout.write(f"{seed} {draw.__name__} {case.body}, {case.law}, {case.body_px:.0f} px, "
                             f"{case.phase_deg:.0f} deg\n")
            for row in rows:
                sys.stdout.write("   " + json.dumps({key: float(f"{value:.3g}") if isinstance(value, float) else value
                                                     for key, value in row.items()}) + "\n")
            sys.stdout.flush()
    sys.stdout.write(f"{n_scenes} scenes, {len(bad)} get worse {bad}; {missed} frames err by more than predicted; "
                     f"{seconds:.1f} s of processor time\n")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
