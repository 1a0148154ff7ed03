"""Physical mistakes speak: each of ten has its word in the reply, in the log once, and before that in `glrender check`.

Each condition is a scene file and a state of its own, which a real server and the command line read.
"""

from __future__ import annotations

import json
import signal
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
import serving
import views
from glrender import draw_still, generate, load_scene, open_renderer, take_frame
from glrender.base.names import NOTES
from glrender.brdf import Lambert
from glrender.capture import frame_advice
from glrender.engines import advice
from glrender.scenario import RandomStates, load_scenario
from glrender_camera import CameraModel
from glrender_cli.__main__ import main
from glrender_cli.commands import demo
from glrender_cli.subject import default_state, read_state
from glrender_client import Client, ServerError

ROOT = Path(__file__).parents[2]
R_CAMERA = views.state().spacecraft.r_inertial_m
DN = {"output": "dn"}
AUTO, HOLED = 'exposure_s = "auto"', 'shape = "holed.obj"\nlength_unit = "m"'
LAW = 'brdf = { law = "lunar_lambert", normal_albedo = 0.2, weight = "mcewen" }'
LOBES = 'generated = { kind = "three_lobes", radius_m = 100.0, subdivisions = 4 }'

# Name, what the scene has instead, the state, the request, the code, and a piece of the sentence.
CONDITIONS = {
    "nothing in view": ({}, views.state(target=0.7 * R_CAMERA + [300.0, 0.0, 0.0]), {}, "out_of_view", "out of view"),
    "body behind the camera": ({}, views.state(target=2.0 * R_CAMERA), {}, "behind_camera", "behind the camera"),
    "only the night side": ({LAW: 'brdf = { law = "lambert", normal_albedo = 0.2 }'}, views.state(178.0), {},
                            "night_side", "only the night side of body is in view"),
    "saturated": ({}, views.state(30.0), {**DN, "exposure_s": 0.05}, "saturated", "lit pixels are saturated"),
    "exposure at its limit": ({"exposure_s = 0.01": AUTO + "\nauto_exposure = { min_s = 1e-9, max_s = 1e-7 }"},
                              views.state(30.0), DN, "exposure_limit", "exposure stays at its limit of 1e-07 s"),
    "exposure chosen": ({"exposure_s = 0.01": AUTO + "\nauto_exposure = { min_s = 1e-9 }"}, views.state(30.0), DN,
                        "exposure", "automatic exposure of "),
    "budget not met": ({"max_error = 0.1": "max_error = 1e-5"}, views.state(30.0), {}, "plan", "max_error"),
    "open edges": ({LOBES: HOLED}, views.state(30.0), {}, "shape", "3 open edges of holes"),
    "several shells": ({LOBES: HOLED.replace("holed", "twins")}, views.state(30.0), {}, "shape", "2 separate shells"),
    "unit of a shape": ({LOBES: HOLED.replace("holed", "rough").replace('"m"', "0.001")},
                        views.state(30.0, range_m=5.0), {}, "shape", "is the length unit right"),
    "size for its range": ({}, views.state(30.0, range_m=1e9), {}, "body_size", "check its length_unit"),
}
TEXTURE = {LOBES: LOBES + '\nalbedo_texture = "grey.png"'}


def scene_text(changes, name):
    """The scene of `serving` with pieces replaced, and one camera, named after the condition."""
    text = serving.SCENE[:serving.SCENE.index('[[cameras]]\nname = "bare"')]
    for old, new in changes.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text.replace('name = "navcam"', f'name = "{name}"')


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("spoken")
    write_shapes(folder)
    return folder


