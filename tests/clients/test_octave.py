"""The MATLAB client, run by GNU Octave: golden messages, and pixels exactly those of the Python client."""

from __future__ import annotations

import json
import socket
import tomllib

import numpy as np
import pytest
import serving
import views
from glrender_client import Client
from octave_runner import REPOSITORY, SCENE, SIMULINK, octave

STUBS = REPOSITORY / "tests" / "clients" / "octave" / "stubs"
STATE = views.state().to_dict()
@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("octave"), "--tcp", "127.0.0.1:0", scene=SCENE) as (endpoint, process):
        yield endpoint, serving.tcp_address(process)


def test_the_codec_reads_and_writes_the_golden_messages():
    octave("codec_script.m", REPOSITORY / "tests" / "data" / "golden.json")


def test_the_class_gets_the_pixels_that_python_gets(live, tmp_path):
    endpoint, (host, port) = live
    (tmp_path / "state.json").write_text(json.dumps(STATE))
    with socket.create_server(("127.0.0.1", 0)) as mute:
        octave("client_script.m", host, port, mute.getsockname()[1], tmp_path, tmp_path / "state.json")
    products = ["range", "body_id", "facet_id", "incidence", "r_body", "sunlit"]
    with Client(endpoint) as client:
        frame = client.render(STATE, "navcam", products=products)
        arrays = {**frame.arrays,
                  "dn": client.render(STATE, "navcam", output="dn", exposure_s=0.02, seed=7).pixels,
                  "byte": client.render(STATE, "byte", output="dn", seed=3).pixels,
                  "region": client.render(STATE, "navcam", output="dn", exposure_s=0.02, seed=7).pixels[20:45, 30:71],
                  "frames_byte": client.render(STATE, "byte", output="dn", seed=3).pixels,
                  "frames_r_body": client.render(STATE, "navcam", products=["r_body"],
                                                 roi=[30, 20, 71, 45]).arrays["r_body"],
                  "frames_bare": client.render(STATE, "bare").pixels,
                  "ranges": client.range(STATE, [[0, 0, 1], [0.01, 0, np.sqrt(1 - 1e-4)], [1, 0, 0]],
                                         "navcam").arrays["range"]}
    assert arrays["dn"].dtype == np.uint16 and arrays["byte"].dtype == np.uint8
    for name, array in arrays.items():
        kept = np.fromfile(tmp_path / name, array.dtype).reshape(array.shape, order="F")
        np.testing.assert_array_equal(kept, array, err_msg=name)
        assert len(np.unique(kept[np.isfinite(kept)])) > 1, f"{name} must not be flat"


def test_a_frame_of_another_scene_does_not_come_in_the_place_of_the_loaded_ones(tmp_path):
    bright = tomllib.loads(SCENE)
    dark = {**bright, "bodies": [{**bright["bodies"][0], "brdf": {"law": "lambert", "normal_albedo": 0.02}}]}
    (tmp_path / "told.json").write_text(json.dumps({"scenes": [bright, dark], "state": STATE}))
    # Its own: the scene is replaced.
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0", scene=SCENE) as (_, process):
        octave("scene_script.m", *serving.tcp_address(process), tmp_path / "told.json")


def test_the_simulink_blocks_give_pythons_pixels_with_stand_ins_for_simulink(live, tmp_path):
    endpoint, (host, port) = live
    (tmp_path / "state.json").write_text(json.dumps(STATE))
    octave("blocks_script.m", host, port, tmp_path, tmp_path / "state.json", paths=[STUBS])
    with Client(endpoint) as client:
        for case, (camera, options) in enumerate([("navcam", {"output": "dn", "exposure_s": 0.02}),
                                                  ("byte", {"output": "dn"}), ("navcam", {})], start=1):
            for step in range(3):
                seed = {"seed": 7 * 2**32 + step} if options else {}
                expected = client.render({**STATE, "t_s": 0.5 * step}, camera, **options, **seed).pixels
                for kind in ("level2", "system"):
                    kept = np.fromfile(tmp_path / f"{kind}_{case}_{step}", expected.dtype)
                    np.testing.assert_array_equal(kept.reshape(expected.shape, order="F"), expected)


def test_the_library_and_the_model_are_built_as_documented():
    octave("library_script.m", SIMULINK, paths=[STUBS])
