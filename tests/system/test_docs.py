"""The Python of the documentation runs as it is printed."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import glrender
import numpy as np
import PIL.Image
import pytest
import serving
from glrender import PinholeCamera, State, generate
from glrender.scenario import scenario_of_table
from glrender_camera import AutoExposure, Detector, Optics
from glrender_camera.aberrations import Aberrations
from glrender_camera.faults.fault import Fault
from glrender_camera.faults.frame_faults import KINDS
from glrender_camera.straylight import StrayLight
from glrender_cli.__main__ import main
from glrender_server.codec import MINOR_VERSION, VERSION
from likely import all_likely
from missing import needed_module
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "camera_model" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
DOCUMENTS = [*PAGES, ROOT / "CHANGELOG.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs" / "decisions").glob("*.md")),
             *sorted((ROOT / "benchmarks").glob("*.md")), *sorted((ROOT / "clients").glob("*/README.md")),
             *sorted((ROOT / "examples").glob("**/README.md"))]
READ = [*DOCUMENTS, *sorted(path for path in (ROOT / "examples").glob("**/*.md") if path.name != "README.md")]
PRIVATE_WORDS = ("middles", "lit triangles", "kept at nodes", "as lit as", "tells", "told", "beside", "mixed facets",
                 "looks closer", "looking closer")
"""Words that docs/glossary.md, or the verb of the case (predicted, reported, near), has a term of the field for."""
# The client's lines need a server: test_server.py runs them.
SNIPPETS = [pytest.param(code, id=f"{page.relative_to(ROOT)}-{index}") for page in PAGES
            for index, code in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S))
            if "tcp://" not in code]


@pytest.mark.parametrize("code", SNIPPETS)
def test_a_snippet_runs_alone(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if "scenario.toml" in code:
        assert main(["init", "--scenario", "csv"]) == 0
    else:
        generate.three_lobes(radius_m=0.3, subdivisions=2).to_file(tmp_path / "itokawa.obj")
    with all_likely():
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


def test_the_tutorials_loop_flies(tmp_path, monkeypatch):
    """Its client, beside the scene that its Python makes; of the address only the port is another."""
    scene, loop = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8"), re.S)
    generate.three_lobes(radius_m=300.0, subdivisions=2).to_file(tmp_path / "itokawa.obj")
    monkeypatch.chdir(tmp_path)
    assert main(["init", "itokawa.obj", "--unit", "m"]) == 0
    with serving.server(tmp_path, scene=(tmp_path / "scene.toml").read_text()) as (endpoint, _):
        code = compile(loop.replace("tcp://127.0.0.1:5555", endpoint), "tutorial", "exec", dont_inherit=True)
        exec(code, names := {})
    assert names["step"] == 9 and names["reply"].pixels.max() > 100 and not names["reply"].warnings


def test_names_for_all_hide_none_of_other_packages():
    """`from glrender import *` after `from PIL import Image`."""
    names = {}
    exec("from PIL import Image\nfrom glrender import *", names)
    assert names["Image"] is PIL.Image and "plan" in glrender.Image.__annotations__
    assert names["Renderer"] is glrender.Renderer and set(glrender.__all__) <= set(names)


BASE = """[[bodies]]
name = "NAME"
generated = {kind = "icosphere", radius_m = 50.0, subdivisions = 2}
brdf = {law = "lambert", normal_albedo = 0.2}
[[cameras]]
name = "navcam"
width_px = 64
height_px = 64
focal_length_px = 300.0
"""
AT_REST = """[trajectory]
kind = "at_rest"
r_m = [2000.0, 0.0, 0.0]
[sun]
r_m = [1.0e11, 0.0, -1.0e11]
[time]
times_s = [0.0]
"""
# Files that are no scene: their own commands read them (tests/campaign, tests/vizard, tests/scene/test_plugins.py), or
# that need a map (tests/scene/test_terrain.py).
NO_SCENES = ("campaign.md", "basilisk.md", "plugins.md", "terrain.md")
TOML = [pytest.param(text, id=f"{page.relative_to(ROOT)}-{index}") for page in PAGES if page.name not in NO_SCENES
        for index, text in enumerate(re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.S))]


@pytest.mark.parametrize("text", TOML)
def test_glrender_check_takes_every_toml_of_the_pages(text, tmp_path, monkeypatch, capsys):
    """In a folder with the files that they name; parts behind a body and a camera. Frames are smaller."""
    generate.three_lobes(radius_m=0.3, subdivisions=2).to_file(tmp_path / "itokawa.obj")
    PIL.Image.new("L", (64, 32), 128).save(tmp_path / "albedo.png")
    monkeypatch.chdir(tmp_path)
    if not isinstance(tomllib.loads(text).get("bodies"), list):
        name = re.search(r'body = "(\w+)"|belief\.bodies\.(\w+)|$', text)
        base = BASE.replace("NAME", name[1] or name[2] or "moonlet")
        text = f"{base}{text}{AT_REST if '[belief' in text else ''}"
    (tmp_path / "page.toml").write_text(text.replace("_px = 1024", "_px = 64"))
    assert main(["check", "page.toml", "--max-error", "0.2"]) == 0, capsys.readouterr().err
    assert "camera navcam: " in capsys.readouterr().out


def test_there_is_toml():
    assert len(TOML) >= 7


@pytest.mark.parametrize("kind", [Optics, Aberrations, StrayLight, Detector, AutoExposure])
def test_the_camera_models_page_names_every_setting(kind):
    page = (ROOT / "docs" / "camera_model.md").read_text(encoding="utf-8")
    assert not [field.name for field in dataclasses.fields(kind) if not re.search(rf"\b{field.name}\b", page)]


def test_the_defaults_on_the_camera_models_page():
    """Rows of one number for a setting or for several, against the classes."""
    page = (ROOT / "docs" / "camera_model.md").read_text(encoding="utf-8")
    defaults = {field.name: field.default for kind in (Optics, Aberrations, StrayLight, Detector)
                for field in dataclasses.fields(kind)}
    checked = []
    for keys, given in re.findall(r"^\| (`[^|]*`) \|[^|]*\| ([-\d., ]+) \|", page, re.M):
        names = [key.split(".")[-1] for key in re.findall(r"`([\w.]+)`", keys)]
        numbers = [float(number) for number in given.split(", ")]
        for name, number in zip(names, numbers * (len(names) if len(numbers) == 1 else 1), strict=True):
            assert (defaults[name] or 0.0) == number, name
            checked.append(name)
    assert len(checked) > 20


def test_the_camera_models_page_has_every_fault_with_its_defaults():
    page = (ROOT / "docs" / "camera_model.md").read_text(encoding="utf-8")
    common = {field.name for field in dataclasses.fields(Fault)}
    for kind, fault in KINDS.items():
        (given,) = re.findall(rf"^\| `{kind}` \| ([^|]*) \|", page, re.M)
        defaults = {field.name: field.default for field in dataclasses.fields(fault) if field.name not in common}
        assert re.findall(r"`(\w+)`", given) == list(defaults), kind
        numbers = re.findall(r"` ([\d.]+)", given)
        assert [float(text) for text in numbers] == [v for v in defaults.values() if v is not dataclasses.MISSING]


def test_there_are_snippets():
    assert len(SNIPPETS) >= 4


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)


def anchors(page: Path) -> set[str]:
    """What links may name after `#`, as GitHub makes it of headings."""
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
            for heading in re.findall(r"^#+ (.*)$", prose(page), re.M)}


@pytest.mark.parametrize("page", READ, ids=lambda page: str(page.relative_to(ROOT)))
def test_lines_are_short_enough_to_read(page):
    lines = prose(page).splitlines()
    assert not [line for line in lines if len(line) > (300 if line.startswith("|") else 120)]


@pytest.mark.parametrize("page", READ, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_has_the_fields_words(page):
    text = " ".join(prose(page).split())
    assert not re.findall(rf"\b(?:{'|'.join(PRIVATE_WORDS)})\b", text)


@pytest.mark.parametrize("page", READ, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


def test_the_readme_leads_to_every_page():
    linked = set(re.findall(r"\]\(docs/([^)#]+)", (ROOT / "README.md").read_text(encoding="utf-8")))
    pages = {page.name for page in DOCUMENTS if page.parent == ROOT / "docs"}
    assert pages <= linked, pages - linked


def test_each_line_of_a_call_stack_is_in_the_code():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    calls = re.findall(r"^    ([ \w./]+\.py) +(\w+)$", page, re.M)
    assert len(calls) == len(re.findall(r"^    .*\.py", page, re.M)) > 30
    assert not [(path, name) for path, name in calls
                if not re.search(rf"^(?:class|def) {name}\b", (ROOT / path.strip()).read_text(encoding="utf-8"), re.M)]


def test_the_protocols_page_has_the_version():
    page = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    assert page.startswith(f"# Wire protocol, version {VERSION}, minor version {MINOR_VERSION}\n")
    assert f"`protocol_minor` ({MINOR_VERSION}: " in page


def test_the_terrain_pages_camera_looks_down_with_north_up():
    """And by its other quaternion at the horizon: the site's axes are east, north, up."""
    page = (ROOT / "docs" / "terrain.md").read_text(encoding="utf-8")
    state = json.loads(re.search(r"```json\n(.*?)```", page, re.S)[1])
    camera = PinholeCamera(name="camera", width_px=64, height_px=64, focal_length_px=100.0)
    other = [float(word) for word in re.search(r"`q_from_inertial` \[(.*?)\]", page)[1].split(",")]
    for q, points, places in (
            (state["spacecraft"]["q_from_inertial"], [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0], [50, 0], [0, -50]]),
            (other, [[0, 10, 2], [1, 10, 2], [0, 10, 3]], [[0, 0], [10, 0], [0, -10]])):
        pose = State.from_dict({**state, "spacecraft": {**state["spacecraft"], "q_from_inertial": q}}).spacecraft
        seen = Rotation.from_quat(pose.q_from_inertial, scalar_first=True).apply(np.array(points) - pose.r_inertial_m)
        np.testing.assert_allclose(camera.project(seen) - 31.5, places, atol=1e-6)


