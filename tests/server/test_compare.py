"""`compare`: a frame goes to the server, normal equations come back, and no image."""

from __future__ import annotations

import asyncio
import tomllib

import msgpack
import numpy as np
import pytest
import serving
import views
from glrender import Scene, compare_frame, open_renderer, take_frame
from glrender_client import AsyncClient, Client, ServerError
from glrender_client.wire import Packer, frames_fields, read_header, read_reply, render_fields
from glrender_server.operations import Operations

STATE = views.state(range_m=700.0)
SCENE = serving.SCENE.replace("read_noise_electrons", "offset_DN = 30.0, read_noise_electrons")
TABLE = tomllib.loads(SCENE)
ASK = {"camera": "navcam", "exposure_s": 2e-7}


@pytest.fixture(scope="module")
def served():
    operations = Operations(Scene.from_dict(TABLE))
    yield operations
    operations.close()


@pytest.fixture(scope="module")
def frame():
    with open_renderer(Scene.from_dict(TABLE)) as renderer:
        return take_frame(renderer, views.state(range_m=705.0), "navcam", seed=3, exposure_s=2e-7).frame.dn


def answer(served, fields, **changed):
    """A reply to fields of the client's, some of which are changed."""
    message = msgpack.unpackb(Packer()("render", {**fields, **changed})[1])
    return served.answer_message(msgpack.packb({**message, "id": 1, "client": "same"})).reply


def read(parts):
    return read_reply(read_header(parts[0]), parts)


def test_some_hundred_bytes_come_back_as_the_renderers_own_answer_has_them(served, frame):
    fields = render_fields(STATE.to_dict(), **ASK, compare=frame, derivatives=["spacecraft", "law.normal_albedo"],
                           unknown=["offset"])
    parts = answer(served, fields)
    with open_renderer(Scene.from_dict(TABLE)) as renderer:
        own = compare_frame(renderer, STATE, "navcam", frame_DN=frame, exposure_s=2e-7, unknown=["offset"],
                            derivatives=["spacecraft", "law.normal_albedo"])
    assert len(parts) == 1 and len(parts[0]) < 2200
    reply = read(parts)
    found = reply.comparison
    assert found.names == own.names == (*(f"spacecraft[{k}]" for k in range(6)), "law.normal_albedo", "offset")
    assert found.units == ("m", "m", "m", "rad", "rad", "rad", "1", "DN")
    assert np.array_equal(found.matrix, own.matrix) and np.array_equal(found.vector, own.vector)
    assert (found.chi2, found.n_pixels, found.gain, found.offset_DN) == (own.chi2, 96 * 64, 1.0, own.offset_DN)
    assert reply.arrays == {} and reply.header["exposure_s"] == 2e-7 and "rms" in reply.header["predicted"]
    assert set(reply.header["jacobian_error"]) == {"spacecraft", "law.normal_albedo"}


def test_a_comparison_says_whether_its_frame_was_late(served, frame):
    fields = render_fields(STATE.to_dict(), **ASK, compare=frame)
    late, timely = (read(answer(served, fields, deadline_s=deadline_s)).header for deadline_s in (1e-6, 1e6))
    assert late["is_late"] is True and timely["is_late"] is False


def test_equal_requests_have_equal_bytes_but_for_the_time(served, frame):
    fields = render_fields(STATE.to_dict(), **ASK, compare=frame)
    told = [read_header(answer(served, fields)[0]) for _ in range(2)]
    for each in told:
        del each["timings_ms"]
    assert told[0] == told[1]


def test_several_cameras_frames_and_images_go_in_one_request(served, frame):
    fields = frames_fields(STATE.to_dict(), [
        {**ASK, "compare": frame[4:60, 3:90], "roi": (3, 4, 90, 60), "blur_px": 2.0, "robust": True},
        {"camera": "bare"}])
    reply = read(answer(served, fields))
    assert reply.frames[0].comparison.n_pixels == 56 * 87 and reply.frames[1].pixels.shape == (32, 32)


