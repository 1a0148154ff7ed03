"""Slow frames: drawn by another backend only where OpenGL misses the budget and the caller allows it."""

from __future__ import annotations

import asyncio
import threading
import time
from dataclasses import replace

import msgpack
import numpy as np
import pytest
import serving
import views
from glrender import Body, ConfigError, Renderer, load_scene, take_frame
from glrender.brdf import Lambert
from glrender.emission import Coma
from glrender.emission.sources.haser import Haser
from glrender.engines.rays.backend import RayTracer
from glrender.engines.reference_fallback import SlowFrames
from glrender.planner.request import ImageUse
from glrender_camera import CameraModel, Detector, Optics
from glrender_client import AsyncClient, Client, ServerError
from glrender_server.operations import Operations

# Not as bright all over a facet: no areas, which would meet any of these budgets.
BODY = Body(name="body", shape=views.binary(2, 4), brdf=Lambert(normal_albedo=0.4),
            smooth_normals=True)
SCENE = views.scene([BODY], [views.camera(48, 400.0)])
STATE = views.state(phase_deg=70.0)
# Below what the renderer's rays reach, 24 x 24 a pixel, and what they reach in a second.
MISSED, EASY = 0.002, 0.05
SMOOTH = serving.SCENE.replace('name = "body"', 'name = "body"\nsmooth_normals = true')


@pytest.fixture
def renderer():
    with Renderer(SCENE) as renderer:
        yield renderer


def drawn_by(image):
    return [warning.split(":")[0] for warning in image.plan.warnings if warning.startswith("drawn by")]


def test_what_meets_its_budget_is_not_drawn_twice(renderer, monkeypatch):
    monkeypatch.setattr(SlowFrames, "instead_of", None)
    image = renderer.render(STATE, max_error=EASY, allow_slow=True)
    np.testing.assert_array_equal(image.irradiance_W_m2, renderer.render(STATE, max_error=EASY).irradiance_W_m2)
    assert renderer.render(STATE, max_error=MISSED).plan.predicted_error > MISSED, "not allowed"
    assert renderer.render(STATE, max_error=1e-6, samples=2, allow_slow=True).plan.samples == 2, "samples decide"


@pytest.mark.usefixtures("blender")
def test_the_first_that_meets_the_budget_draws(renderer):
    """The frame is nearer to 48 x 48 rays a pixel than OpenGL's, by as much as it says."""
    told = []
    image = renderer.render(STATE, max_error=MISSED, products=["range"], allow_slow=True, on_progress=told.append)
    assert image.plan.predicted_error <= MISSED == image.plan.max_error
    assert drawn_by(image) and told[-1] == 1.0
    assert image.products["range"].shape == (48, 48)
    with RayTracer(SCENE) as tracer:
        truth = tracer.render(STATE, samples=48).irradiance_W_m2.astype(np.float64)
    lit = truth > 0.0
    error = np.sqrt(np.mean((image.irradiance_W_m2 - truth)[lit] ** 2)) / truth[lit].mean()
    # The truth has a third of that of its own.
    assert error < 1.5 * MISSED


def test_progress_rises_through_backends_and_poses(monkeypatch):
    """To 1, in steps that a frame's poses share, whether its exposure is given, metered, or its poses are."""
    monkeypatch.setattr("glrender.renderer.misses_tolerance", lambda plan: True)
    model = CameraModel(optics=Optics(aperture_diameter_m=0.01), exposure_s=0.1,
                        detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e6, bit_depth=12,
                                          gain_DN_per_electron=4e-3))
    scene = views.scene([BODY], [views.camera(48, 200.0, model=model)])
    spinning = replace(STATE, bodies={"body": replace(STATE.bodies["body"], angular_velocity_rad_s=(0.0, 0.0, 1.5))})
    given = tuple(replace(spinning.after(dt), t_s=dt) for dt in (-0.05, 0.0, 0.05))
    with Renderer(scene) as renderer:
        for options, steps in (({"exposure_s": 0.1}, 3), ({"exposure_s": "auto"}, 2),
                               ({"exposure_s": 0.1, "sub_states": given}, 4)):
            told = []
            capture = take_frame(renderer, spinning, max_error=0.05, allow_slow="raytrace", on_progress=told.append,
                                 **options)
            assert ("poses" in capture.stages["motion_blur"]) == (steps > 2), "metered, the exposure is short"
            assert drawn_by(capture) == ["drawn by raytrace"]
            assert told == sorted(set(told)) and told[-1] == 1.0 and 0.0 < told[0] <= 0.5 and len(told) >= steps


