"""The commands that a person types: render, info, demo."""

from __future__ import annotations

import itertools
import json
import re
import socket
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import serving
import views
from cells import slow_but
from glb_parts import glb, material, sheet
from glrender import Body, PinholeCamera, Renderer, Scene, Shape, generate, load_scene
from glrender.base.errors import DeviceError
from glrender.brdf import Lambert
from glrender.engines.raster.gl.context import Context
from glrender.scene.shape.grids import cells
from glrender.sequences.contact_sheet import STRETCHES, grey_levels
from glrender.sequences.read import read_image
from glrender_cli.__main__ import COMMANDS, main
from glrender_cli.commands import doctor
from glrender_cli.subject import default_state
from PIL import Image
from programs import GLRENDER, run


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    return tmp_path


def test_render_draws_a_picture_and_an_array(folder, monkeypatch):
    made = run("render", "scene.toml", "--out", "a.png", cwd=folder)
    assert made.returncode == 0 and "a.png: 96 x 64" in made.stdout, made.stderr
    picture = np.asarray(Image.open(folder / "a.png"))
    assert picture.shape == (64, 96) and picture.max() == 255
    assert 0.05 < (picture > 0).mean() < 0.6, "the body fills most of the frame's height"
    monkeypatch.chdir(folder)
    assert main(["render", "scene.toml", "--camera", "bare", "--out", "b.npy"]) == 0
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


def test_render_takes_a_state_file(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "state.json").write_text(json.dumps(views.state().to_dict()))
    assert main(["render", "scene.toml", "--state", "state.json", "--camera", "navcam"]) == 0
    assert (folder / "frame.png").is_file()


