"""Output "compressed" of a live server: the camera's stream, what a decoder needs, refusals, and those who watch."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import struct
import sys

import numpy as np
import pytest
import serving
import views
from glrender import load_scene, open_renderer, take_frame
from glrender_camera.compression import CODECS, decode
from glrender_client import Client, ServerError
from glrender_client.aio import AsyncClient
from glrender_view.frame import Frame, shown
from glrender_view.source import Source

CAMERA = """
[[cameras]]
name = "{}"
width_px = {}
height_px = 64
focal_length_px = 400.0
[cameras.model]
exposure_s = 3e-7
optics = {{ aperture_diameter_m = 0.01, psf_sigma_px = 0.5 }}
detector = {{ quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.1, bit_depth = {}, \
read_noise_electrons = 10.0, offset_DN = 20.0 }}
compression = {{ {} }}
"""
# A stream of the last is left in shared memory.
SCENE = serving.SCENE + "".join(
    [CAMERA.format(codec, 96, 12, f'codec = "{codec}"') for codec in CODECS]
    + [CAMERA.format("lossy", 96, 12, 'codec = "jpeg_ls", max_error_DN = 4')]
    + [CAMERA.format("wide", 4000, 16, 'codec = "ccsds_121"')])
STATE = views.state(phase_deg=50.0, range_m=1500.0).to_dict()


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    folder = tmp_path_factory.mktemp("server")
    with serving.server(folder, "--watch", scene=SCENE) as (endpoint, _):
        yield endpoint, folder


@pytest.fixture
def client(live):
    with Client(live[0], timeout_s=30.0) as client:
        yield client


def decoded(reply):
    return decode(reply.pixels, **{name: reply.header[name] for name in ("codec", "shape", "bit_depth")})


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("camera", [*CODECS, "lossy", "wide"])
def test_the_image_is_the_stream_and_its_fields_decode_it(client, camera, order):
    """To the very digital numbers of the same request for `dn`, for every codec, with products beside it."""
    dn = client.render(STATE, camera, output="dn", seed=7)
    sent = client.render(STATE, camera, output="compressed", seed=7, order=order, products=["range"])
    assert sent.pixels.ndim == 1 and sent.pixels.dtype == np.uint8 and sent.header["unit"] == "byte"
    np.testing.assert_array_equal(decoded(sent), dn.pixels)
    assert decoded(sent).dtype == dn.pixels.dtype and sent.arrays["range"].shape == dn.pixels.shape
    same = ("exposure_s", "seed", "n_saturated_px", "stages", "warnings")
    assert {name: sent.header[name] for name in same} == {name: dn.header[name] for name in same}
    rate = 8.0 * sent.pixels.size / dn.pixels.size
    assert f"{rate:.3g} bit/px" in sent.header["stages"]["compression"]


def test_it_is_the_stream_of_the_same_frame_in_process(client, live):
    with open_renderer(load_scene(live[1] / "scene.toml")) as renderer:
        frame = take_frame(renderer, client_state(), "lossy", seed=7).frame
    assert client.render(STATE, "lossy", output="compressed", seed=7).pixels.tobytes() == frame.stream
    assert client.render(STATE, "lossy", output="compressed", seed=8).pixels.tobytes() != frame.stream


def client_state():
    return views.state(phase_deg=50.0, range_m=1500.0)


def test_hello_tells_who_has_one(client):
    hello = client.hello()
    assert hello["outputs"] == ["irradiance", "dn", "compressed"]
    told = {camera["name"]: camera["compression"] for camera in hello["cameras"]}
    assert told["navcam"] is told["bare"] is None and told["lossy"] == {"codec": "jpeg_ls", "max_error_DN": 4}


def test_of_several_frames_each_has_its_own(client):
    frames = [{"camera": "lossy", "output": "compressed", "seed": 7}, {"camera": "lossy", "output": "dn", "seed": 7},
              {"camera": "ccsds_121", "output": "compressed", "exposure_s": "auto"}]
    sent, dn, other = client.render_frames(STATE, frames)
    np.testing.assert_array_equal(decoded(sent), dn.pixels)
    assert "codec" not in dn.header and other.header["codec"] == "ccsds_121" and "next_exposure_s" in other.header


def test_a_large_one_is_read_in_shared_memory_and_asynchronously(live):
    with Client(live[0], timeout_s=30.0, shared_memory=True) as client:
        reply = client.render(STATE, "wide", output="compressed", seed=7)
        assert "shared" in reply.header and reply.pixels.size > 1 << 16
        expected = client.render(STATE, "wide", output="dn", seed=7).pixels
        np.testing.assert_array_equal(decoded(reply), expected)

    async def ask():
        async with AsyncClient(live[0], timeout_s=30.0) as client:
            return await client.render(STATE, "wide", output="compressed", seed=7)

    np.testing.assert_array_equal(decoded(asyncio.run(ask())), expected)


@pytest.mark.parametrize("camera, options, path, message", [
    ("lossy", {"roi": [0, 0, 8, 8]}, "roi", "goes with no output 'compressed'.*got \\[0, 0, 8, 8\\].*output 'dn'"),
    ("navcam", {}, "output", "camera 'navcam' has no compression, got 'compressed'; give its model `compression"),
    ("bare", {}, "output", "camera 'bare' has no optics and detector, got 'compressed'"),
    ("lossy", {"exposure_s": 0.0}, "exposure_s", "must be > 0"), ("lossy", {"seed": -1}, "seed", "integer")])
def test_what_a_stream_cannot_be_of_is_refused(client, camera, options, path, message):
    with pytest.raises(ServerError, match=message) as caught:
        client.render(STATE, camera, output="compressed", **options)
    assert (caught.value.code, caught.value.path) == ("config", path)
    with pytest.raises(ServerError) as caught:
        client.render_frames(STATE, [{"camera": "bare"}, {"camera": camera, "output": "compressed", **options}])
    assert caught.value.path == f"frames[1].{path}"


def test_those_who_watch_see_what_is_decoded(client):
    """As the page's frame: height, width and numbers of `dn`, whatever the camera sends."""
    dn = client.render(STATE, "lossy", output="dn", seed=9).pixels
    sent = client.render(STATE, "lossy", output="compressed", seed=9)
    watched = client.watch(camera="lossy")
    np.testing.assert_array_equal(watched.reply.pixels, sent.pixels)
    hello = client.hello()
    camera = next(camera for camera in hello["cameras"] if camera["name"] == "lossy")
    header, pixels = shown(watched.reply.header, watched.reply.pixels)
    frame = Frame(number=1, stream=("a", "lossy", 0), header=header, request=watched.request, pixels=pixels,
                  camera=camera, bodies=hello["bodies"])
    (size,) = struct.unpack_from("<I", frame.message)
    head = json.loads(frame.message[4:4 + size])
    assert (head["output"], head["unit"], head["height"], head["width"]) == ("dn", "DN", 64, 96)
    np.testing.assert_array_equal(np.frombuffer(frame.message[4 + size:], head["dtype"]).reshape(64, 96), dn)


