"""The wheel: one `pip install` brings client, server and renderer; importing them is quick and finds each name."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
PACKAGES = {"glrender": "glrender", "glrender_camera": "camera_model/glrender_camera"} | {
    f"glrender_{name}": f"server/glrender_{name}" for name in ("server", "view", "campaign", "cli", "vizard")} | {
    f"glrender_{name}": f"clients/python/glrender_{name}" for name in ("client", "navigation", "photogrammetry")}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder that the wheel's files are unpacked in."""
    folder = tmp_path_factory.mktemp("wheel")
    built = subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
                           cwd=REPOSITORY, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0, built.stderr
    wheel, = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder / "site")
    return folder / "site"


def test_every_file_of_the_packages_is_in_the_wheel(installed):
    for package, home in PACKAGES.items():
        tracked = subprocess.run(["git", "ls-files", "."], cwd=REPOSITORY / home, capture_output=True, text=True)
        names = tracked.stdout.split()
        assert names and not [name for name in names if not (installed / package / name).is_file()]
        assert (installed / package / "py.typed").is_file()


@pytest.mark.slow
def test_the_wheel_alone_draws_and_serves(installed, tmp_path):
    """`make wheels`, which CI runs, tries it in an environment of its own."""
    code = (f"import sys; sys.path.insert(0, {str(installed)!r})\n"
            "import glrender_client, glrender_cli.__main__ as cli\n"
            f"assert glrender_client.__file__.startswith({str(installed)!r})\n"
            "cli.main(['init']); raise SystemExit(cli.main(['check', 'scene.toml', '--max-error', '0.2']))")
    run = subprocess.run([sys.executable, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0 and "frame: 1024 x 1024" in run.stdout, run.stdout + run.stderr


@pytest.mark.parametrize("package", ["glrender", "glrender_camera", "glrender_navigation"])
def test_every_name_is_found_where_type_checkers_see_it(package):
    module = importlib.import_module(package)
    branch = next(node for node in ast.parse(Path(module.__file__).read_text()).body if isinstance(node, ast.If))
    seen = {alias.asname or alias.name for node in branch.body for alias in node.names}
    assert set(module.__all__) <= seen <= set(dir(module))
    for node in branch.body:
        home = importlib.import_module("." * node.level + (node.module or ""), package)
        for alias in node.names:
            expected = getattr(home, alias.name, None) or importlib.import_module(f"{home.__name__}.{alias.name}")
            assert getattr(module, alias.asname or alias.name) is expected
    with pytest.raises(AttributeError, match="no attribute 'Rendrer'"):
        _ = module.Rendrer


def test_importing_takes_no_time():
    """Processor time beside an empty Python's: 0.05 s; 1.2 s with all that is loaded later."""
    code = "import time; began = time.process_time(); import {}; print(time.process_time() - began)"
    command = [sys.executable, "-c", code.format("glrender")]
    assert min(float(subprocess.run(command, capture_output=True, text=True).stdout) for _ in range(3)) < 0.3
