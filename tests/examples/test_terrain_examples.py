"""The examples of terrain: a map that opens as it should, ground that faces up, a tube that a camera may be in."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from missing import needed_module

FOLDER = Path(__file__).parents[2] / "examples" / "terrain"


@pytest.fixture
def examples(monkeypatch):
    """The modules of both examples, and those of the benchmark that one takes its truth from."""
    needed_module("rasterio.warp", "pip install \"glrender[terrain]\"")
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    import landing
    import tube

    return landing, tube


@pytest.mark.slow
def test_the_examples_ground_and_tube_are_as_they_say(examples, tmp_path):
    """The landing's map has its site, rille and front; the tube is one closed shell that faces inward."""
    landing, tube = examples
    landing.write_map(tmp_path / "apollo15.tif")
    rings = [[500.0, 50.0], [30_000.0, 500.0]]
    ground = landing.patch(tmp_path / "apollo15.tif", site_deg=landing.SITE_DEG, rings=rings)
    assert ground.report.warnings == () and ground.report.n_shells == 1 and (ground.facet_normals[:, 2] > 0.0).all()
    assert np.abs(ground.vertices_m[:, :2]).max() >= 30_000.0 and np.ptp(ground.vertices_m[:, 2]) > 2000.0
    shape = tube.tube()
    assert shape.inside and shape.report.n_shells == 1 and shape.report.volume_m3 < -5000.0
