"""Replies say which scene they show, and requests which one they mean."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tomllib

import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from glrender import Scene, load_scene
from glrender_client import AsyncClient, Client, ServerError
from glrender_server.operations import Operations
from glrender_server.scene_digest import scene_digest

STATE = views.state().to_dict()
OBJ = "v 0 0 80\nv 60 0 -40\nv -40 50 -40\nv -40 -50 -40\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"
TABLE = tomllib.loads(serving.SCENE)


def shaped(**changes):
    return {**TABLE, "bodies": [{"name": "body", "shape": "t.obj", "length_unit": "m",
                                 "brdf": {"law": "lambert", "normal_albedo": 0.2}, **changes}]}


def test_equal_scenes_have_equal_digests_in_every_process(tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    own = scene_digest(load_scene(tmp_path / "scene.toml"))
    assert len(own) == 32 and own == scene_digest(Scene.from_dict(TABLE, restricted=True))
    code = ("import sys\nfrom glrender import load_scene\nfrom glrender_server.scene_digest import scene_digest\n"
            "print(scene_digest(load_scene(sys.argv[1])))")
    other = subprocess.run([sys.executable, "-c", code, str(tmp_path / "scene.toml")], capture_output=True, text=True,
                           check=True, timeout=120)
    assert other.stdout.strip() == own


@pytest.mark.parametrize("change", [
    {"max_error": 0.05}, {"sun_disc": False}, {"cameras": TABLE["cameras"][:1]}, {"solar_irradiance_1au_W_m2": 1000.0},
    {"bodies": [{**TABLE["bodies"][0], "brdf": {"law": "lambert", "normal_albedo": 0.2}}]},
    {"bodies": [{**TABLE["bodies"][0], "name": "other"}]},
    {"cameras": [{**camera, "focal_length_px": camera["focal_length_px"] + 1e-9} for camera in TABLE["cameras"]]},
], ids=str)
def test_another_scene_has_another_digest(change):
    assert scene_digest(Scene.from_dict({**TABLE, **change})) != scene_digest(Scene.from_dict(TABLE))


def test_the_content_of_files_counts(tmp_path):
    (tmp_path / "t.obj").write_text(OBJ)
    first = scene_digest(Scene.from_dict(shaped(), shape_dir=tmp_path))
    (tmp_path / "t.obj").write_text(OBJ.replace("80", "80.000001"))
    assert scene_digest(Scene.from_dict(shaped(), shape_dir=tmp_path)) != first


@pytest.fixture(scope="module")
def made():
    """Scenes that the operations read, as they were handed on."""
    return []


@pytest.fixture(scope="module")
def operations(made):
    served = Operations(Scene.from_dict(TABLE),
                        on_scene=lambda scene, digest: made.append((pickle.dumps(scene), digest)))
    yield served
    served.close()


@pytest.mark.parametrize("op, more", [
    ("render", {"camera": "bare"}), ("range", {"camera": "bare", "directions_camera": [[0.0, 0.0, 1.0]]}),
    ("render", {"frames": [{"camera": "bare"}]})], ids=str)
def test_each_reply_has_its_scenes_digest_and_another_is_refused(operations, op, more):
    header = {"v": 1, "op": op, "id": 1, "client": "c", "state": STATE, **more}

    def told(**fields):
        return msgpack.unpackb(operations.answer({**header, **fields})[0][0])

    digest = told()["scene"]
    assert digest == operations.digest == operations.described["scene"] and told(scene=digest)["ok"]
    refused = told(scene="0" * 32)["error"]
    assert (refused["code"], refused["path"]) == ("scene", "scene") and digest in refused["message"]
    for wrong in (7, None, {"bodies": []}, ["x"]):
        assert told(scene=wrong)["error"]["code"] == "protocol"


def test_a_scene_that_is_replaced_is_told_of_as_it_was_made(operations, made):
    before = operations.digest
    reply = msgpack.unpackb(operations.answer({"v": 1, "op": "load_scene", "id": 1, "client": "c",
                                               "scene": {**TABLE, "max_error": 0.05}})[0][0])
    assert reply["ok"] and reply["scene"] == made[0][1] == operations.digest != before
    with_pickle = Operations(pickle.loads(made[0][0]), digest=made[0][1])
    image = msgpack.unpackb(with_pickle.answer({"v": 1, "op": "render", "id": 1, "client": "c", "state": STATE,
                                                "camera": "bare"})[0][0])
    assert image["scene"] == made[0][1]
    with_pickle.close()
    operations.answer({"v": 1, "op": "load_scene", "id": 1, "client": "c", "scene": TABLE})
    assert operations.digest == before


def test_a_client_gets_no_frame_of_another_scene_than_it_has_loaded(tmp_path):
    """Also where the files of its scene have gone, and a worker that starts anew has to open it."""
    shapes = tmp_path / "shapes"
    shapes.mkdir()
    (shapes / "t.obj").write_text(OBJ)
    with serving.server(tmp_path, "--shape-dir", str(shapes), "--workers", "2") as (endpoint, process), \
            Client(endpoint, timeout_s=60.0) as client, Client(endpoint, timeout_s=60.0) as other:
        own = client.render(STATE, "bare")
        loaded = client.load_scene(shaped())
        mine = client.render(STATE, "bare")
        assert mine.header["scene"] == loaded["scene"] == client.hello()["scene"] != own.header["scene"]
        assert not np.array_equal(mine.pixels, own.pixels)
        (shapes / "t.obj").unlink()
        serving.until(lambda: client.status()["workers"]["ready"] == 2)
        for number in serving.children(process):
            os.kill(number, signal.SIGKILL)
        for k in range(6):
            again = client.render({**STATE, "t_s": float(k)}, "bare")
            np.testing.assert_array_equal(again.pixels, mine.pixels)
            assert again.header["scene"] == loaded["scene"]
        other.load_scene(TABLE)
        assert other.render(STATE, "bare").header["scene"] == own.header["scene"], "the server's own by content"
        for refused in (lambda: client.render(STATE, "bare"), lambda: next(client.render_many([{"state": STATE}])),
                        lambda: client.range(STATE, [[0.0, 0.0, 1.0]], "bare"),
                        lambda: client.render_frames(STATE, [{"camera": "bare"}])):
            with pytest.raises(ServerError, match="another scene is served") as caught:
                refused()
            assert caught.value.code == "scene"
        with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
            socket.connect(endpoint)
            socket.send(msgpack.packb({"v": 1, "op": "render", "id": 1, "client": "c", "state": STATE,
                                       "camera": "bare"}))
            assert msgpack.unpackb(socket.recv_multipart()[0])["scene"] == own.header["scene"]
        client.load_scene(TABLE)
        assert client.render(STATE, "bare").header["ok"]


def test_the_asynchronous_client_sends_what_it_has_loaded_too():
    client = AsyncClient()
    client._pack.scene = "d" * 32
    assert msgpack.unpackb(client._pack("render", {})[1])["scene"] == "d" * 32
    assert "scene" not in msgpack.unpackb(client._pack("status", {})[1])