@contextlib.asynccontextmanager
async def followed(endpoint):
    """A page's source that wants the frames of all clients."""
    source = Source(endpoint)
    source.start(asyncio.get_running_loop())
    source.want(True, {None})
    try:
        yield source
    finally:
        source.close()


def test_a_page_without_the_codecs_says_so(live, client, monkeypatch):
    """And shows the frames that are no streams on, those of the same request and of the same camera too."""
    async def follow():
        async with followed(live[0]) as source:
            for seed in range(40):
                await asyncio.to_thread(client.render_frames, STATE, [
                    {"camera": "lossy", "output": "compressed", "seed": seed}, {"camera": "navcam", "output": "dn"}])
                await asyncio.sleep(0.1)
                await asyncio.to_thread(client.render, STATE, "jpeg_ls", output="compressed", seed=seed)
                await asyncio.sleep(0.1)
                if source.not_shown.startswith("camera 'jpeg_ls'") and source.frames:
                    break
            assert source.trouble == "" and source.status["cameras"]
            return source.not_shown, {frame.camera["name"] for frame in source.frames.values()}

    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    not_shown, cameras = asyncio.run(follow())
    assert re.match("camera 'jpeg_ls': codec: needs imagecodecs.*pip install", not_shown) and cameras == {"navcam"}


def test_the_pages_thread_takes_streams_as_they_come(live, client):
    """A client that asks for streams alone is followed: its frames are shown in digital numbers."""
    async def follow():
        async with followed(live[0]) as source:
            for seed in range(40):
                await asyncio.to_thread(client.render, STATE, "lossy", output="compressed", seed=seed)
                await asyncio.sleep(0.2)
                if (frame := source.newest(None)) is not None and frame.stream[1] == "lossy":
                    return frame

    frame = asyncio.run(follow())
    assert frame is not None and frame.pixels.shape == (64, 96) and frame.header["unit"] == "DN"
