"""Faults on their way from a scene file or a request into frames, and their truth on its way back."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import serving
import views
from glrender import ConfigError, load_scene, open_renderer, take_frame
from glrender.sequences.options import options_of
from glrender.sequences.sequence import captured, frame_file
from glrender_client import Client, ServerError

SCENE = serving.SCENE.replace("exposure_s = 0.01", 'exposure_s = 0.01\nfaults = [{ kind = "lost_lines", n_lines = 3, '
                                                   'place = "limb" }, { kind = "dust", probability = 0.5 }]')
STATE = views.state()
MOVING = replace(STATE, spacecraft=replace(STATE.spacecraft, angular_velocity_rad_s=[0.0, 0.2, 0.0]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("faults")


@pytest.fixture(scope="module")
def client(folder):
    with serving.server(folder, scene=SCENE) as (endpoint, _), Client(endpoint, timeout_s=60.0) as client:
        yield client


@pytest.fixture(scope="module")
def renderer(client, folder):
    with open_renderer(load_scene(folder / "scene.toml")) as renderer:
        yield renderer


def test_a_scenes_cameras_have_theirs(client, renderer):
    reply = client.render(STATE, "navcam", output="dn", seed=3)
    capture = take_frame(renderer, STATE, "navcam", seed=3)
    np.testing.assert_array_equal(reply.pixels, capture.frame.dn)
    assert tuple(reply.header["faults"]) == capture.frame.faults and reply.header["stages"] == capture.stages
    lines = reply.header["faults"][0]["lines"]
    assert len(lines) == 3 and not reply.pixels[lines].any() and reply.header["faults"][0]["place"] == "limb"
    some = [client.render(STATE, "navcam", output="dn", seed=seed).header["faults"] for seed in range(12)]
    assert {len(told) for told in some} == {1, 2}, "every other frame has dust"


def test_a_request_has_its_own_and_may_have_none(client, renderer):
    without = client.render(STATE, "navcam", output="dn", seed=3, faults=[])
    assert without.header["faults"] == [] and without.header["stages"]["faults"] == "skipped: none asked for"
    np.testing.assert_array_equal(without.pixels, take_frame(renderer, STATE, "navcam", seed=3, faults=[]).frame.dn)
    first, second = client.render_frames(STATE, [
        {"camera": "navcam", "output": "dn", "seed": 3, "faults": [{"kind": "dead_columns", "n_columns": 2}]},
        {"camera": "navcam", "output": "dn", "seed": 3, "faults": [{"kind": "lost_blocks", "size_px": 8}]}])
    assert first.header["faults"][0]["kind"] == "dead_columns" and len(second.header["faults"][0]["blocks"]) <= 4
    clean = np.ones(without.pixels.shape, bool)
    clean[:, first.header["faults"][0]["columns"]] = False
    np.testing.assert_array_equal(first.pixels[clean], without.pixels[clean])
    part = client.render(STATE, "navcam", output="dn", seed=3, roi=[10, 5, 60, 50],
                         faults=[{"kind": "lost_blocks", "size_px": 8}])
    np.testing.assert_array_equal(part.pixels, second.pixels[5:50, 10:60])


@pytest.mark.parametrize("exposure_s", ["auto", 0.002])
def test_a_stuck_shutter_blurs_as_long_as_it_is_open(renderer, exposure_s):
    """The exposure is known before poses are drawn."""
    stuck = take_frame(renderer, MOVING, "navcam", exposure_s=exposure_s, faults=[
        {"kind": "stuck_exposure", "exposure_s": 0.05}])
    truth = take_frame(renderer, MOVING, "navcam", exposure_s=0.05, faults=[])
    np.testing.assert_array_equal(stuck.frame.dn, truth.frame.dn)
    assert stuck.stages["motion_blur"] == truth.stages["motion_blur"] and "poses" in truth.stages["motion_blur"]


@pytest.mark.parametrize("frame, path, rule", [
    ({"output": "dn", "faults": [{"kind": "lost_line"}]}, "faults[0].kind", "did you mean 'lost_lines'?"),
    ({"output": "dn", "faults": [{"kind": "dust", "depth": 2.0}]}, "faults[0].depth", "between 0 and 1, got 2.0"),
    ({"faults": []}, "faults", "belongs to output 'dn'")])
def test_the_server_refuses_what_is_wrong_by_its_field(client, frame, path, rule):
    with pytest.raises(ServerError) as told:
        client.render(STATE, "navcam", **frame)
    assert told.value.path == path and rule in str(told.value)
    with pytest.raises(ServerError) as told:
        client.render_frames(STATE, [{"camera": "bare"}, {"camera": "navcam", **frame}])
    assert told.value.path == f"frames[1].{path}"


def test_a_scene_file_is_refused_by_the_field(tmp_path, renderer):
    (tmp_path / "scene.toml").write_text(SCENE.replace("n_lines = 3", "n_lines = -3"))
    with pytest.raises(ConfigError, match=r"cameras\[0\].model.faults\[0\].n_lines: must be an integer between"):
        load_scene(tmp_path / "scene.toml")
    with pytest.raises(ConfigError, match=r"^seed: must be an integer"):
        take_frame(renderer, STATE, "navcam", seed=-1)


def test_a_sequences_files_have_the_truth(renderer):
    options = options_of(renderer.scene, {"camera": "navcam", "output": "dn", "seed": 3})
    capture = captured(renderer, 0, STATE, options)
    header = frame_file(renderer.scene, 0, STATE, options, capture).header
    assert json.loads(json.dumps(header))["faults"] == list(capture.frame.faults)
