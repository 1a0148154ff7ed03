"""The tutorial of docs/basilisk.md: its simulation takes its images through the adapter, as its page shows them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import vizard_peer as peer
from PIL import Image

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "basilisk"


def test_the_first_images_are_those_of_the_page(tmp_path, basilisk):
    """Three valid images, none saturated; beside each other they are the page's picture."""
    with peer.adapter(tmp_path, map_text=(EXAMPLE / "map.toml").read_text(encoding="utf-8")) as (endpoint, _):
        process = basilisk(EXAMPLE / "first_images.py", [endpoint.rpartition(":")[2], tmp_path / "images"])
        process.stdin = None
        output = process.communicate(timeout=180)[0]
    assert process.returncode == 0 and "valid: 1" in output, output[-3000:]
    assert "saturated" not in (tmp_path / "vizard.log").read_text()
    paths = sorted((tmp_path / "images").glob("*.png"), key=lambda path: float(path.stem))
    assert [float(path.stem) for path in paths] == [300.0, 600.0, 900.0]
    row = np.hstack([np.asarray(Image.open(path).convert("L")) for path in paths])
    shown = Image.open(ROOT / "docs" / "img" / "basilisk_first.png").convert("L")
    ours = np.asarray(Image.fromarray(row).resize(shown.size), float)
    assert np.corrcoef(ours.ravel(), np.asarray(shown, float).ravel())[0, 1] > 0.93
