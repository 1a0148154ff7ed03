"""Several cameras in one request, and regions of interest: the very bytes of whole frames asked for one by one."""

from __future__ import annotations

import asyncio

import msgpack
import numpy as np
import pytest
import serving
import views
from glrender.brdf import Lambert
from glrender_client import AsyncClient, Client, ServerError, replay
from glrender_server.frame import MAX_FRAME_BYTES
from glrender_server.operations import Operations
from serving import Framed

STATE = views.state().to_dict()
PRODUCTS = ["range", "body_id", "facet_id", "incidence", "emission", "phase", "r_body", "sunlit"]
FRAMES = [{"camera": "navcam", "output": "dn", "exposure_s": 0.02, "seed": 7, "products": ["range", "body_id"]},
          {"camera": "bare", "products": ["r_body"], "roi": [3, 8, 30, 20]},
          {"camera": "navcam", "output": "dn", "exposure_s": 0.02, "seed": 8, "roi": [40, 20, 60, 50]},
          {"camera": "navcam", "samples": 2}]


@pytest.fixture(scope="module", params=["1", "2"])
def live(tmp_path_factory, request):
    with serving.server(tmp_path_factory.mktemp("live"), "--tcp", "127.0.0.1:0", "--workers", request.param) \
            as (endpoint, process):
        yield endpoint, serving.tcp_address(process)


def message(**fields):
    return msgpack.packb({"v": 1, "op": "render", "id": 1, "client": "several", "state": STATE, **fields})


def one_by_one(client, order="C"):
    """The frames of FRAMES, each whole and from a request of its own, cut here."""
    for frame in FRAMES:
        x0, y0, x1, y1 = frame.get("roi", (0, 0, 1000, 1000))
        reply = client.render(STATE, **{key: value for key, value in frame.items() if key != "roi"}, order=order)
        yield reply.header, {name: array[y0:y1, x0:x1] for name, array in reply.arrays.items()}


@pytest.mark.parametrize("order", ["C", "F"])
def test_frames_of_one_request_are_those_of_one_by_one(live, order):
    with Client(live[0]) as client:
        replies = client.render_frames(STATE, FRAMES, order=order)
        assert len(replies) == len(FRAMES)
        for reply, frame, (header, arrays) in zip(replies, FRAMES, one_by_one(client, order), strict=True):
            assert reply.arrays.keys() == arrays.keys()
            for name, array in arrays.items():
                np.testing.assert_array_equal(reply.arrays[name], array)
                assert reply.arrays[name].dtype == array.dtype and array.size
            assert reply.header.get("roi") == frame.get("roi")
            for key in ("t_s", "camera", "output", "unit"):
                assert reply.header[key] == header[key]
            assert reply.header["plan"]["camera"] == frame["camera"] and reply.header["timings_ms"]["surface"] > 0.0
        assert len({reply.pixels.tobytes() for reply in replies}) == len(FRAMES)


@pytest.mark.parametrize("order", ["C", "F"])
def test_both_transports_carry_the_same_bytes(live, order):
    """By TCP, read as docs/protocol.md says and with none of the client's code."""
    endpoint, address = live
    with Client(endpoint) as client, Framed(address) as framed:
        header, *parts = framed.ask(message(frames=FRAMES, order=order))
        header = msgpack.unpackb(header)
        expected = [arrays for _, arrays in one_by_one(client, order)]
    assert [entry["part"] for entry in header["arrays"]] == list(range(1, len(parts) + 1))
    assert [(entry["frame"], entry["name"]) for entry in header["arrays"]] == \
        [(0, "image"), (0, "range"), (0, "body_id"), (1, "image"), (1, "r_body"), (2, "image"), (3, "image")]
    for entry, part in zip(header["arrays"], parts, strict=True):
        array = expected[entry["frame"]][entry["name"]]
        assert part == array.tobytes(order) and entry["shape"] == list(array.shape)
    of_stages = [sum(frame["timings_ms"].values()) for frame in header["frames"]]
    assert header["timings_ms"]["total"] >= 0.99 * sum(of_stages) > 0.0