@pytest.mark.parametrize("arguments, message", [
    (["render", "none.toml"], "none.toml: is no file"),
    (["render", "scne.toml"], "scne.toml: is no file; did you mean 'scene.toml'?"),
    (["render", "nowhere/scene.toml"], "nowhere/scene.toml: is no file; there is no folder 'nowhere'"),
    (["render", "."], ".: is no file; it is a folder"),
    (["render", "scene.toml", "--state", "nested.json"], "nested.json: is not JSON"),
    (["render", "ball.obj"], "--unit: missing: shape files carry no unit; --unit km, or --unit m"),
    (["render", "ball.obj", "--unit", "mile"], "glrender: --unit: must be 'm', 'km' or metres per unit, got 'mile'"),
    (["render", "scene.toml", "--unit", "km"], "--unit: is of shape files alone"),
    (["render", "holes.toml"], "holes.toml: is not TOML"),
    (["render", "typo.toml"], "cameras[0].widht_px: unknown key; did you mean 'width_px'? known keys are"),
    (["render", "law.toml"], "brdf.law: must be one of 'akimov'"),
    (["render", "law.toml"], "got 'lunar_lamber'; did you mean 'lunar_lambert'?"),
    (["render", "scene.toml", "--camera", "navcm"], "camera: unknown camera, got 'navcm'; did you mean 'navcam'?"),
    (["render", "scene.toml", "--samples", "0"], "samples: must be an integer between 1 and 16"),
    (["render", "scene.toml", "--max-error", "2"], "max_error: must be > 0 and <= 1, got 2.0; 2 % is 0.02"),
    (["render", "scene.toml", "--max-error", "centroid=1"], "max_error.centroid: unknown key; did you mean"),
    (["plan", "scene.toml", "--max-error", "low"], "max_error: must be a number, or units with one each, got 'low'"),
    (["render", "scene.toml", "--state", "none.json"], "none.json: is no file"),
    (["render", "scene.toml", "--state", "scene.toml"], "scene.toml: is not JSON"),
    (["render", "scene.toml", "--state", "body.json"], "state.bodies.Body: unknown body; did you mean 'body'?"),
    (["render", "scene.toml", "--state", "norm.json"], "q_from_inertial: norm must be 1 within 0.001"),
    (["render", "scene.toml", "--at", "3"], "--at: is of scenarios alone; a scene has no time, got '3'"),
    (["render", "scene.toml", "--out", "frame.gif2"], "--out: must end in .png, .jpg"),
    (["render", "scene.toml", "--out", "frame.fit"], "got 'frame.fit'; did you mean '.fits'?"),
    (["render", "scene.toml", "--out", "no/frame.png"], "--out: must be in a folder that is there"),
    (["render", "scene.toml", "--products", "range"], "--products: need a file that holds them, got 'frame.png'"),
    (["render", "scene.toml", "--products", "rang", "--out", "a.npz"], "did you mean 'range'?"),
    (["render", "scene.toml", "--products", "flow", "--out", "a.npz"], "products: must be without flow but in a seq"),
    (["render", "scene.toml", "--raw"], "--raw: is of digital numbers in a PNG"),
    (["render", "scene.toml", "--white", "-1"], "--white: must be > 0, got -1.0"),
    (["render", "scene.toml", "--exposure-s", "1"], "--exposure-s: is of digital numbers alone"),
    (["render", "scene.toml", "--output", "dn", "--exposure-s", "5ms"], "--exposure-s: must be a number"),
    (["render", "scene.toml", "--output", "dn", "--exposure-s", "0"], "exposure_s: must be"),
    (["render", "scene.toml", "--output", "dn", "--camera", "bare"], "output: camera 'bare' has no optics"),
    (["render", "scene.toml", "--backend", "cuda"], "backend: must be one of auto, egl, osmesa"),
    (["init", "--out", "scene.toml"], "--out: is there already, got 'scene.toml'; choose another name"),
    (["init", "none.obj", "--unit", "m", "--out", "new.toml"], "none.obj: is no file"),
    (["init", "ball.obj", "--out", "new.toml"], "--unit: missing"),
    (["init", "--out", "new.ini"], "--out: must end in .toml"),
    (["check", "holes.toml"], "holes.toml: is not TOML"),
    (["check", "scene.toml", "--plot", "no/x.png"], "--plot: must be in a folder that is there, got 'no/x.png'"),
    (["sequence", "scene.toml", "--write-states", "no/x"], "--write-states: must be in a folder that is there"),
    (["sequence", "scene.toml", "--out", "out", "--video", "no/x.mp4"], "--video: must be in a folder that is there"),
    (["plan", "scene.toml", "--phase-deg", "-1"], "glrender: --phase-deg: must be between 0 and 180, got -1.0"),
    (["bench", "scene.toml", "--seconds", "0"], "--seconds: must be between 0.1 and 3600, got 0.0"),
    (["demo", "--frames", "0"], "frames: must be an integer between 24"),
    (["demo", "--frames", "23"], "frames: must be an integer between 24"),
    (["demo", "--max-error", "0"], "max-error: must be > 0 and <= 1, got 0.0"),
    (["demo", "--max-error", "nan"], "max-error: must be a finite number, got nan"),
    (["demo", "--shape", "scene.toml", "--length-unit", "mile"], "length-unit: must be m, km, or metres per unit"),
    (["render", "scene.toml", "--phase-deg", "nan"], "glrender: --phase-deg: must be a finite number, got nan"),
    (["render", "scene.toml", "--phase-deg", "181"], "glrender: --phase-deg: must be between 0 and 180, got 181.0"),
    (["demo", "--shape", "none.obj"], "none.obj: cannot be read"),
])
def test_mistakes_are_told_in_one_line(folder, arguments, message, monkeypatch, capfd):
    """By the program's entry point, within this process: each new one takes two seconds to begin."""
    monkeypatch.chdir(folder)
    (folder / "ball.obj").write_text("v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    (folder / "holes.toml").write_text("[[bodies]")
    (folder / "nested.json").write_text(9000 * "[")
    (folder / "typo.toml").write_text(serving.SCENE.replace("width_px", "widht_px"))
    (folder / "law.toml").write_text(serving.SCENE.replace('"lunar_lambert"', '"lunar_lamber"'))
    state = views.state().to_dict()
    (folder / "body.json").write_text(json.dumps(state | {"bodies": {"Body": state["bodies"]["body"]}}))
    (folder / "norm.json").write_text(json.dumps(state | {"spacecraft": state["spacecraft"] | {
        "q_from_inertial": [1.0, 0.1, 0.0, 0.0]}}))
    before = sorted(folder.rglob("*"))
    assert main(arguments) == 1
    told = capfd.readouterr().err
    assert message in told and "Traceback" not in told and told.count("\n") == 1
    assert sorted(folder.rglob("*")) == before


def test_a_shape_alone_has_the_materials_of_its_file(tmp_path):
    from glrender_cli.subject import scene_of_shape

    (body,) = scene_of_shape(glb(tmp_path / "sat.glb", [sheet(0)], [material("paint", 0.8)]), "m").bodies
    assert list(body.materials) == ["paint"]
    # An OBJ may name materials that are nowhere.
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl rock\nf 1 2 3\n")
    (body,) = scene_of_shape(tmp_path / "a.obj", "m").bodies
    assert body.materials is None and body.brdf.glsl == "lommel_seeliger"


@pytest.mark.parametrize("turn", [np.eye(3), [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
def test_open_ground_is_seen_from_above(turn):
    """Ground that faces any way fills the frame, at the phase angle that is asked for; a ball is seen from -Y."""
    x, y = np.meshgrid(np.linspace(-100.0, 100.0, 5), np.linspace(-100.0, 100.0, 5), indexing="ij")
    ground = np.stack([x, y, 10.0 * np.cos(x / 40.0)], axis=-1).reshape(-1, 3) @ np.transpose(turn)
    shape = Shape.from_arrays(ground, cells(np.arange(25).reshape(5, 5)))
    ball = generate.icosphere(radius_m=5.0, subdivisions=1)
    for each, front in ((shape, np.array(turn)[:, 2]), (ball, np.array([0.0, -1.0, 0.0]))):
        scene = Scene(bodies=[Body(name="a", shape=each, brdf=Lambert(normal_albedo=0.1))],
                      cameras=[PinholeCamera(name="c", width_px=32, height_px=32, focal_length_px=40.0)])
        state = default_state(scene, "c", np.radians(40.0))
        place = state.spacecraft.r_inertial_m
        np.testing.assert_allclose(place / np.linalg.norm(place), front, atol=0.02)
        to_sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
        assert np.degrees(np.arccos(to_sun @ place / np.linalg.norm(place))) == pytest.approx(40.0, abs=1e-6)
        with Renderer(scene) as renderer:
            image = renderer.render(state)
        assert (image.irradiance_W_m2 > 0.0).mean() > 0.25 and not image.warnings


@pytest.mark.parametrize("turn", [np.eye(3), [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
@pytest.mark.parametrize("phase_deg", [0.0, 60.0, 90.0])
def test_bodies_of_a_row_shade_none(turn, phase_deg):
    """Discs of bodies as the Sun and as the camera see them are apart."""
    ground = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]) @ np.transpose(turn)
    ball, law = generate.icosphere(radius_m=3.0, subdivisions=1), Lambert(normal_albedo=0.1)
    for first in (Shape.from_arrays(ground, [[0, 1, 2]]), ball):
        bodies = [Body(name=name, shape=shape, brdf=law)
                  for name, shape in zip("abc", (first, ball, ball), strict=True)]
        scene = Scene(bodies=bodies, cameras=[PinholeCamera(name="c", width_px=32, height_px=32, focal_length_px=40.0)])
        state = default_state(scene, "c", np.radians(phase_deg))
        for seen_from_m in (state.r_sun_inertial_m, state.spacecraft.r_inertial_m):
            to = seen_from_m / np.linalg.norm(seen_from_m)
            for one, other in itertools.combinations(bodies, 2):
                apart_m = state.bodies[one.name].r_inertial_m - state.bodies[other.name].r_inertial_m
                apart_m = apart_m + one.shape.centre_m - other.shape.centre_m
                assert np.linalg.norm(np.cross(to, apart_m)) > one.hull.radius_m + other.hull.radius_m


def test_a_file_is_read_once(folder, monkeypatch):
    """Also to tell a scenario from a scene: it may be a pipe, or be written anew meanwhile."""
    from glrender_cli.subject import read_subject

    (folder / "scenario.toml").write_text(serving.SCENE + "[random]\nrange_m = [700.0, 1500.0]\nframes = 1\n")
    read, before = [], Path.read_text
    monkeypatch.setattr(Path, "read_text", lambda path, *given, **more: read.append(path.name) or before(
        path, *given, **more))
    for name in ("scene.toml", "scenario.toml"):
        assert (read_subject(folder / name, None).scenario is None) == (name == "scene.toml")
    assert read == ["scene.toml", "scenario.toml"]


@pytest.mark.parametrize("arguments, message", [
    (["rendr", "scene.toml"], "unknown command 'rendr'; did you mean 'render'?"),
    (["draw"], "unknown command 'draw'; init, check"),
    (["render", "scene.toml", "--ouput", "dn"], "unknown argument '--ouput'; did you mean '--output'?"),
    (["render"], "required: FILE"),
    ([], "required: COMMAND"),
    (["render", "scene.toml", "--seed", "x"], "argument --seed: invalid int value: 'x'"),
    (["sequence", "scene.toml", "--exposure-s", "5ms"], "--exposure-s: must be a number of seconds, or auto, got"),
    (["render", "a.toml", "--phase-deg", "3", "--at", "1"], "argument --at: not allowed with argument --phase-deg"),
])
def test_wrong_arguments_are_told_in_one_line(arguments, message, capsys):
    with pytest.raises(SystemExit) as left:
        main(arguments)
    told = capsys.readouterr().err
    assert left.value.code == 2 and message in told and told.count("\n") == 1


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as left:
        main([name, "--help"])
    assert left.value.code == 0 and f"usage: glrender {name}" in capsys.readouterr().out


def test_a_shape_needs_no_scene_file(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    generate.icosphere(radius_m=100.0, subdivisions=3).to_file(folder / "ball.obj")
    assert main(["render", "ball.obj", "--unit", "m", "--output", "dn", "--out", "a.fits", "--products", "tilt"]) == 0
    line = capsys.readouterr().out
    assert "1024 x 1024" in line and " DN, exposure " in line and "% saturated, predicted error" in line
    asked = "centroid_px=0.05,flux=0.001"
    assert main(["render", "ball.obj", "--unit", "m", "--out", "b.npz", "--max-error", asked]) == 0
    line = capsys.readouterr().out
    assert re.search(r", predicted flux \S+ of 0.001 allowed, predicted centroid_px \S+ of 0.05 allowed, ", line)
    assert "error" not in line
    dn = read_image(folder / "a.fits")
    assert dn.dtype == np.uint16 and abs((dn > dn.max() // 2).any(axis=1).sum() - 0.8 * 1024) < 40, "fills the frame"
    assert main(["render", "ball.obj", "--unit", "m", "--output", "dn", "--out", "a.png", "--raw", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (read_image(folder / "a.png") == dn).all()
    assert (said["min"], said["max"], said["saturated_share"]) == (dn.min(), dn.max(), 0.0) and not said["warnings"]


def test_init_writes_a_scene_that_renders(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    generate.icosphere(radius_m=100.0, subdivisions=2).to_file(folder / "my ball.obj")
    assert main(["init", "my ball.obj", "--unit", "m", "--out", "own.toml"]) == 0
    assert main(["check", "own.toml", "--out", "own.jpg"]) == 0
    told = capsys.readouterr()
    assert "body my ball: 320 facets, closed, 200 x 200 x 200 m" in told.out and not told.err
    assert "seen: my ball" in told.out and "819 px across" in told.out
    assert np.asarray(Image.open(folder / "own.jpg")).max() > 200
    # All that is commented out is right, too.
    lines = [line.removeprefix("# ") if " = " in line or "[stars]" in line else line
             for line in (folder / "own.toml").read_text().splitlines() if "albedo_texture" not in line]
    (folder / "all.toml").write_text("\n".join(lines))
    assert load_scene(folder / "all.toml").stars is not None


def test_check_tells_what_is_odd_in_a_shape(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    generate.icosphere(radius_m=2.0, subdivisions=3).to_file(folder / "ball.obj")
    text = (folder / "ball.obj").read_text().splitlines()
    (folder / "holed.obj").write_text("\n".join(text[:-3]))
    assert main(["check", "holed.obj", "--unit", "1000", "--phase-deg", "178"]) == 0
    told = capsys.readouterr()
    assert "open and 0 shared edges" in told.out and "open edges" in told.err and "phase 178 deg" in told.err


def test_a_plan_is_ten_lines_at_most(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    assert main(["plan", "scene.toml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("camera navcam: predicted RMS error") and 2 <= len(lines) <= 10
    assert main(["plan", "scene.toml", "--max-error", "centroid_px=0.05,flux=0.001"]) == 0
    told = capsys.readouterr().out
    assert "(0.05 px allowed)" in told and "(0.1 % allowed)" in told and len(told.splitlines()) <= 10
    assert main(["plan", "scene.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["camera"] == "navcam"


def test_a_scenario_is_rendered_at_a_time(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    text, flyby, made = (EXAMPLES / "scenarios" / "comet_flyby.toml").read_text(), "flyby.toml", []
    Path(flyby).write_text(text.replace("seed = 67", "seed = 67, subdivisions = 3").replace("1024", "128").replace(
        "3500.0", "437.5"))
    for at in ("3.0", "2014-08-08T12:00:00"):
        assert main(["render", flyby, "--at", at, "--out", "a.npy", "--max-error", "0.2"]) == 0
        made.append(np.load("a.npy"))
    assert made[0].max() > 0.0 and np.abs(made[0] - made[1]).max() <= 1e-6 * made[0].max(), "3 s from its start"
    assert main(["render", flyby, "--at", "7"]) == 1
    assert "--at: must be within the scenario's frames, 0 to 6 s from its start, got '7'" in capsys.readouterr().err
    assert main(["render", flyby, "--at", "noon"]) == 1
    assert "epoch_tdb: must be" in capsys.readouterr().err
    for at in ("nan", "1e300"):
        assert main(["render", flyby, "--at", at]) == 1
        assert "--at: must be" in capsys.readouterr().err


def test_pictures_are_stretched(folder):
    image = np.array([[0.0, 0.001, 0.01, 0.1, 1.0, 2.0]], np.float32)
    levels = {name: grey_levels(image, 1.0, name)[0].tolist() for name in STRETCHES}
    assert levels["linear"] == [0, 0, 3, 26, 255, 255]
    assert levels["gamma"] == [0, 11, 31, 90, 255, 255]
    assert levels["log"] == [0, 26, 89, 170, 255, 255]
    assert levels["asinh"] == [0, 5, 42, 144, 255, 255]


def test_bench_tells_medians(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    assert main(["bench", "scene.toml", "--camera", "bare", "--seconds", "0.1", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["max_error"] for row in rows] == [0.1, 0.05, 0.02, 0.01]
    assert all(row["frames"] >= 3 and 0.0 < row["median_ms"] <= row["p95_ms"] for row in rows)


def test_a_shell_completes_commands_and_options(folder):
    made = run("completion", "bash", cwd=folder)
    assert made.returncode == 0
    (folder / "complete").write_text(made.stdout)
    asked = (f"source {folder}/complete; COMP_WORDS=(glrender render --out); COMP_CWORD=2; "
             "_shtab_glrender_server_cli 2>/dev/null || _shtab_glrender; printf '%s\\n' \"${COMPREPLY[@]}\"")
    offered = subprocess.run(["bash", "-c", asked], capture_output=True, text=True, timeout=20).stdout.split()
    assert {"--out", "--output"} <= set(offered)


def test_a_mistake_is_the_exit_status_of_the_program(folder):
    made = run("render", "none.toml", cwd=folder)
    assert made.returncode == 1 and made.stderr.startswith("glrender: none.toml: is no file"), made.stderr


@pytest.mark.slow
@pytest.mark.parametrize("estimator, seed", [("model", 1), ("sphere", 3)])
def test_the_shortest_demo_keeps_the_body(folder, estimator, seed):
    made = run("demo", "--frames", "24", "--size-px", "128", "--estimator", estimator, "--seed", str(seed),
               cwd=folder, timeout=240)
    assert made.returncode == 0, made.stdout + made.stderr


def test_render_takes_capital_endings(folder, monkeypatch):
    monkeypatch.chdir(folder)
    for name in ("A.PNG", "A.NPY"):
        assert main(["render", "scene.toml", "--camera", "bare", "--out", name]) == 0
    assert np.asarray(Image.open(folder / "A.PNG")).shape == np.load(folder / "A.NPY").shape == (32, 32)


def test_doctor_finds_what_hinders(folder):
    made = run("doctor", cwd=folder)
    assert made.returncode == 0 and made.stdout.count("OpenGL by ") == 2
    devices = re.findall(r"EGL device \d+ +(.*)", made.stdout)
    assert re.search(r"OpenGL by egl +(.*), OpenGL", made.stdout)[1] in devices
    with pytest.raises(DeviceError, match="requested device"):
        Context("egl", len(devices))
    assert all(f"extra {name} " in made.stdout for name in ("fits", "parquet", "hdf5", "dask", "view", "belief"))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        taken.listen()
        (finding,) = doctor.look_at_ports({port: "a test"})
    assert finding.level == "note" and "glrender top" in finding.remedy
    assert doctor.look_at_folder("cache", Path("/proc/none"), "a way out").remedy == "a way out"


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
    facets = summary["facets"]
    assert 0.09 < facets["on_board"] / facets["true"] <= 0.1
    assert f"an on-board model of {facets['on_board']} of {facets['true']} facets" in made.stdout
    for name in ("contact_sheet.png", "trajectory.png"):
        assert Image.open(folder / "out" / name).size[0] > 500


def test_a_closed_pipe_changes_neither_exit_code_nor_log():
    """`glrender-server ... | head -1`."""
    code = ("import os\nfrom glrender_server import logs\nread, write = os.pipe()\nos.dup2(write, 1)\n"
            "os.close(read)\nlogs.say('ready')\nlogs.say('stopped')\n")
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stderr) == (0, "")