def write_shapes(folder):
    """A sphere without one facet, two spheres, a rough body that is read in millimetres, and a texture."""
    whole = generate.icosphere(radius_m=100.0, subdivisions=2)
    vertices, facets = whole.vertices_m, whole.facets
    twins = np.concatenate([0.4 * vertices - [60.0, 0.0, 0.0], 0.4 * vertices + [60.0, 0.0, 0.0]])
    rough = generate.gaussian_random_sphere(radius_m=1000.0, sigma=0.15, seed=4, subdivisions=3)
    for name, points, corners in (("holed", vertices, facets[:-1]), ("rough", rough.vertices_m, rough.facets),
                                  ("twins", twins, np.concatenate([facets, facets + len(vertices)]))):
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        lines += ["f {} {} {}".format(*corner) for corner in (corners + 1).tolist()]
        (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    from PIL import Image

    Image.fromarray(np.full((8, 16), 128, np.uint8)).save(folder / "grey.png")


@pytest.fixture(scope="module")
def told(folder):
    """By the condition's name: the reply's warnings and notes of three requests, and the log's lines after all."""
    found = {}
    with serving.server(folder, "--shape-dir", str(folder), "--workers", "1") as (endpoint, process):
        with Client(endpoint, timeout_s=60.0) as client:
            for name, (changes, state, request, _, _) in CONDITIONS.items():
                client.load_scene(tomllib.loads(scene_text(changes, name)))
                replies = [client.render(state, name, **request) for _ in range(3)]
                found[name] = [[*reply.warnings, *reply.notes] for reply in replies]
            with pytest.raises(ServerError) as refused:
                client.load_scene(tomllib.loads(scene_text(TEXTURE, "texture")))
            found["texture"] = refused.value
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
    return found, (folder / "server.log").read_text().splitlines()


@pytest.mark.parametrize("name", CONDITIONS)
def test_each_is_in_every_reply_and_in_the_log_once(told, name):
    found, log = told
    _, _, _, code, piece = CONDITIONS[name]
    for of_reply in found[name]:
        (said,) = [each for each in of_reply if each.code == code]
        assert piece in said.message and said.path
        assert {each.code for each in of_reply} <= {code, "exposure"}, "and nothing else is odd"
    lines = [line for line in log if found[name][0][0].message in line]
    lines = [line for line in lines if code == "shape" or f": {name}: " in line]
    assert len(lines) == 1 and (" INFO " if code in NOTES else " WARNING ") in lines[0], lines


@pytest.mark.parametrize("name", CONDITIONS)
def test_check_prints_each_before_a_loop_is_flown(folder, capsys, monkeypatch, name):
    changes, state, request, code, piece = CONDITIONS[name]
    monkeypatch.chdir(folder)
    (folder / "one.toml").write_text(scene_text(changes, name))
    (folder / "state.json").write_text(json.dumps(state.to_dict()))
    options = [text for key, value in request.items() for text in (f"--{key.replace('_', '-')}", str(value))]
    assert main(["check", "one.toml", "state.json", *options]) == 0
    kind = "note" if code in NOTES else "warning"
    said = capsys.readouterr().err.splitlines()
    lines = [line for line in said if piece in line]
    assert len(lines) == 1, said
    assert lines[0].startswith(f"glrender: {kind}: ")


def test_a_texture_without_coordinates_is_refused_with_a_way_out(told, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "one.toml").write_text(scene_text(TEXTURE, "texture"))
    assert main(["check", "one.toml"]) == 1
    said = capsys.readouterr().err
    for text in (said, str(told[0]["texture"])):
        assert "bodies[0].albedo_texture" in text and "needs a shape with texture coordinates" in text
        assert "leave it out" in text


def test_a_state_is_given_once(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "state.json").write_text(json.dumps(views.state().to_dict()))
    (folder / "one.toml").write_text(scene_text({}, "eye"))
    assert main(["check", "one.toml", "state.json", "--state", "state.json"]) == 1
    assert "--state: is given twice" in capsys.readouterr().err


# Where all is well


def states_of(path):
    """A scene and a few of the states that it is made for."""
    if path.name == "starry_flyby.toml":
        return load_scene(path), [read_state(path.with_suffix(".json"))]
    if path.name == "contact_binary.toml":
        scene = load_scene(path)
        return scene, [default_state(scene, scene.cameras[0].name, np.radians(deg)) for deg in (20.0, 60.0, 100.0)]
    scenario = load_scenario(path)
    if isinstance(scenario, RandomStates):
        return scenario.scene, scenario.states()[:3]
    return scenario.scene, scenario.states(scenario.t_s[::max(1, len(scenario.t_s) // 3)])


@pytest.mark.parametrize("name", ["contact_binary.toml", "starry_flyby.toml", "didymos_eclipses/didymos.toml",
                                  "scenarios/comet_flyby.toml"])
def test_the_examples_warn_of_nothing(name):
    scene, states = states_of(ROOT / "examples" / name)
    assert advice.scene_advice(scene) == ()
    camera = scene.cameras[0]
    with open_renderer(scene) as renderer:
        for state in states:
            capture = draw_still(renderer, state, camera.name)
            assert capture.warnings == () and capture.notes == ()
            if camera.model is not None:
                capture = take_frame(renderer, state, camera.name, seed=1)
                assert capture.warnings == () and len(capture.notes) == (camera.model.exposure_s == "auto")


def test_the_demos_scene_warns_of_nothing(tmp_path):
    arguments = type("Arguments", (), {"shape": None, "seed": 1, "size_px": 512, "max_error": "0.1"})
    scene = load_scene(demo._write_scene(tmp_path, arguments)[0])
    with open_renderer(scene) as renderer:
        for deg in (20.0, 60.0, 100.0):
            capture = take_frame(renderer, default_state(scene, "navcam", np.radians(deg)), "navcam")
            assert advice.scene_advice(scene) == () and capture.warnings == ()
            assert [note.code for note in capture.notes] == ["exposure"]


def test_their_cost(monkeypatch):
    """Of a frame of a megapixel in processor time, caches warm: the least of 200, at most 0.05 ms."""
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "optics": {"aperture_diameter_m": 0.001}})
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.2), 4)], [views.camera(1024, 4000.0, model=model)],
                        solar_irradiance_1au_W_m2=None)
    calls = {}
    for made in (advice.image_advice, frame_advice.frame_advice, frame_advice.frame_notes):
        name = made.__name__
        monkeypatch.setattr(f"glrender.capture.capture.{name}", lambda *given, _made=made, _name=name, **more: (
            calls.__setitem__(_name, lambda: _made(*given, **more)), _made(*given, **more))[1])
    with open_renderer(scene) as renderer:
        take_frame(renderer, views.state(30.0, range_m=900.0), "navcam")
    assert len(calls) == 3

    def cost_ms():
        began = time.thread_time()
        for call in calls.values():
            call()
        return 1e3 * (time.thread_time() - began)

    assert min(cost_ms() for _ in range(200)) < 0.05
