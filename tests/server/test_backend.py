"""The backend that a request names draws its frames; the server's own backend draws all others."""

from __future__ import annotations

import asyncio
import threading
import time

import msgpack
import numpy as np
import pytest
import serving
import views
from glrender import DeviceError, State, draw_still, load_scene, open_renderer
from glrender.emission import Coma
from glrender.emission.sources.haser import Haser
from glrender.engines.rays.backend import RayTracer
from glrender_camera import BrownConrady
from glrender_client import AsyncClient, Client, ServerError
from glrender_server import operations
from glrender_server.operations import Operations

STATE = views.state().to_dict()
REQUEST = {"v": 1, "op": "render", "id": 1, "client": "test", "state": STATE, "camera": "navcam", "max_error": 0.02}
SHARES = []  # what the operations reported


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    file = tmp_path_factory.mktemp("scene") / "scene.toml"
    file.write_text(serving.SCENE)
    made = Operations(load_scene(file), on_progress=SHARES.append)
    yield made
    made.close()


def answer(served, **fields):
    """The reply's header, and its image's bytes."""
    (header, *parts), *_ = served.answer({**REQUEST, **fields})
    return msgpack.unpackb(header), b"".join(map(bytes, parts))


def test_the_backend_that_is_named_draws_and_no_other_frame_changes(served):
    own, traced, again = answer(served), answer(served, backend="raytrace"), answer(served)
    assert own[1] == again[1] != traced[1]
    assert own[0]["plan"]["windows"] and not traced[0]["plan"]["windows"]
    with open_renderer(served.scene, "raytrace") as tracer:
        expected = draw_still(tracer, State.from_dict(STATE), "navcam", max_error=0.02)
    assert traced[1] == expected.irradiance_W_m2.tobytes()


def test_a_named_backend_draws_all_frames_of_a_request_and_reports_how_far_it_is(served):
    SHARES.clear()
    frame = {"camera": "navcam", "max_error": 0.02}
    request = {name: value for name, value in REQUEST.items() if name not in frame}
    header, pixels = answer(served, backend="raytrace")
    (together, *parts), code, *_ = served.answer({**request, "backend": "raytrace", "frames": [frame, frame]})
    assert not code and [bytes(part) for part in parts] == [pixels, pixels]
    shares = SHARES[SHARES.index(1.0) + 1:]
    assert shares == sorted(shares) and {0.5, 1.0} <= set(shares)


def test_a_named_backend_draws_the_detector_s_frame_and_writes_to_shared_memory(served):
    """As many bytes in the memory that is lent; the frame of digital numbers has the light of the server's own."""
    room = []

    def lent(sizes):
        room[:] = [memoryview(bytearray(size)) for size in sizes]
        return room

    _, pixels = answer(served, backend="raytrace")
    _, code, *_ = served.answer({**REQUEST, "backend": "raytrace", "shared": True}, lent)
    assert not code and bytes(room[0]) == pixels
    own, traced = (np.frombuffer(answer(served, output="dn", seed=1, **asked)[1], "<u2").astype(float)
                   for asked in ({}, {"backend": "raytrace"}))
    assert own.sum() > 0.0
    np.testing.assert_allclose(traced.sum(), own.sum(), rtol=0.01)


def test_another_scene_is_drawn_by_the_backend_too(served):
    """It is opened anew: the scene before has no part in it."""
    _, before = answer(served, backend="raytrace")
    scene, digest = served.scene, served.digest
    body = scene.bodies[0]
    served.replace(views.scene([body], [views.camera(32, 100.0, name="navcam")]), "other")
    try:
        header, after = answer(served, backend="raytrace")
    finally:
        served.replace(scene, digest)
    assert header["arrays"][0]["shape"] == [32, 32] and answer(served, backend="raytrace")[1] == before


