"""A tighter tolerance never gives a worse frame, neither by what is predicted nor in truth: `benchmarks/tighter.py`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import views
from glrender import Body, Renderer
from glrender.brdf import Lambert

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import tighter
from accuracy.hard_scenes import draw_plain
from accuracy.random_scenes import Draw
from accuracy.units import dense_truth

# Rays of a truth: its own error is known.
RAYS = 1.5e5


def rough(seed):
    """A rough body of 5120 facets, of 20 to 60 px, with shadows up to a crescent."""
    rng = np.random.default_rng([5, seed])
    size_px, phase_deg = float(rng.uniform(20.0, 60.0)), float(rng.uniform(20.0, 140.0))
    scene = views.scene([Body(name="body", shape=views.binary(seed % 3, 4), brdf=Lambert(normal_albedo=0.3))],
                        [views.camera(72, 10.0 * size_px)])
    return Draw(scene=scene, state=views.state(phase_deg=phase_deg, direction=rng.standard_normal(3)), body="binary",
                law="lambert", body_px=size_px, phase_deg=phase_deg, max_error=0.02)


@pytest.mark.parametrize("draw, seeds", [(draw_plain, range(30_400, 30_408)), (rough, range(8))])
def test_a_tighter_tolerance_never_gives_a_worse_frame(draw, seeds):
    rows = []
    for seed in seeds:
        case = draw(seed)
        exact = dense_truth(case.scene, case.state, RAYS)
        if exact is not None:
            rows.append(tighter.frames_of(case, exact))
    assert len(rows) >= 7
    assert not [each for frames in rows for each in tighter.worse(frames)]
    met = [row["predicted"] <= row["tolerance"] for frames in rows for row in frames if row["tolerance"] >= 0.01]
    assert np.mean(met) > 0.9


def test_what_no_engine_meets_is_predicted_no_worse_than_at_a_looser_tolerance():
    """A near crescent whose facets are too coarse for 0.002: samples err by 0.02, areas by 0.006."""
    shape = views.binary(0, 4)
    scene = views.scene([Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))], [views.camera(60, 60.0)])
    state = views.state(phase_deg=150.0, direction=np.array([0.3, -0.5, 0.8]), range_m=6.0 * shape.radius_m)
    with Renderer(scene) as renderer:
        errors = [renderer.render(state, max_error=asked).plan.predicted_error for asked in (0.006, 0.002, 0.001)]
    assert max(errors[1:]) <= tighter.WORSE_PREDICTED * errors[0]
