"""Speed against accuracy: `make chart`, or `python benchmarks/speed_accuracy.py [--quick] [--scenes PART...]`.

Renders scenes with a grid of configurations, with the planner's own choices and with the peers, measures
times and errors against ray-traced truth, and writes out/speed_accuracy.{png,csv,json,md}. Read ratios within
a scene: it is one run on one machine.
"""

from __future__ import annotations

import argparse
import csv
import json
import platform
import sys
from pathlib import Path

import numpy as np
from accuracy import plot, scenes, summary
from accuracy.measure import Limits, measure
from glrender import Renderer
from peers import environment
from peers.worker import PEERS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="four scenes, few frames: some minutes")
    parser.add_argument("--scenes", nargs="*", metavar="PART", help="only scenes whose name holds one of these")
    parser.add_argument("--peers", nargs="*", choices=sorted(PEERS), help="only these peers; none: no peers")
    parser.add_argument("--add", action="store_true", help="keep the other scenes of an earlier run's report")
    parser.add_argument("--out", type=Path, default=environment.REPOSITORY / "out")
    arguments = parser.parse_args()
    chosen = [case for case in scenes.CASES if not arguments.quick or case.name in scenes.QUICK]
    if arguments.scenes:
        chosen = [case for case in scenes.CASES if any(part in case.name for part in arguments.scenes)]
    limits = Limits(most=11, ours_s=15.0, peer_s=4.0) if arguments.quick else Limits()
    wanted = list(PEERS) if arguments.peers is None else arguments.peers
    missing = environment.install() if wanted else {}
    arguments.out.mkdir(parents=True, exist_ok=True)
    report = {"machine": platform.processor() or platform.machine(), "python": platform.python_version(),
              "peers_missing": missing, "cases": []}
    earlier = arguments.out / "speed_accuracy.json"
    if arguments.add and earlier.is_file():
        names = [case.name for case in chosen]
        report = json.loads(earlier.read_text(encoding="utf-8")) | {"peers_missing": missing}
        report["cases"] = [case for case in report["cases"] if case["name"] not in names]
    for case in chosen:
        scene, state = scenes.build(case)
        if "gl_renderer" not in report:
            with Renderer(scene) as renderer:
                report["gl_renderer"] = renderer.info["gl_renderer"]
        drawing = [] if case.is_default else [name for name in wanted if name not in missing]
        measured = measure(scene, state, limits, drawing)
        measured = {"name": case.name, "n_facets": sum(len(body.shape.facets) for body in scene.bodies),
                    "lead": summary.lead_over_peers(measured["rows"]),
                    "lead_of_plans": {shadow_map: summary.lead_of_plans(measured["rows"], shadow_map)
                                      for shadow_map in ("fresh", "reused")},
                    "gain": {f"{budget:g}": summary.planner_gain(measured["rows"], budget)
                             for budget in (0.1, 0.05, 0.02, 0.01)},
                    "misses": summary.misses(measured["rows"]), **measured}
        report["cases"].append(measured)
        said = {key: measured[key] for key in ("name", "gain", "lead", "misses", "failed")}
        sys.stdout.write(json.dumps(said) + "\n")
        sys.stdout.flush()
        _write(report, arguments.out)


def _write(report: dict, out: Path) -> None:
    """Write the rows after each scene, so that a run that is stopped leaves its rows."""
    order = [case.name for case in scenes.CASES]
    cases = report["cases"] = sorted(report["cases"], key=lambda case: order.index(case["name"]))
    report["planner_gain_geometric_mean"] = {
        budget: float(np.exp(np.mean([np.log(case["gain"][budget]) for case in cases])))
        for budget in cases[0]["gain"]}
    (out / "speed_accuracy.json").write_text(json.dumps(report, indent=1), encoding="utf-8")
    (out / "speed_accuracy.md").write_text(summary.markdown(cases), encoding="utf-8")
    columns = list(dict.fromkeys(name for case in cases for row in case["rows"] for name in row))
    with (out / "speed_accuracy.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["scene", "n_facets", *columns])
        writer.writeheader()
        for case in cases:
            writer.writerows({"scene": case["name"], "n_facets": case["n_facets"], **row} for row in case["rows"])
    plot.draw(cases, out / "speed_accuracy.png",
              f"Speed against accuracy, Lambert with cast shadows; {report['gl_renderer']}, {report['machine']}")


if __name__ == "__main__":
    main()