def test_the_scenario_pages_moon_goes_round():
    """Dimorphos about Didymos in 11.9 h, within 2 %; and the conventions' mounting looks along +X, +Z up."""
    page = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    orbit = tomllib.loads("orbit = " + re.search(r"of a moon \| `(\{.*?\})`", page)[1])["orbit"]
    ball = {"generated": {"kind": "icosphere", "radius_m": 80.0, "subdivisions": 1},
            "brdf": {"law": "lambert", "normal_albedo": 0.1}}
    scenario = scenario_of_table({
        "bodies": [{"name": "didymos", **ball}, {"name": "dimorphos", **ball, "orbit": orbit}],
        "cameras": [{"name": "navcam", "width_px": 8, "height_px": 8, "focal_length_px": 20.0}],
        "trajectory": {"kind": "at_rest", "r_m": [1e4, 0.0, 0.0]}, "sun": {"r_m": [1.5e11, 0.0, 0.0]},
        "time": {"start_tdb": orbit["epoch_tdb"], "times_s": [0.0, 0.25 * 11.9 * 3600.0]}})
    first, quarter = (state.bodies["dimorphos"].r_inertial_m for state in scenario.states())
    np.testing.assert_allclose(first, orbit["r_m"], atol=1e-6)
    np.testing.assert_allclose(quarter, [0.0, 1190.0, 0.0], atol=0.02 * 1190.0 * np.pi / 2.0)
    text = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    q = [float(word) for word in re.search(r"`q_camera_from_spacecraft` \[([^\]]*)\]", text)[1].split(",")]
    np.testing.assert_allclose(Rotation.from_quat(q, scalar_first=True).apply([[1, 0, 0], [0, 0, 1]]),
                               [[0, 0, 1], [0, -1, 0]], atol=1e-12)