def test_the_servers_own_backend_by_its_name_is_made_anew_when_it_fails(served, monkeypatch):
    """One renderer has the name, and no second one is opened."""
    own = Operations(served.scene, "raytrace")
    draw, failed = operations.draw_still, []

    def fails_once(*arguments, **options):
        if not failed:
            failed.append(True)
            raise DeviceError("lost")
        return draw(*arguments, **options)

    monkeypatch.setattr(operations, "draw_still", fails_once)
    try:
        _, code, *_ = own.answer({**REQUEST, "backend": "raytrace"})
        assert not code and failed and not own._others
    finally:
        own.close()


def test_a_miss_is_warned_of_with_the_figures_of_the_frame_behind_the_point_spread_function(served):
    """One ray a pixel is too few before it and behind it: the warning has the plan's own figures."""
    header, _ = answer(served, backend="raytrace", output="dn", exposure_s=0.02, seed=1, samples=1, max_error=0.002)
    plan = header["plan"]
    expected = f"predicted error {plan['predicted_error']:.2g} exceeds max_error 0.002; leave samples out"
    assert plan["missed"] == ["rms"] and plan["asked"] == {"rms": 0.002} and plan["warnings"] == [expected]
    assert [each["message"] for each in header["warnings"] if each["code"] == "plan"] == [expected]


@pytest.mark.parametrize("n_lost", [1, 2])
def test_a_backend_that_loses_its_device_is_made_anew_once(served, monkeypatch, n_lost):
    """The same bytes then; a second loss is the device's fault. In either case it draws the next request."""
    (_, pixels), (_, own), losses = answer(served, backend="raytrace"), answer(served), iter([True] * n_lost)
    render, drawn_by = RayTracer.render, []

    def failing(self, *arguments, **options):
        drawn_by.append(self)
        if next(losses, False):
            raise DeviceError("the device is lost")
        return render(self, *arguments, **options)

    monkeypatch.setattr(RayTracer, "render", failing)
    header, again = answer(served, backend="raytrace")
    assert len(drawn_by) == 2 and drawn_by[0] is not drawn_by[1]
    if n_lost == 1:
        assert again == pixels
    else:
        assert header["error"]["code"] == "device" and "the device is lost" in header["error"]["message"]
    assert answer(served, backend="raytrace")[1] == pixels and answer(served)[1] == own


@pytest.mark.parametrize("lens", [None, BrownConrady(k1=-0.05)])
def test_a_named_backend_draws_a_region_and_a_lens(served, lens):
    """The light of OpenGL's whole image in the region, within twice the tolerance of 2 %: two frames' errors."""
    (x0, y0, x1, y1), camera = (20, 24, 70, 90), views.camera(96, 400.0, distortion=lens)
    another = Operations(views.scene([served.scene.bodies[0]], [camera]))
    asked = {"camera": camera.name, "state": views.state(range_m=1500.0, target=(30.0, 10.0, 0.0)).to_dict()}
    try:
        (_, whole), (header, part) = (answer(another, **asked, **fields) for fields in (
            {}, {"backend": "raytrace", "roi": [x0, y0, x1, y1]}))
    finally:
        another.close()
    own, traced = (np.frombuffer(pixels, "<f4").astype(float) for pixels in (whole, part))
    own, traced = own.reshape(96, 96)[y0:y1, x0:x1], traced.reshape(y1 - y0, x1 - x0)
    assert header["stages"]["distortion"].startswith("skipped" if lens is None else "k1 -0.05")
    assert header["stages"]["region"].startswith("drawn alone")
    assert (own > 0.0).mean() > 0.1
    assert views.relative_rms(traced, own) < 0.04


@pytest.mark.parametrize("fields, path, message", [
    ({"backend": "vulkan"}, "backend", "must be one of"), ({"backend": "egl"}, "backend", "must be one of"),
    ({"backend": None}, "backend", "must be one of"), ({"backend": ["raytrace"]}, "backend", "must be one of"),
    ({"backend": "raytrace", "background": True}, "background", "goes with no backend"),
    ({"frames": [{"backend": "raytrace"}]}, "frames[0].backend", "unknown key"),
    ({"allow_slow": True}, "allow_slow", "known keys are backend"),
    ({"allow_slow": False}, "allow_slow", "unknown key")])
