"""The documentation site: `make docs` builds it of the Markdown files of this repository, where they lie."""

import os
import shutil
import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "reference"))

project = "glrender"
author = "the glrender authors"
version = release = version_of("glrender")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
html_theme = "furo"
html_title = "glrender"
html_static_path: list[str] = []
# The source is the repository, so that links between documents are the same here and in a browser of files.
root_doc = "docs/index"
include_patterns = ["docs/**.md", "docs/notebooks/*.ipynb", "README.md", "SECURITY.md", "CONTRIBUTING.md",
                    "CHANGELOG.md", "benchmarks/*.md", "clients/README.md", "clients/**/README.md",
                    "examples/**.md"]
exclude_patterns = ["docs/checks/**"]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}
# Notebooks are stored as they ran; a test runs them anew. Of a box of widgets the page has its still picture.
nb_execution_mode = "off"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}
nb_mime_priority_overrides = [("html", "application/vnd.jupyter.widget-view+json", None)]
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
# Headings that skip a level; names that several classes have.
suppress_warnings = ["myst.header", "ref.python"]
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"


# Real frames beside ours, where `make docs` or a test has drawn them.
_GALLERY = Path(os.environ.get("GLRENDER_GALLERY") or Path(__file__).parents[1] / "out" / "real_frames")


def _completed(app, name: str, source: list[str]) -> None:
    """The page that is made at a build: the gallery, from its pictures."""
    if name == "examples/real_frames/README" and (_GALLERY / "ncc.csv").is_file():
        import gallery

        source[0] += gallery.page(_GALLERY, "../../gallery")


def _copied(app, error: Exception | None) -> None:
    """The gallery's pictures, beside the pages."""
    if error is None and (_GALLERY / "ncc.csv").is_file():
        shutil.copytree(_GALLERY, Path(app.outdir) / "gallery", dirs_exist_ok=True)


def setup(app) -> None:
    """Sphinx calls this of its configuration."""
    app.connect("source-read", _completed)
    app.connect("build-finished", _copied)