def test_the_second_backend_goes_on_where_the_first_ended(monkeypatch):
    class Slow:
        def __init__(self, error):
            self.error = error

        def render(self, state, camera, *, max_error, on_progress=None):
            for share in (0.25, 1.0):
                on_progress(share)
            return replace(fast, plan=replace(fast.plan, predicted_error=self.error))

        def close(self):
            pass

    with Renderer(SCENE) as renderer:
        fast = renderer.render(STATE, max_error=MISSED)
    slow, told = SlowFrames(SCENE), []
    monkeypatch.setattr(slow, "_open", lambda name: Slow({"raytrace": 0.5, "cycles": 1e-4}[name]))
    slow.instead_of(fast, True, STATE, SCENE.cameras[0], error_gain=1.0, on_progress=told.append)
    assert told == [0.125, 0.5, 0.625, 1.0]


class Scaled:
    """A slow backend that finds so much of the light, and errs by so much in each unit."""

    def __init__(self, fast, rms, share=0.5, **navigation):
        self._made = replace(fast, irradiance_W_m2=share * fast.irradiance_W_m2, small_bodies=(), plan=replace(
            fast.plan, predicted_error=rms, navigation=navigation, warnings=()))

    def render(self, state, camera, *, max_error):
        return self._made

    def close(self):
        pass


@pytest.mark.parametrize("rms, share, stays", [
    (0.9, 0.5, True), (0.0021, 0.5, False), (0.001, 0.5, False), (0.9, 0.0, True), (0.0021, 0.0, True),
    (0.001, 0.0, True)])
def test_the_fast_frame_stays_where_the_slow_one_errs_by_more_or_is_dark(renderer, monkeypatch, rms, share, stays):
    """With its bodies that are apart, its own warning of the miss, and what the other left."""
    plain = renderer.render(STATE, max_error=MISSED)
    monkeypatch.setattr(renderer._slow, "_open", lambda name: Scaled(plain, rms, share))
    image = renderer.render(STATE, max_error=MISSED, allow_slow="raytrace")
    told = [text for text in image.plan.warnings if "exceeds max_error" in text]
    assert len(told) == len(image.plan.missed) == (stays or rms > MISSED)
    reason = "raytrace leaves" if share else "raytrace finds no light"
    assert any(reason in text for text in image.plan.warnings) == bool(told)
    assert image.plan.predicted_error == (plain.plan.predicted_error if stays else rms)
    np.testing.assert_array_equal(image.irradiance_W_m2, (1.0 if stays else share) * plain.irradiance_W_m2)


def test_a_lit_slow_frame_replaces_a_dark_one(monkeypatch):
    """The fast frame is dark, and so is the first slow one, which says that it errs by less than the second."""
    with Renderer(SCENE) as renderer:
        lit = renderer.render(STATE, max_error=MISSED)
    slow, fast = SlowFrames(SCENE), Scaled(lit, 0.5, 0.0)._made
    backends = {"raytrace": Scaled(lit, 0.003, 0.0), "cycles": Scaled(lit, 0.9)}
    monkeypatch.setattr(slow, "_open", lambda name: backends[name])
    best = slow.instead_of(fast, True, STATE, SCENE.cameras[0], error_gain=1.0, on_progress=None)
    assert best.plan.predicted_error == 0.9 and best.irradiance_W_m2.any()


def test_of_tolerances_by_unit_the_one_that_is_missed_by_most_decides(renderer, monkeypatch):
    """A slow frame of less RMS error and more of the flux's, which alone was asked for, does not replace the fast."""
    asked = {"flux": 1e-7}
    plain = renderer.render(STATE, max_error=asked)
    monkeypatch.setattr(renderer._slow, "_open", lambda name: Scaled(plain, 1e-9, flux=0.5))
    image = renderer.render(STATE, max_error=asked, allow_slow="raytrace")
    np.testing.assert_array_equal(image.irradiance_W_m2, plain.irradiance_W_m2)


