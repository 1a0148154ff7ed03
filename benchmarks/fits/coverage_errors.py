"""Fit the errors of clipped facets: `python benchmarks/fits/coverage_errors.py [--first SEED] [--count N]`.

Frames of one body are drawn by exact coverage with its facets clipped as they are, none divided, and compared with
float64 rays. Prints, over the frames, percentiles of the numbers in `glrender/engines/coverage/sunlit_error.py`:

- `CLIPPED_ERROR`: true squared error over the squared light of clipped triangles, with the safety of few;
- `_CLIPPED_BIAS`: light that is missing over the light of clipped triangles;
- the ratio of the true to the estimated error, for the RMS and for the flux.

An estimate has to be above 95 % of its frames and should not be twice that. Seeds: `scene_sets.py`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from accuracy import units
from glrender.engines.coverage import accumulate, sunlit_error
from glrender.engines.coverage.boundary_refinement import find_areas
from glrender.engines.coverage.corner_visibility import look
from glrender.engines.coverage.facet_tables import FacetTables
from glrender.engines.coverage.image_cells import ImageCells
from glrender.engines.rays.engine import RayEngine
from glrender.planner.error_budget import FLUX_SHARE
from glrender.scene.scene import Scene
from glrender.view.regions import region
from glrender.view.view import view_bodies
from scene_sets import COVERAGE_FITTED

_PERCENTILES = (50, 90, 95, 100)
# Light of clipped triangles over all light, from which a frame counts.
_LEAST_SHARE = 0.01


def frame(seed: int, most_rays: float) -> dict | None:
    """What one frame says of the constants; None where the body is not all before the camera, or not clipped."""
    case = units.draw_small(seed)
    scene = Scene(bodies=case.scene.bodies, cameras=case.scene.cameras, sun_disc=False)
    camera, body = scene.cameras[0], scene.bodies[0]
    views = view_bodies(case.state, camera, scene.hulls)
    view, = views
    if view.bounds_px is None or not view.is_visible:
        return None
    rays = RayEngine(scene)
    x0, y0, x1, y1 = region(views, camera)
    cells = ImageCells(camera, (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5), (x1 - x0, y1 - y0))
    seen = look(FacetTables(body, rays.solid(body.name)), view, views, cells, rays, 0.0)
    if not seen.light > 0.0 or not len(seen.boundary.facet):
        return None
    areas = find_areas(seen, math.inf, 0.0)
    changes = accumulate.no_changes(cells.shape)
    areas.add_to(changes, cells, 0.0)
    image = np.zeros((camera.height_px, camera.width_px))
    image[y0:y1, x0:x1] = cells.light(changes, scene.solar_irradiance_of(camera), 0.5)[0]
    exact = units.dense_truth(scene, case.state, most_rays)
    if exact is None:
        return None
    true, lit_px = exact.errors(image), np.count_nonzero(exact.exact)
    scale = sunlit_error.ErrorScale(light=seen.light, n_px=seen.area_px, phase_rad=view.phase_rad,
                                    flux_share=FLUX_SHARE)
    squared = max(true["rms"] ** 2 - exact.own["rms"] ** 2, 0.0) * seen.light**2 / lit_px
    clipped_light = float((seen.radiance.of(areas.clipped.facet) * areas.clipped.area_px).sum())
    missing = float((exact.exact - image).sum() / exact.exact.sum()) * seen.light
    return {"seed": seed, "body": case.body, "phase_deg": case.phase_deg, "size_px": view.size_px,
            "n_clipped": len(areas.clipped.facet), "clipped_share": clipped_light / seen.light,
            "CLIPPED_ERROR": squared / float(seen.squared_light(areas.clipped).sum()),
            "_CLIPPED_BIAS": missing / clipped_light,
            "rms": scale.rms(squared) / scale.error(areas.squared),
            "flux": max(true["flux"] - exact.own["flux"], 0.0) / FLUX_SHARE / scale.error(areas.squared)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=COVERAGE_FITTED.start)
    parser.add_argument("--count", type=int, default=len(COVERAGE_FITTED))
    parser.add_argument("--rays", type=float, default=2e6, help="of the truth, for each frame")
    arguments = parser.parse_args()
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        row = frame(seed, arguments.rays)
        if row is not None:
            rows.append(row)
            sys.stderr.write(json.dumps(row) + "\n")
    # Where little is clipped the truth's own error is what is measured.
    rows = [row for row in rows if row["clipped_share"] > _LEAST_SHARE]
    names = ("CLIPPED_ERROR", "_CLIPPED_BIAS", "rms", "flux")
    sys.stdout.write(f"| of {len(rows)} frames | " + " | ".join(f"{each} %" for each in _PERCENTILES) + " |\n")
    sys.stdout.write("|" + "---|" * (1 + len(_PERCENTILES)) + "\n")
    for name in names:
        found = np.percentile([row[name] for row in rows], _PERCENTILES)
        sys.stdout.write(f"| {name} | " + " | ".join(f"{each:.3g}" for each in found) + " |\n")


if __name__ == "__main__":
    main()
