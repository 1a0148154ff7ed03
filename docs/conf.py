"""The documentation site: `make docs` builds it of the Markdown files of this repository, where they lie."""

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
                    "CHANGELOG.md", "benchmarks/*.md", "clients/**/README.md", "examples/**README.md"]
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


def _with_fields(app, name: str, source: list[str]) -> None:
    """The tables of the page of fields, from the classes."""
    if name == "docs/reference/scene_files":
        import scene_fields

        source[0] += "\n" + scene_fields.markdown()


def setup(app) -> None:
    """What Sphinx calls of this file."""
    app.connect("source-read", _with_fields)