def test_what_is_no_backend_is_refused_by_name_with_the_way_out(served, fields, path, message):
    request = {**REQUEST, **fields}
    if "frames" in fields:
        del request["camera"], request["max_error"]
    header, code, *_ = served.answer(request)
    error = msgpack.unpackb(header[0])["error"]
    assert code == "config" and error["path"] == path and message in error["message"], error


def test_a_backend_that_is_missing_is_the_request_s_fault_not_a_frame_s(tmp_path, monkeypatch):
    """Both clients send `backend` with several frames, and with one."""
    monkeypatch.setenv("GLRENDER_BLENDER", "/nowhere/blender")
    frames = [{"camera": "navcam"}, {"camera": "bare"}]

    async def fly():
        async with AsyncClient(endpoint) as client:
            return await client.render_frames(STATE, frames, backend="cycles")

    with serving.server(tmp_path) as (endpoint, _), Client(endpoint) as client:
        assert len(client.render_frames(STATE, frames)) == 2
        for ask in (lambda: client.render_frames(STATE, frames, backend="cycles"), lambda: asyncio.run(fly()),
                    lambda: client.render(STATE, "bare", backend="cycles")):
            with pytest.raises(ServerError, match="does not work here: GLRENDER_BLENDER") as caught:
                ask()
            assert caught.value.path == "backend"


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
def test_cycles_draws_the_coma_that_opengl_adds(served):
    """The coma's light, what a frame has more than one without it, is OpenGL's to the error that is predicted."""
    body, camera, frames = served.scene.bodies[0], views.camera(48, 200.0), []
    for emission in ([], [Coma(body="body", sources=[Haser(weight_m=5.0)])]):
        another = Operations(views.scene([body], [camera], emission=emission))
        try:
            replies = [answer(another, camera=camera.name, **fields) for fields in ({}, {"backend": "cycles"})]
        finally:
            another.close()
        assert [len(header["plan"]["emission"]) for header, _ in replies] == [len(emission)] * 2
        frames.append([np.frombuffer(pixels, "<f4").astype(float) for _, pixels in replies])
    fast, slow = (lit - without for without, lit in zip(*frames, strict=True))
    (own, _), (traced, _) = replies
    predicted = own["plan"]["emission"][0]["predicted_error"]
    assert own["plan"]["windows"] and not traced["plan"]["windows"] and 0.0 < predicted < 0.05
    assert np.sqrt(np.mean((slow - fast) ** 2)) < 1.1 * predicted * fast.mean()
    np.testing.assert_allclose(slow.sum(), fast.sum(), rtol=1.5e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
def test_a_slow_backend_tells_how_far_it_is_and_has_a_deadline_of_its_own(tmp_path):
    """The deadline of other requests is far below what the slow frame takes; meanwhile `status` tells its progress."""
    seen = []
    with serving.server(tmp_path, "--workers", "1", "--deadline", "0.5") as (endpoint, _):
        with Client(endpoint, timeout_s=120.0) as client, Client(endpoint, timeout_s=10.0) as watcher:
            done = threading.Event()

            def watch():
                while not done.is_set():
                    seen.extend(watcher.status()["slow_frames"])
                    time.sleep(0.05)

            thread = threading.Thread(target=watch)
            thread.start()
            reply = client.render(STATE, "navcam", max_error=1e-3, backend="cycles")
            done.set()
            thread.join()
            assert watcher.status()["slow_frames"] == []
    assert reply.header["timings_ms"]["total"] > 500.0, "slower than the deadline, or this test tells nothing"
    assert reply.header["plan"]["predicted_error"] <= 1e-3
    assert seen == sorted(seen) and 0.0 <= seen[0] < seen[-1] <= 1.0
