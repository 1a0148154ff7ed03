"""The documentation site builds without a warning, and has what it should."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from missing import needed_module

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    needed_module("sphinx", "pip install -e '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run([sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs", "-d",
                            str(folder / "doctrees"), ".", str(folder / "html")],
                           cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert built.returncode == 0, built.stderr
    return folder / "html"


def test_every_document_is_a_page(site):
    sources = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "decisions").glob("*.md"),
               *(ROOT / "docs" / "notebooks").glob("*.ipynb"), ROOT / "README.md", ROOT / "SECURITY.md",
               ROOT / "CONTRIBUTING.md", *(ROOT / "benchmarks").glob("*.md")]
    assert len(sources) > 30
    assert not [source for source in sources
                if not (site / source.relative_to(ROOT)).with_suffix(".html").is_file()]


def test_the_reference_has_the_public_names(site):
    page = (site / "docs" / "api.html").read_text(encoding="utf-8")
    for name in ("glrender.renderer.Renderer.render", "glrender.scene.scene.Scene", "glrender_client.Client.render",
                 "glrender.scenario.Encounter", "glrender.brdf.Hapke", "glrender_camera.BrownConrady"):
        kind, _, last = name.rpartition(".")
        assert f">{last}<" in page.replace("</span>", "<").replace("<span class=\"pre\">", ">"), name
    assert (site / "searchindex.js").stat().st_size > 50_000
