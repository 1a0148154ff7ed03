"""The drawings of the documents are those that their script makes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

IMAGES = Path(__file__).parents[2] / "docs" / "img"


def test_the_drawings_are_their_scripts(tmp_path):
    subprocess.run([sys.executable, IMAGES / "concept_figures.py", tmp_path], check=True)
    made = sorted(path.name for path in tmp_path.glob("*.svg"))
    assert made == sorted(path.name for path in IMAGES.glob("concept_*.svg")) and len(made) == 3
    for name in made:
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert text == (IMAGES / name).read_text(encoding="utf-8")
        # Well formed, and within its own edges.
        root = ElementTree.fromstring(text)  # noqa: S314 (of our own script)
        _, _, width, height = map(float, root.attrib["viewBox"].split())
        for box in root.iter("{http://www.w3.org/2000/svg}rect"):
            assert float(box.get("x", 0)) + float(box.get("width")) <= width
            assert float(box.get("y", 0)) + float(box.get("height")) <= height
