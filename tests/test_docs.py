"""The Python of the documentation runs as it is printed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import glrender
import PIL.Image
import pytest
import serving
from glrender import Scene, generate

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


def test_the_readmes_server_draws_the_readmes_state(tmp_path, monkeypatch):
    """Its scene file, its command and its client's lines; of the address only the port is another."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = {kind: re.findall(rf"```{kind}\n(.*?)```", page, re.S) for kind in ("python", "toml", "sh")}
    assert "\nglrender-server scene.toml " in "\n".join(["", *blocks["sh"]])
    generate.three_lobes(radius_m=0.3, subdivisions=2).to_file(tmp_path / "itokawa.obj")
    monkeypatch.chdir(tmp_path)
    with serving.server(tmp_path, scene=blocks["toml"][0]) as (endpoint, _):
        names = {}
        for code in blocks["python"]:
            exec(compile(code.replace("tcp://127.0.0.1:5555", endpoint), "README", "exec", dont_inherit=True), names)
    assert names["reply"].pixels.shape == (1024, 1024) and names["reply"].pixels.max() > 100


def test_the_readme_installs_what_its_lines_import():
    """The client is a package of its own, which the line beside make's names too."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.search(r"pip install '\.\[raytrace\]' \./clients/python", page)
    assert (ROOT / "clients" / "python" / "pyproject.toml").is_file()


def test_names_for_all_hide_none_of_other_packages():
    """`from glrender import *` after `from PIL import Image`."""
    names = {}
    exec("from PIL import Image\nfrom glrender import *", names)
    assert names["Image"] is PIL.Image and "plan" in glrender.Image.__annotations__
    assert names["Renderer"] is glrender.Renderer and set(glrender.__all__) <= set(names)


@pytest.mark.parametrize("name", ["service_checks.md", "camera_checks.md", "plugins_checks.md"])
def test_the_tests_that_a_page_of_checks_names_are_there(name):
    page = (ROOT / "docs" / name).read_text(encoding="utf-8")
    named = set(re.findall(r"test_\w+", page))
    defined = {name for file in (ROOT / "tests").glob("test_*.py")
               for name in re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.M)}
    assert len(named) > 50 and named <= defined, named - defined
    assert all((ROOT / "benchmarks" / file).is_file() for file in set(re.findall(r"\w+\.py", page)))


CAMERA = """solar_irradiance_1au_W_m2 = 700.0
[[bodies]]
name = "moonlet"
generated = {kind = "icosphere", radius_m = 50.0, subdivisions = 2}
brdf = {law = "lambert", normal_albedo = 0.2}
[[cameras]]
name = "wide"
width_px = 64
height_px = 64
focal_length_px = 300.0
"""


@pytest.mark.parametrize("index", [0, 1])
def test_the_scene_files_of_the_camera_models_page_load(index):
    """Its tables, behind a body and a camera."""
    page = (ROOT / "docs" / "camera_model.md").read_text(encoding="utf-8")
    text = re.findall(r"```toml\n(.*?)```", page, re.S)[index]
    # A mosaic's bands have their own irradiance.
    table = tomllib.loads(CAMERA[CAMERA.index("[["):] + text if "pattern" in text else CAMERA + text)
    camera = Scene.from_dict(table).cameras[0]
    assert camera.model is not None and (camera.distortion is None) == ("distortion" not in text)


def test_there_are_snippets():
    assert len(SNIPPETS) >= 4