@pytest.mark.parametrize("rms", [0.9, 1e-9])
def test_small_bodies_stay_apart_where_the_fast_frame_stays(monkeypatch, rms):
    """Of a body of 2 px, alone in its pixels, the image has nothing: its light is in `small_bodies`, or is lost."""
    scene = views.scene([BODY], [views.camera(16, 16.0)])
    with Renderer(scene) as renderer:
        plain = renderer.render(STATE, max_error=1e-7, use=ImageUse(apart_px=8.0))
        monkeypatch.setattr(renderer._slow, "_open", lambda name: Scaled(plain, rms))
        image = renderer.render(STATE, max_error=1e-7, use=ImageUse(apart_px=8.0), allow_slow="raytrace")
    assert plain.plan.missed and len(plain.small_bodies) == 1 and plain.small_bodies[0].irradiance_W_m2 > 0.0
    assert [body.irradiance_W_m2 for body in image.small_bodies] == [plain.small_bodies[0].irradiance_W_m2]


def test_a_miss_before_the_point_spread_function_that_it_cures_is_no_warning(monkeypatch):
    """What the slow backend says of the image before it is not said of the frame; what the frame misses is."""
    with Renderer(SCENE) as renderer:
        fast = renderer.render(STATE, max_error=MISSED)
    slow, missed = SlowFrames(SCENE), replace(fast.plan, max_error=0.02, asked={"rms": 0.02}, predicted_error=0.03)
    warned = replace(missed, warnings=("another", *(f"{text}; give up" for text in missed.misses().values())))
    backend = Scaled(fast, 0.03)
    backend._made = replace(fast, plan=warned)
    monkeypatch.setattr(slow, "_open", lambda name: backend)
    for gain, count in ((0.05, 0), (0.072, 1)):
        plan = slow.instead_of(fast, "raytrace", STATE, SCENE.cameras[0], error_gain=gain, on_progress=None).plan
        assert "another" in plan.warnings and len([text for text in plan.warnings if "exceeds" in text]) == count
        assert len(plan.missed) == count


@pytest.mark.usefixtures("blender")
def test_the_one_that_is_named_draws(renderer):
    assert drawn_by(renderer.render(STATE, max_error=MISSED, allow_slow="cycles")) == ["drawn by cycles"]


def test_rays_draw_what_they_can_and_say_what_is_left(renderer, monkeypatch):
    monkeypatch.setenv("GLRENDER_BLENDER", "/nowhere/blender")
    image = renderer.render(STATE, max_error=1e-4, allow_slow=True)
    warnings = " ".join(image.plan.warnings)
    assert "raytrace leaves" in warnings and "cycles does not work here: GLRENDER_BLENDER" in warnings
    assert image.plan.predicted_error > 1e-4


