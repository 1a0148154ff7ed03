"""The Python of the documentation runs as it is printed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from glrender import generate

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "camera_model" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# The client's lines need a server: test_server.py runs them.
SNIPPETS = [pytest.param(code, id=f"{page.relative_to(ROOT)}-{index}") for page in PAGES
            for index, code in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S))
            if "tcp://" not in code]


@pytest.mark.parametrize("code", SNIPPETS)
def test_a_snippet_runs_alone(code, tmp_path, monkeypatch):
    generate.three_lobes(radius_m=0.3, subdivisions=2).to_file(tmp_path / "itokawa.obj")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "snippet", "exec", dont_inherit=True), {})


@pytest.mark.parametrize("name", ["service_checks.md", "plugins_checks.md"])
def test_the_tests_that_a_page_of_checks_names_are_there(name):
    page = (ROOT / "docs" / name).read_text(encoding="utf-8")
    named = set(re.findall(r"test_\w+", page))
    defined = {name for file in (ROOT / "tests").glob("test_*.py")
               for name in re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.M)}
    assert len(named) > 50 and named <= defined, named - defined
    assert all((ROOT / "benchmarks" / file).is_file() for file in set(re.findall(r"\w+\.py", page)))


def test_there_are_snippets():
    assert len(SNIPPETS) >= 4