@pytest.mark.parametrize("roi", [[0, 0, 96, 64], [0, 0, 1, 1], [95, 63, 96, 64], [30, 10, 70, 50], [0, 20, 96, 21]])
@pytest.mark.parametrize("exposure_s", [0.01, "auto"])
def test_a_region_of_digital_numbers_is_that_part_of_the_very_frame(live, roi, exposure_s):
    options = {"output": "dn", "seed": 3, "exposure_s": exposure_s, "products": PRODUCTS}
    x0, y0, x1, y1 = roi
    with Client(live[0]) as client:
        whole, region = (client.render(STATE, "navcam", **options, **more) for more in ({}, {"roi": roi}))
    assert region.arrays.keys() == whole.arrays.keys() and region.header["roi"] == roi
    assert region.header["exposure_s"] == whole.header["exposure_s"]
    for name, array in region.arrays.items():
        np.testing.assert_array_equal(array, whole.arrays[name][y0:y1, x0:x1])


@pytest.mark.parametrize("roi", [[0, 0, 96, 64], [0, 0, 1, 1], [95, 63, 96, 64], [30, 10, 70, 50]])
def test_a_region_of_irradiance_is_drawn_alone_within_the_budget(live, roi):
    """Products are those of the whole image but where a pixel's centre meets an edge; `sunlit` has its own map."""
    x0, y0, x1, y1 = roi
    with Client(live[0]) as client:
        whole, region = (client.render(STATE, "navcam", products=PRODUCTS, **more) for more in ({}, {"roi": roi}))
    assert region.arrays.keys() == whole.arrays.keys() and region.header["roi"] == roi
    assert region.header["stages"]["region"] == f"drawn alone: {roi} px"
    theirs = {name: array[y0:y1, x0:x1] for name, array in whole.arrays.items()}
    same = theirs["facet_id"] == region.arrays["facet_id"]
    assert same.mean() > 0.99
    for name in set(theirs) - {"image", "sunlit"}:
        np.testing.assert_allclose(region.arrays[name][same], theirs[name][same], rtol=1e-5, atol=1e-4)
    light = theirs["image"].astype(float)
    if light.any():
        rms = np.sqrt(np.mean((region.pixels - light)[light > 0] ** 2))
        assert rms < 0.1 * light[light > 0].mean(), "the scene's budget"


def test_saturated_pixels_are_counted_in_the_region(live):
    with Client(live[0]) as client:
        whole = client.render(STATE, "navcam", output="dn", exposure_s=10.0)
        count = [client.render(STATE, "navcam", output="dn", exposure_s=10.0, roi=roi).header["n_saturated_px"]
                 for roi in ([0, 0, 48, 64], [48, 0, 96, 64], [0, 0, 2, 2])]
    assert count[0] + count[1] == whole.header["n_saturated_px"] > 100 and min(count[:2]) > 0 and count[2] == 0


