"""The documentation site: `make docs` builds it of the Markdown files of this repository, where they lie."""

from importlib.metadata import version as version_of

project = "glrender"
author = "the glrender authors"
version = release = version_of("glrender")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
html_theme = "furo"
html_title = "glrender"
html_static_path: list[str] = []
# The source is the repository, so that links between documents are the same here and in a browser of files.
root_doc = "docs/index"
include_patterns = ["docs/**.md", "README.md", "SECURITY.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/*.md",
                    "clients/**/README.md", "examples/**.md"]
exclude_patterns = ["docs/checks/**"]
source_suffix = {".md": "markdown"}
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
# Headings that skip a level; names that several classes have.
suppress_warnings = ["myst.header", "ref.python"]
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
