"""Types of the public interface, by mypy: of its modules, of programs that use it, and of the documents' Python."""

from __future__ import annotations

import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
from missing import needed_module

ROOT = Path(__file__).parents[2]
PROGRAMS = ROOT / "tests" / "types"
PACKAGES = ("glrender", "glrender_camera", "glrender.brdf", "glrender.scenario", "glrender_client",
            "glrender_photogrammetry")
MORE = ("glrender.engines.image", "glrender.planner.plan", "glrender.sequences.sequence", "glrender.sequences.options",
        "glrender.sequences.labels", "glrender_camera.notebook", "glrender_client.notebook")
"""Modules of what the packages' faces do not have: results, sequences, notebooks."""


def public() -> dict[str, object]:
    """The public names, and what they stand for."""
    found = {}
    for package in map(importlib.import_module, PACKAGES):
        names = getattr(package, "__all__", None) or [name for name in vars(package) if not name.startswith("_")]
        found |= {f"{package.__name__}.{name}": getattr(package, name) for name in names}
    return {name: each for name, each in found.items() if hasattr(each, "__module__") or inspect.ismodule(each)}


def modules() -> list[str]:
    """The modules where public names are at home."""
    homes = {each.__name__ if inspect.ismodule(each) else each.__module__ for each in public().values()}
    return sorted({home for home in homes if home.startswith("glrender")} | set(PACKAGES) | set(MORE))


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What mypy tells, in one run: the lines of its output, by file."""
    needed_module("mypy", "pip install -e '.[test]'")
    snippets = tmp_path_factory.mktemp("snippets")
    for page in (ROOT / "README.md", ROOT / "camera_model" / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        for index, code in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)):
            # What goes on from a block before has no imports of its own.
            if "import" in code and "render(state" not in code:
                (snippets / f"{page.stem}_{index}.py").write_text(code, encoding="utf-8")
    files = [*sorted(snippets.glob("*.py")), *sorted(PROGRAMS.glob("*.py"))]
    assert len(files) >= 8
    sources = [inspect.getsourcefile(importlib.import_module(name)) for name in modules()]
    run = subprocess.run([sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", "--check-untyped-defs",
                          "--no-error-summary", *map(str, files), *sources], cwd=ROOT, capture_output=True, text=True,
                         timeout=400)
    assert run.returncode in (0, 1), run.stdout + run.stderr
    lines = [line for line in run.stdout.splitlines() if ": error: " in line]
    return {"lines": lines, "snippets": snippets}


def of(told, path: Path) -> list[str]:
    """Errors in a file, or below a folder."""
    return [line for line in told["lines"] if (ROOT / line.split(":")[0]).resolve().is_relative_to(path.resolve())]


def test_the_public_modules_have_no_error(told):
    found = [line for line in told["lines"] if not line.startswith("tests/")
             and line not in of(told, told["snippets"])]
    assert not found, "\n".join(found)


def test_a_typed_program_has_no_error(told):
    assert not of(told, PROGRAMS / "uses.py")


def test_the_python_of_the_documents_has_no_error(told):
    assert not of(told, told["snippets"])


def test_each_mistake_is_told_in_its_line_and_no_other(told):
    expected = {(number, kind) for number, line in enumerate((PROGRAMS / "misuses.py").read_text().splitlines(), 1)
                for kind in re.findall(r"# expect: ([\w-]+)", line)}
    found = {(int(line.split(":")[1]), re.search(r"\[([\w-]+)\]$", line)[1])
             for line in of(told, PROGRAMS / "misuses.py")}
    assert len(expected) > 15 and found == expected


def test_every_public_signature_is_annotated():
    """Arguments and results of functions, classes and their public methods; but of what `self` and `cls` are."""
    bare = []
    for name, each in public().items():
        functions = {name: each} if inspect.isfunction(each) else {
            f"{name}.{key}": getattr(value, "__func__", value) for key, value in vars(each).items()
            if not key.startswith("_")} if inspect.isclass(each) else {}
        for place, function in functions.items():
            if inspect.isfunction(function):
                signature = inspect.signature(function)
                parameters = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
                if any(p.annotation is p.empty for p in parameters) or signature.return_annotation is signature.empty:
                    bare.append(place)
    assert not bare
