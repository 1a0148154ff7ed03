"""Warnings on their way from a frame to people: in replies over both transports, in `hello`, and in the log once."""

from __future__ import annotations

import json
import logging
import signal

import msgpack
import numpy as np
import pytest
import serving
import views
from glrender import generate
from glrender.engines.advice import Advice
from glrender_client import Client
from glrender_server import warned
from glrender_server.warned import AWAY_S, WarningLog

SEEN = views.state().to_dict()
AWAY = views.state(target=2.0 * views.state().spacecraft.r_inertial_m).to_dict()
BEHIND = "body is behind the camera (180 deg off the boresight)"
HOLED = serving.SCENE.replace('generated = { kind = "three_lobes", radius_m = 100.0, subdivisions = 4 }',
                              'shape = "holed.obj"\nlength_unit = "m"')


def holed_shape(folder):
    """An icosphere of 320 facets without its last: three open edges."""
    whole = generate.icosphere(radius_m=100.0, subdivisions=2)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in whole.vertices_m.tolist()]
    lines += ["f {} {} {}".format(*facet) for facet in (whole.facets[:-1] + 1).tolist()]
    (folder / "holed.obj").write_text("\n".join(lines) + "\n")


def log_lines(folder, process, *needles):
    """The server's log after its end, of which every needle is counted."""
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0
    lines = (folder / "server.log").read_text().splitlines()
    return [sum(needle in line for line in lines) for needle in needles]


@pytest.mark.parametrize("workers", ["1", "2"])
def test_replies_carry_them_over_both_transports_and_the_log_has_each_once(tmp_path, workers):
    holed_shape(tmp_path)
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0", "--workers", workers, scene=HOLED) as (endpoint, process):
        with Client(endpoint) as client:
            (told,) = [each for each in client.hello()["warnings"] if "open edges" in each["message"]]
            assert told["code"] == "shape" and told["path"] == "bodies[0].shape" and "body: 3 open" in told["message"]
            for number in range(12):
                reply = client.render({**AWAY, "t_s": float(number)}, "bare")
                warning, of_shape = reply.warnings
                assert of_shape.code == "shape" and "3 open edges" in of_shape.message
                assert (warning.code, warning.path) == ("behind_camera", "state.spacecraft.q_from_inertial")
                assert BEHIND in warning.message and not reply.pixels.any()
            assert [told.code for told in client.render(SEEN, "bare").warnings] == ["shape"]
            first, second = client.render_frames(AWAY, [{"camera": "bare"}, {"camera": "navcam", "output": "dn"}])
            assert [each.code for each in (*first.warnings, *second.warnings)] == 2 * ["behind_camera", "shape"]
            overexposed = client.render(SEEN, "navcam", output="dn", exposure_s=10.0)
            assert [told.code for told in overexposed.warnings] == ["saturated", "shape"]
        with serving.Framed(serving.tcp_address(process)) as framed:
            header = msgpack.unpackb(framed.ask(msgpack.packb({
                "v": 1, "op": "render", "id": 1, "client": "framed", "state": AWAY, "camera": "bare"}))[0])
        assert [told["code"] for told in header["warnings"]] == ["behind_camera", "shape"]
        # Two clients, and of the first two cameras.
        assert log_lines(tmp_path, process, "bare: " + BEHIND, "navcam: " + BEHIND, "pixels are saturated",
                         "3 open edges") == [2, 1, 1, 1]


def test_a_scene_from_the_wire_tells_of_its_shapes(tmp_path):
    (tmp_path / "shapes").mkdir()
    holed_shape(tmp_path / "shapes")
    scene = {"bodies": [{"name": "holed", "shape": "holed.obj", "length_unit": "m",
                         "brdf": {"law": "lambert", "normal_albedo": 0.2}}],
             "cameras": [{"name": "eye", "width_px": 32, "height_px": 32, "focal_length_px": 100.0}]}
    with serving.server(tmp_path, "--shape-dir", str(tmp_path / "shapes"), "--log-format", "json") as (
            endpoint, process):
        with Client(endpoint) as client:
            assert client.hello()["warnings"] == []
            for _ in range(2):
                assert any("3 open edges" in told["message"] for told in client.load_scene(scene)["warnings"])
            assert any("3 open edges" in told["message"] for told in client.status()["warnings"])
        assert log_lines(tmp_path, process, "3 open edges") == [1]
    line = next(json.loads(line) for line in (tmp_path / "server.log").read_text().splitlines() if "3 open" in line)
    assert (line["level"], line["code"], line["path"]) == ("WARNING", "shape", "bodies[0].shape")


TOLD = Advice("behind_camera", "state.spacecraft.q_from_inertial", "body is behind the camera")
OTHER = Advice("sun_distance", "state.r_sun_inertial_m", "the Sun is 0.01 au from body")


@pytest.fixture
def said(caplog):
    caplog.set_level(logging.WARNING, logger=warned.__name__)
    return lambda: [record.getMessage() for record in caplog.records]


def test_the_log_has_a_warning_once_while_it_lasts(said):
    log = WarningLog()
    for now_s in np.arange(0.0, 100.0, 0.01):
        log.frames("loop", [("navcam", (TOLD,))], now_s)
    assert said() == ["navcam: body is behind the camera"]
    # Slower than its memory: it lasts nevertheless.
    for now_s in np.arange(100.0, 1000.0, 3.0 * AWAY_S):
        log.frames("loop", [("navcam", (TOLD,))], now_s)
    assert len(said()) == 1


def test_a_condition_that_ended_is_told_anew_but_not_one_that_flickers(said):
    log = WarningLog()
    for now_s in np.arange(0.0, 10.0 * AWAY_S, 0.1):
        log.frames("loop", [("navcam", (TOLD,) if int(10 * now_s) % 2 else ())], now_s)
    assert len(said()) == 1
    for now_s in (100.0, 101.0, 100.0 + 2.0 * AWAY_S):
        log.frames("loop", [("navcam", ())], now_s)
    log.frames("loop", [("navcam", (TOLD, OTHER))], 130.0)
    assert said()[1:] == ["navcam: body is behind the camera", "navcam: the Sun is 0.01 au from body"]


def test_each_client_and_camera_has_its_own(said):
    log = WarningLog()
    for now_s in range(50):
        log.frames("one", [("navcam", (TOLD,)), ("wac", ())], now_s)
        log.frames("two", [("navcam", ())], now_s)
        log.frames("three", [("wac", (TOLD,)), ("wac", ())], now_s)
    assert said() == ["navcam: body is behind the camera", "wac: body is behind the camera"]


def test_it_forgets_clients_beyond_a_number(said):
    log = WarningLog()
    for number in range(1000):
        log.frames(f"client {number}", [("navcam", (TOLD,))], 0.0)
    assert len(log._known) == warned._MAX_CAMERAS and len(said()) == 1000
