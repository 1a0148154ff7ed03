"""The examples of terrain: a map that opens as it should, ground that faces up, a tube that a camera may be in."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from missing import needed_module

FOLDER = Path(__file__).parents[2] / "examples" / "terrain"
BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "descent.py"


@pytest.fixture
def descent(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARK.parent)
    import descent

    return descent


def test_a_descent_beyond_a_limit_is_wrong(descent):
    """Each limit of errors, times and memory, by rows just beyond it; and none by rows within all."""
    opening = {"facets": 8_000_000, "opening_s": 59.0, "memory_GiB": 5.0}
    row = {"rms": 0.03, "predicted": 0.03, "own": 0.001, "second_s": 0.4, "memory_GiB": 5.4}
    rows = [{"height_m": height_m, **row} for height_m in descent.HEIGHTS_M]
    assert len(rows) == 9 and descent.wrongs(opening, rows, 0.006) == []
    for k, change, text in ((4, {"rms": 0.0302}, "at 300 m: RMS 0.0302"), (0, {"second_s": 2.1}, "the median"),
                            (8, {"second_s": 0.49}, "at 2 m: 0.49 s, a ball"), (8, {"memory_GiB": 5.6}, "0.6 GiB more"),
                            (5, {"second_s": float("nan")}, "at 100 m: nan s, the median")):
        found = descent.wrongs(opening, [each | (change if i == k else {}) for i, each in enumerate(rows)], 0.006)
        assert any(text in each for each in found), (text, found)
    assert "2.1 s, and" in descent.wrongs(opening, [rows[8] | {"second_s": 2.1}], 1.0)[0]
    for change in ({"opening_s": 61.0}, {"memory_GiB": 6.1}):
        (found,) = descent.wrongs(opening | change, [row | {"height_m": 2.0}], 1.0)
        assert found.startswith("opening: "), change


@pytest.mark.slow
def test_a_descent_keeps_its_limits():
    """From 30 km to 2 m, 500k facets, 512 px: the benchmark finds nothing wrong, by its own rays."""
    done = subprocess.run([sys.executable, str(BENCHMARK)], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stdout[-800:] + done.stderr[-800:]


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


def test_the_example_of_regions_is_one_closed_body(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    import regions

    body, target_m = regions.lander(levels=2)
    report = body.shape.report
    assert report.is_watertight and report.n_shells == 1 and report.warnings == ()
    middles_m = body.shape.vertices_m[body.shape.facets].mean(axis=1)
    at_site = np.linalg.norm(middles_m - target_m, axis=1) < 15.0
    longest_m, is_behind = body.shape.sizes.longest_sides, middles_m @ target_m < 0.0
    assert np.median(longest_m[is_behind]) > 3.0 * np.median(longest_m[at_site])