def test_a_backend_that_is_not_here_or_is_none(renderer, monkeypatch):
    monkeypatch.setenv("GLRENDER_BLENDER", "/nowhere/blender")
    with pytest.raises(ConfigError, match="allow_slow: backend 'cycles' does not work here: GLRENDER_BLENDER"):
        renderer.render(STATE, max_error=MISSED, allow_slow="cycles")
    for value in ("egl", 1, None):
        with pytest.raises(ConfigError, match="allow_slow: must be true, false, or one of raytrace, cycles"):
            renderer.render(STATE, allow_slow=value)


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
def test_a_slow_frame_has_the_coma_that_opengl_adds():
    """The same light as without a coma, and what is more is the same as in OpenGL's frame."""
    coma = Coma(body="body", sources=[Haser(weight_m=5.0)])
    with Renderer(SCENE) as plain, Renderer(views.scene([BODY], SCENE.cameras, emission=[coma])) as renderer:
        without = [plain.render(STATE, max_error=MISSED, allow_slow=slow) for slow in (False, "cycles")]
        fast, slow = (renderer.render(STATE, max_error=MISSED, allow_slow=slow) for slow in (False, "cycles"))
    assert drawn_by(slow) == ["drawn by cycles"] and slow.plan.emission
    assert slow.plan.left_out == ("light between facets",)
    added = [image.irradiance_W_m2.astype(float) - alone.irradiance_W_m2 for image, alone in
             zip((fast, slow), without, strict=True)]
    assert added[0].sum() > 0.0
    np.testing.assert_allclose(added[1], added[0], atol=1e-3 * added[0].max())
    assert slow.roi == fast.roi


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
def test_the_server_draws_slowly_tells_how_far_it_is_and_has_a_deadline_of_its_own(tmp_path):
    """The deadline of other requests is far below what the slow frame takes; meanwhile `status` tells its progress."""
    state, seen = views.state().to_dict(), []
    with serving.server(tmp_path, "--workers", "1", "--deadline", "0.5", scene=SMOOTH) as (endpoint, _):
        with Client(endpoint, timeout_s=120.0) as client, Client(endpoint, timeout_s=10.0) as watcher:
            with pytest.raises(ServerError, match="allow_slow: must be true"):
                client.render(state, "navcam", allow_slow="vulkan")
            done = threading.Event()

            def watch():
                while not done.is_set():
                    seen.extend(watcher.status()["slow_frames"])
                    time.sleep(0.05)

            thread = threading.Thread(target=watch)
            thread.start()
            reply = client.render(state, "navcam", max_error=1e-3, allow_slow="cycles")
            done.set()
            thread.join()
            assert watcher.status()["slow_frames"] == []
    assert reply.header["timings_ms"]["total"] > 500.0, "slower than the deadline, or this test tells nothing"
    assert any(warning.startswith("drawn by cycles") for warning in reply.header["plan"]["warnings"])
    assert reply.header["plan"]["predicted_error"] <= 1e-3
    assert seen == sorted(seen) and 0.0 <= seen[0] < seen[-1] <= 1.0


FRAMES = [{"camera": "navcam", "output": "dn", "exposure_s": 0.02, "seed": 7, "max_error": 0.0008},
          {"camera": "navcam", "max_error": 0.0015, "roi": [20, 10, 76, 54]}, {"camera": "navcam", "max_error": 0.5}]


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
def test_several_slow_frames_of_one_request(tmp_path):
    """Each is the frame of a request of its own; progress is that of the request."""
    told = []
    (tmp_path / "scene.toml").write_text(SMOOTH)
    served = Operations(load_scene(tmp_path / "scene.toml"))
    served.on_progress = told.append
    request = {"v": 1, "op": "render", "id": 1, "client": "slow", "state": views.state().to_dict(),
               "allow_slow": "cycles"}
    try:
        (header, *parts), code = served.answer({**request, "frames": FRAMES})
        header = msgpack.unpackb(header)
        assert not code, header
        assert told == sorted(told) and {1 / 3, 2 / 3} <= set(told) and told[-1] == 2 / 3, "the third is not slow"
        alone = [np.frombuffer(served.answer({**request, **frame})[0][1], kind) for frame, kind in
                 zip(FRAMES, ("<u2", "<f4", "<f4"), strict=True)]
    finally:
        served.close()
    together = [np.frombuffer(part, one.dtype) for part, one in zip(parts, alone, strict=True)]
    for one, other, places in zip(alone, together, (96 * 64, 56 * 44, 96 * 64), strict=True):
        assert one.size == other.size == places
        # Paths that Cycles draws anew differ in their noise.
        np.testing.assert_allclose(one.sum(dtype=float), other.sum(dtype=float), rtol=0.01)
    np.testing.assert_array_equal(together[2], alone[2])
    assert [any("drawn by cycles" in warning for warning in frame["plan"]["warnings"])
            for frame in header["frames"]] == [True, True, False]


def test_a_backend_that_is_missing_is_the_requests_fault_not_a_frames(tmp_path, monkeypatch):
    """Both clients send `allow_slow` with several frames."""
    monkeypatch.setenv("GLRENDER_BLENDER", "/nowhere/blender")
    state = views.state().to_dict()

    async def fly():
        async with AsyncClient(endpoint) as client:
            return await client.render_frames(state, FRAMES, allow_slow="cycles")

    with serving.server(tmp_path, scene=SMOOTH) as (endpoint, _), Client(endpoint) as client:
        assert len(client.render_frames(state, FRAMES)) == 3
        for ask in (lambda: client.render_frames(state, FRAMES, allow_slow="cycles"), lambda: asyncio.run(fly())):
            with pytest.raises(ServerError, match="does not work here") as caught:
                ask()
            assert caught.value.path == "allow_slow"