def test_documents_stay_short():
    """All but the page of all fields (docs/reference), which is made of the classes and looked up, not read."""
    count = {page: len(page.read_text(encoding="utf-8").splitlines()) for page in DOCUMENTS}
    assert sum(lines for page, lines in count.items() if page.is_relative_to(ROOT / "docs")) <= 2600
    assert count[ROOT / "CHANGELOG.md"] <= 60
    assert max(lines for page, lines in count.items() if page.parent.name == "decisions") <= 20


def test_words_are_spelt_right(tmp_path):
    """By codespell's list of common misspellings; it can fail."""
    needed_module("codespell_lib", "pip install -e '.[test]'")
    command = [sys.executable, "-m", "codespell_lib"]
    run = subprocess.run([*command, *DOCUMENTS], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout
    (tmp_path / "page.md").write_text("It is seperate.")
    assert subprocess.run([*command, tmp_path / "page.md"], capture_output=True).returncode != 0


def test_the_checks_of_pages_can_fail(tmp_path):
    page = tmp_path / "page.md"
    for text, check in (("word " * 25, test_lines_are_short_enough_to_read),
                        ("| " + "cell | " * 50, test_lines_are_short_enough_to_read),
                        ("facets that are as lit\nas their centroids", test_a_page_has_the_fields_words),
                        ("[a page](nowhere.md)", test_relative_links_lead_somewhere),
                        ("# A title\n[a section](#another-title)", test_relative_links_lead_somewhere)):
        page.write_text(text, encoding="utf-8")
        with pytest.raises(AssertionError):
            check(page)


def test_every_extra_that_a_text_names_is_one_of_ours():
    """Of pages and of messages: `pip install 'glrender[...]'` that installs nothing helps nobody."""
    ours = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    sources = [path for folder in ("glrender", "camera_model", "server", "clients", "tests", "benchmarks")
               for path in (ROOT / folder).rglob("*.py")]
    named = {extra for path in [*DOCUMENTS, *sources]
             for found in re.findall(r"glrender\[([a-z][a-z0-9,]*)\]", path.read_text(encoding="utf-8"))
             for extra in found.split(",")}
    assert named and named <= set(ours)
