"""The documentation site builds without a warning, and has what it should."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest
from missing import needed_module
from PIL import Image

ROOT = Path(__file__).parents[2]


SHARED = Path(os.environ.get("GLRENDER_SHARED") or ROOT.parent / "shared")
FRAMES = ("ROS_CAM1_20140807T130717", "M605862153F5")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    needed_module("sphinx", "pip install -e '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    if (SHARED / "data" / "67p").is_dir():
        drawn = subprocess.run([sys.executable, ROOT / "examples" / "real_frames" / "real_frames.py", "--out",
                                folder / "gallery", "--only", *FRAMES], capture_output=True, text=True, timeout=300,
                               env={**os.environ, "GLRENDER_SHARED": str(SHARED)})
        assert drawn.returncode == 0, drawn.stderr
    built = subprocess.run([sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs", "-d",
                            str(folder / "doctrees"), ".", str(folder / "html")],
                           cwd=ROOT, capture_output=True, text=True, timeout=600,
                           env={**os.environ, "GLRENDER_GALLERY": str(folder / "gallery")})
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


def test_the_gallery_has_every_frame_that_was_drawn(site, shared):
    """Its pictures are on the site, and the page's links lead to them."""
    assert (shared / "67p" / "navcam" / f"{FRAMES[0]}.png").is_file()
    page = (site / "examples" / "real_frames" / "README.html").read_text(encoding="utf-8")
    pictures = re.findall(r'src="\.\./\.\./(gallery/[^"]+)"', page)
    assert [Path(name).stem for name in pictures] == [f"{FRAMES[0]}_refined", f"{FRAMES[1]}_SUM"]
    for name in pictures:
        assert np.asarray(Image.open(site / name)).std() > 20, name


class Links(HTMLParser):
    """The ids of a page, and where its links and pictures lead."""

    def __init__(self, page: Path):
        super().__init__()
        self.ids: set[str] = set()
        self.targets: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list) -> None:
        given = dict(attrs)
        self.ids |= {given[name] for name in ("id", "name") if given.get(name)}
        self.targets += [given[name] for name in ("href", "src") if given.get(name)]


def broken(folder: Path) -> list[str]:
    """Links within a site that lead to no file, or to no place on its page."""
    pages = {page: Links(page) for page in folder.rglob("*.html")}
    found = []
    for page, links in pages.items():
        for target in links.targets:
            url = urlsplit(target)
            if url.scheme or url.netloc:
                continue
            file = (page.parent / unquote(url.path)).resolve() if url.path else page
            if not file.exists() or url.fragment and file in pages and unquote(url.fragment) not in pages[file].ids:
                found.append(f"{page.relative_to(folder)}: {target}")
    return found


def test_every_link_within_the_site_leads_somewhere(site):
    assert not broken(site)


def test_the_check_of_links_can_fail(tmp_path):
    (tmp_path / "a.html").write_text('<a href="b.html#x"></a><a href="b.html#y"></a><img src="c.png"/><p id="z"></p>')
    (tmp_path / "b.html").write_text('<p id="x"></p><a href="#nowhere"></a><a href="https://elsewhere.org/#no"></a>')
    assert sorted(broken(tmp_path)) == ["a.html: b.html#y", "a.html: c.png", "b.html: #nowhere"]


def test_the_field_pages_tables_are_there(site):
    page = (site / "docs" / "reference" / "scene_files.html").read_text(encoding="utf-8")
    assert page.count("<table") > 55 and "aperture_diameter_m" in page and "slow_motion" in page


def test_notebooks_show_their_pictures(site):
    """Pictures and tables as they were stored; of a box of widgets its still picture."""
    for name in ("one_frame", "a_flyby"):
        page = (site / "docs" / "notebooks" / f"{name}.html").read_text(encoding="utf-8")
        assert page.count("<img") >= 2 and "widget-view" not in page
