"""The commands that a person types: render, info, demo."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import serving
import views
from cells import slow_but
from glrender_server.cli import main
from PIL import Image
from programs import GLRENDER, run


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    return tmp_path


def test_render_draws_a_picture_and_an_array(folder):
    made = run("render", "scene.toml", "--out", "a.png", cwd=folder)
    assert made.returncode == 0 and "a.png: 96 x 64" in made.stdout, made.stderr
    picture = np.asarray(Image.open(folder / "a.png"))
    assert picture.shape == (64, 96) and picture.max() == 255
    assert 0.05 < (picture > 0).mean() < 0.6, "the body fills about half of the frame's height"
    assert run("render", "scene.toml", "--camera", "bare", "--out", "b.npy", cwd=folder).returncode == 0
    irradiance = np.load(folder / "b.npy")
    assert irradiance.shape == (32, 32) and irradiance.dtype == np.float32 and irradiance.max() > 0.0


EXAMPLES = Path(__file__).parents[2] / "examples"
SCENES = sorted(EXAMPLES.glob("*.toml"))


# The starry one is drawn with its state by test_capture_server.py.
@pytest.mark.parametrize("scene", slow_but(
    SCENES, *(place for place, file in enumerate(SCENES) if file.stem != "starry_flyby")), ids=lambda path: path.name)
def test_every_example_scene_renders(scene, tmp_path):
    made = run("render", str(scene), "--out", "frame.png", cwd=tmp_path)
    assert made.returncode == 0 and "warning" not in made.stderr, made.stderr
    assert np.asarray(Image.open(tmp_path / "frame.png")).max() > 100


def test_the_example_script_runs_as_it_is(tmp_path):
    made = subprocess.run([sys.executable, str(EXAMPLES / "render_state.py")], cwd=tmp_path,
                          capture_output=True, text=True, timeout=120)
    assert made.returncode == 0, made.stderr
    assert "predicted error" in made.stdout and "nan" not in made.stdout


@pytest.mark.parametrize("program", ["glrender", "glrender-server"])
def test_a_program_tells_its_version(program, tmp_path):
    """That of pyproject.toml, and nothing else is needed."""
    table = tomllib.loads((EXAMPLES.parent / "pyproject.toml").read_text(encoding="utf-8"))
    said = subprocess.run([GLRENDER.with_name(program), "--version"], cwd=tmp_path, capture_output=True, text=True)
    assert (said.returncode, said.stdout) == (0, f"{program} {table['project']['version']}\n")


def test_render_takes_a_state_file(folder):
    (folder / "state.json").write_text(json.dumps(views.state().to_dict()))
    assert run("render", "scene.toml", "--state", "state.json", "--camera", "navcam", cwd=folder).returncode == 0
    assert (folder / "frame.png").is_file()


@pytest.mark.parametrize("arguments, message", [
    (["render", "none.toml"], "none.toml: cannot be read"),
    (["render", "scene.toml", "--camera", "wac"], "camera: unknown camera, got 'wac'"),
    (["render", "scene.toml", "--samples", "0"], "samples: must be an integer between 1 and 16"),
    (["render", "scene.toml", "--state", "none.json"], "none.json"),
    (["render", "scene.toml", "--state", "scene.toml"], "scene.toml: is not JSON"),
    (["render", "scene.toml", "--out", "frame.gif2"], "frame.gif2: must end in .png or .npy"),
    (["demo", "--frames", "0"], "frames: must be an integer between 24"),
    (["demo", "--frames", "23"], "frames: must be an integer between 24"),
    (["demo", "--max-error", "0"], "max-error: must be > 0 and <= 1, got 0.0"),
    (["demo", "--max-error", "nan"], "max-error: must be a finite number, got nan"),
    (["demo", "--shape", "scene.toml", "--length-unit", "mile"], "length-unit: must be m, km, or metres per unit"),
    (["render", "scene.toml", "--phase-deg", "nan"], "phase-deg: must be a finite number, got nan"),
    (["render", "scene.toml", "--phase-deg", "181"], "phase-deg: must be between 0 and 180, got 181.0"),
    (["demo", "--shape", "none.obj"], "none.obj: cannot be read"),
])
def test_mistakes_are_told_in_one_line(folder, arguments, message, monkeypatch, capfd):
    """By the program's entry point, within this process: each new one takes two seconds to begin."""
    monkeypatch.chdir(folder)
    assert main(arguments) == 1
    told = capfd.readouterr().err
    assert message in told and "Traceback" not in told and told.count("\n") == 1


def test_a_mistake_is_the_exit_status_of_the_program(folder):
    made = run("render", "none.toml", cwd=folder)
    assert made.returncode == 1 and made.stderr.startswith("glrender: none.toml: cannot be read"), made.stderr


@pytest.mark.parametrize("estimator, seed", slow_but([("model", 1), ("sphere", 3)], 0))
def test_the_shortest_demo_keeps_the_body(folder, estimator, seed):
    made = run("demo", "--frames", "24", "--size-px", "128", "--estimator", estimator, "--seed", str(seed),
               cwd=folder, timeout=240)
    assert made.returncode == 0, made.stdout + made.stderr


def test_render_takes_capital_endings(folder):
    assert run("render", "scene.toml", "--camera", "bare", "--out", "A.PNG", cwd=folder).returncode == 0
    assert run("render", "scene.toml", "--camera", "bare", "--out", "A.NPY", cwd=folder).returncode == 0
    assert np.asarray(Image.open(folder / "A.PNG")).shape == np.load(folder / "A.NPY").shape == (32, 32)


def test_info_as_json_names_the_backends(folder):
    entries = json.loads(run("info", "--json", cwd=folder).stdout)
    assert [entry["backend"] for entry in entries] == ["egl", "osmesa"]


@pytest.mark.parametrize("shape", slow_but([None, "itokawa/itokawa_8q_768.obj"], 0))
def test_the_demo_flies_its_loop_and_leaves_its_pictures(folder, shape, request):
    arguments = []
    if shape is not None:
        arguments = ["--shape", request.getfixturevalue("shared") / shape, "--length-unit", "km"]
    made = run("demo", "--frames", "40", "--size-px", "128", "--out", "out", *arguments, cwd=folder, timeout=240)
    assert made.returncode == 0, made.stderr
    summary = json.loads((folder / "out" / "summary.json").read_text())
    assert summary["frames"] == 40 and summary["frames_per_second"] > 0.0
    assert "WARNING" not in made.stderr
    assert summary["range_m"]["last"] < 0.5 * summary["range_m"]["first"], "it approached"
    error = summary["navigation_error_m"]
    assert error["rms_settled"] < 0.3 * error["handover"], "it found its way"
    assert summary["navigation_error_over_range"] < 0.02
    for name in ("contact_sheet.png", "trajectory.png"):
        assert Image.open(folder / "out" / name).size[0] > 500