@pytest.mark.parametrize("dtype", ["uint8", "float32", ">f8"])
def test_other_kinds_of_numbers_are_the_same_frame(served, frame, dtype):
    small = (frame // 16).astype(dtype)
    expected = read(answer(served, render_fields(STATE.to_dict(), **ASK, compare=small.astype(np.uint16))))
    found = read(answer(served, render_fields(STATE.to_dict(), **ASK, compare=small)))
    assert np.array_equal(found.comparison.vector, expected.comparison.vector)


ZEROS = {"pixels": bytes(96 * 64), "dtype": "uint8", "shape": [64, 96]}


@pytest.mark.parametrize(("changed", "path", "text"), [
    ({"compare": {**ZEROS, "shape": [96, 64]}}, "compare", "roi"),
    ({"compare": {**ZEROS, "shape": [64, 97]}}, "compare.pixels", "6208 bytes.*6144"),
    ({"compare": {**ZEROS, "shape": [6144]}}, "compare.shape", "height, width"),
    ({"compare": {**ZEROS, "shape": [-1, 96]}}, "compare.shape[0]", "1"),
    ({"compare": {**ZEROS, "dtype": "int16"}}, "compare.dtype", "uint16"),
    ({"compare": {**ZEROS, "dtype": ["uint8"]}}, "compare.dtype", "uint8"),
    ({"compare": {**ZEROS, "pixels": [0] * 6144}}, "compare.pixels", "bytes"),
    ({"compare": {**ZEROS, "pixels": np.full((64, 96), np.nan, "<f4").tobytes(), "dtype": "float32"}}, "compare",
     "finite.*6144 pixels"),
    ({"compare": {**ZEROS, "blur_px": 1e9}}, "compare.blur_px", "64"),
    ({"compare": {**ZEROS, "robust": 1}}, "compare.robust", "true or false"),
    ({"compare": {**ZEROS, "blur": 1.0}}, "compare.blur", "blur_px"),
    ({"compare": "frame"}, "compare", "table"),
    ({"compare": {"pixels": b""}}, "compare.dtype", ""),
    ({"compare": ZEROS, "output": "irradiance"}, "output", "dn"),
    ({"compare": ZEROS, "products": ["range"]}, "products", "compare"),
    ({"compare": ZEROS, "seed": 3}, "seed", "compare"),
    ({"compare": ZEROS, "unknown": "gain"}, "unknown", "list"),
    ({"compare": ZEROS, "derivatives": ["spacecarft"]}, "derivatives[0]", "spacecraft"),
    ({"compare": ZEROS, "camera": "bare"}, "output", "optics and detector"),
    ({"compare": ZEROS, "backend": "raytrace"}, "derivatives", "no option"),
    ({"derivatives": ["spacecraft"]}, "derivatives", "compare"),
    ({"unknown": ["gain"]}, "unknown", "compare")])
def test_what_cannot_be_compared_is_refused_by_its_field(served, changed, path, text):
    fields = {"state": STATE.to_dict(), "camera": "navcam", **changed}
    with pytest.raises(ServerError, match=f"(?s){text}") as caught:
        read(answer(served, fields))
    assert caught.value.path == path and caught.value.code in ("config", "protocol")


def test_a_client_refuses_what_no_header_holds():
    with pytest.raises(ValueError, match="1000000 bytes, got 2097152: give a region"):
        render_fields(STATE.to_dict(), compare=np.zeros((1024, 1024), np.uint16))


@pytest.mark.parametrize(("fields", "message"), [
    ({"blur_px": 2.0}, "blur_px belongs to compare, got 2.0: give the frame"),
    ({"robust": True}, "robust belongs to compare, got True: give the frame"),
    ({"blur_px": -1.0, "output": "dn"}, "blur_px belongs to compare, got -1.0")])
def test_a_client_refuses_settings_of_a_comparison_without_a_frame(fields, message):
    for ask in (lambda: render_fields(STATE.to_dict(), **fields), lambda: frames_fields(STATE.to_dict(), [fields])):
        with pytest.raises(ValueError, match=message):
            ask()


def test_a_clients_settings_of_a_comparison_reach_the_server(served, frame):
    """Those that are wrong are refused there, and none is dropped."""
    assert "output" not in render_fields(STATE.to_dict(), **ASK, compare=frame, output="dn")
    for fields, path in (({"output": "compressed"}, "output"), ({"robust": "no"}, "compare.robust"),
                         ({"blur_px": -1.0}, "compare.blur_px"), ({"products": ["range"]}, "products")):
        with pytest.raises(ServerError) as caught:
            read(answer(served, render_fields(STATE.to_dict(), **ASK, compare=frame, **fields)))
        assert caught.value.path == path


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_masked_pixels_do_not_count(served, frame, dtype):
    masked = np.ma.masked_array((frame // 16).astype(dtype), mask=np.zeros(frame.shape, bool))
    masked[10:20, 30:50] = np.ma.masked
    found = read(answer(served, render_fields(STATE.to_dict(), **ASK, compare=masked))).comparison
    with open_renderer(Scene.from_dict(TABLE)) as renderer:
        own = compare_frame(renderer, STATE, "navcam", frame_DN=masked, exposure_s=2e-7)
    assert found.n_pixels == own.n_pixels == 96 * 64 - 200
    assert np.array_equal(found.matrix, own.matrix) and found.chi2 == own.chi2


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_filter_updates_by_a_real_servers_replies(tmp_path, frame, workers):
    """5 m of range, by both clients, over shared memory too; and nobody watches a frame that there is none of."""
    endpoint = f"ipc://{tmp_path}/socket"
    with serving.server(tmp_path, "--zmq", endpoint, "--workers", str(workers), "--watch", scene=SCENE), \
            Client(endpoint, timeout_s=60.0) as client:
        state, along = STATE.to_dict(), np.array(STATE.spacecraft.r_inertial_m) / 700.0
        for _ in range(3):
            found = client.render(state, **ASK, compare=frame).comparison
            keep = [0, 1, 2, 6, 7]
            step = np.linalg.solve(found.matrix[np.ix_(keep, keep)], found.vector[keep])
            place_m = np.array(state["spacecraft"]["r_inertial_m"]) - step[2] * along
            state = {**state, "spacecraft": {**state["spacecraft"], "r_inertial_m": place_m}}
        assert abs(np.linalg.norm(place_m) - 705.0) < 0.5
        assert client.watch().reply is None

        async def asked():
            async with AsyncClient(endpoint, timeout_s=60.0) as other:
                return (await other.render(state, **ASK, compare=frame)).comparison
        again = client.render(state, **ASK, compare=frame).comparison
        assert np.array_equal(asyncio.run(asked()).matrix, again.matrix)