@pytest.mark.parametrize("fields, code, path, text", [
    ({"frames": []}, "protocol", "frames", "must be a list of maps that is not empty"),
    ({"frames": {"camera": "bare"}}, "protocol", "frames", "must be a list"),
    ({"frames": ["bare"]}, "config", "frames[0]", "must be a table"),
    ({"frames": [{"camera": "bare"}, {"camera": "wac"}]}, "scene", "frames[1].camera", "unknown camera, got 'wac'"),
    ({"frames": [{"camera": "bare", "order": "F"}]}, "config", "frames[0].order", "unknown key"),
    ({"frames": [{"camera": "bare"}], "camera": "bare"}, "protocol", "camera", "belongs into the entries of `frames`"),
    ({"frames": [{"camera": "bare"}], "roi": [0, 0, 1, 1]}, "protocol", "roi", "belongs into the entries"),
    ({"frames": [{"camera": "bare"}, {"camera": "bare", "seed": 1}]}, "protocol", "frames[1].seed", "belongs to"),
    ({"frames": [{"camera": "bare", "samples": 99}]}, "config", "frames[0].samples", "between 1 and 16"),
    ({"frames": [{"camera": "bare", "products": ["depth"]}]}, "config", "frames[0].products[0]", "must be one of"),
    ({"frames": 16 * [{"camera": "bare"}]}, "protocol", "frames", "at most 15 images and products together, got 16"),
    ({"frames": 4 * [{"camera": "bare", "products": ["range", "phase", "r_body"]}]}, "protocol", "frames", "got 16"),
    ({"camera": "bare", "roi": [0, 0, 33, 32]}, "config", "roi[2]", "must be an integer between 0 and 32, got 33"),
    ({"camera": "bare", "roi": [0, 0, 32, 33]}, "config", "roi[3]", "between 0 and 32"),
    ({"camera": "navcam", "roi": [0, 0, 96, 65]}, "config", "roi[3]", "between 0 and 64"),
    ({"camera": "bare", "roi": [-1, 0, 32, 32]}, "config", "roi[0]", "between 0 and 32"),
    ({"camera": "bare", "roi": [0.5, 0, 32, 32]}, "config", "roi[0]", "must be an integer"),
    ({"camera": "bare", "roi": [0, float("nan"), 32, 32]}, "config", "roi[1]", "must be an integer"),
    ({"camera": "bare", "roi": [8, 0, 8, 32]}, "config", "roi", "must have x0 < x1 and y0 < y1"),
    ({"camera": "bare", "roi": [0, 9, 8, 8]}, "config", "roi", "must have x0 < x1 and y0 < y1"),
    ({"camera": "bare", "roi": [0, 0, 8]}, "config", "roi", "must be four integers"),
    ({"camera": "bare", "roi": "all"}, "config", "roi", "must be four integers"),
    ({"camera": "bare", "roi": None}, "config", "roi", "must be four integers"),
    ({"frames": [{"camera": "bare"}, {"camera": "bare", "roi": [0, 0, 0, 1]}]}, "config", "frames[1].roi", "x0 < x1"),
])
def test_what_is_wrong_is_named_with_its_frame(live, fields, code, path, text):
    with Framed(live[1]) as framed:
        header = msgpack.unpackb(framed.ask(message(**fields))[0])
        assert not header["ok"] and (header["error"]["code"], header["error"]["path"]) == (code, path)
        assert text in header["error"]["message"]
        assert msgpack.unpackb(framed.ask(message(camera="bare", roi=[0.0, 0.0, 8.0, 4.0]))[0])["arrays"][0]["shape"] \
            == [4, 8], "MATLAB's numbers are float64"


def test_a_state_that_is_wrong_is_the_states_fault_not_a_frames(live):
    inside = {**STATE, "spacecraft": {"r_inertial_m": [0, 0, 0], "q_from_inertial": [1, 0, 0, 0]}}
    with Client(live[0]) as client, pytest.raises(ServerError) as caught:
        client.render_frames(inside, [{"camera": "bare"}, {"camera": "navcam"}])
    assert caught.value.path == "state.spacecraft.r_inertial_m"


def test_fifteen_arrays_are_the_most_and_come_whole(live):
    """A message on TCP has 16 parts."""
    frames = [{"camera": "bare", "products": ["range", "phase"], "samples": 1 + k} for k in range(5)]
    with Client(live[0]) as client, Framed(live[1]) as framed:
        assert client.hello()["limits"]["max_arrays"] == 15
        assert len(framed.ask(message(frames=frames))) == 16
        assert sum(len(reply.arrays) for reply in client.render_frames(STATE, frames)) == 15


def test_the_memory_of_all_frames_together_is_bounded():
    served = Operations(views.scene([views.sphere(Lambert(normal_albedo=0.2), 1)], [views.camera(size_px=4500)]))
    try:
        header = msgpack.unpackb(message(frames=2 * [{"products": PRODUCTS[:6]}]))
        error = msgpack.unpackb(served.answer(header)[0][0])["error"]
    finally:
        served.close()
    assert (error["code"], error["path"]) == ("config", "frames")
    assert f"at most {MAX_FRAME_BYTES} bytes of memory while they are made, got {2 * 112 * 4500**2}" in error["message"]


def test_asyncio_recording_and_replay_know_several_frames(live, tmp_path):
    async def fly():
        async with AsyncClient(live[0]) as client:
            return await client.render_frames(STATE, FRAMES)

    with Client(live[0], record=tmp_path / "flight.glr") as client:
        replies = client.render_frames(STATE, FRAMES)
    for one, other in zip(replies, asyncio.run(fly()), strict=True):
        for name, array in one.arrays.items():
            np.testing.assert_array_equal(other.arrays[name], array)
    assert list(replay(tmp_path / "flight.glr", live[0])) == [None, None]
    assert repr(replies[1]).startswith("<Reply bare t=0.0 s: 27 x 12 float32 [W/m2]")
