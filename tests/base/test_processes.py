"""Forked and spawned children: their own renderers and frames are their parent's bytes, and nothing waits for ever."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import sys
import threading
import time
import zlib
from contextlib import contextmanager
from pathlib import Path

import forking
import numpy as np
import pytest
from glrender import DeviceError, Scene, open_renderer, take_frame
from glrender.base.disk_cache import cache_folder
from glrender_camera import CameraModel, PinholeCamera
from views import state

SCENE = {"bodies": [{"name": "body", "generated": {"kind": "contact_binary", "radius_m": 100.0, "seed": 3,
                                                   "subdivisions": 4},
                     "brdf": {"law": "lambert", "normal_albedo": 0.2}}],
         "cameras": [{"name": "navcam", "width_px": 96, "height_px": 96, "focal_length_px": 600.0,
                      "model": {"preset": "generic_navigation_camera", "exposure_s": 0.01}}]}
LIGHT_W_M2 = np.full((700, 700), 1e-6, np.float32)


def camera(size_px=700):
    return PinholeCamera(name="wide", width_px=size_px, height_px=size_px, focal_length_px=1000.0,
                         model=CameraModel.from_dict({"preset": "generic_navigation_camera"}))


def drawn_by(renderer):
    return zlib.crc32(take_frame(renderer, state(), seed=1).frame.dn.tobytes())


def draw(backend="auto", scene=None):
    with open_renderer(scene or Scene.from_dict(SCENE), backend) as renderer:
        return drawn_by(renderer)


def expose(given=None):
    return zlib.crc32((given or camera()).expose(LIGHT_W_M2, seed=1, exposure_s=0.1).dn.tobytes())


@contextmanager
def running(task):
    """Threads that do a task again and again meanwhile."""
    is_over = threading.Event()

    def loop():
        while not is_over.is_set():
            task()

    threads = [threading.Thread(target=loop) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        is_over.set()
        for thread in threads:
            thread.join()


@pytest.mark.parametrize("backend", ["auto", "raytrace"])
def test_a_forked_child_draws_with_a_renderer_of_its_own(backend):
    """After its parent's was closed, and while that is open; so does a child of the child."""
    truth = draw(backend)
    assert forking.in_child(lambda: draw(backend)) == truth
    with open_renderer(Scene.from_dict(SCENE), backend) as renderer:
        assert drawn_by(renderer) == truth
        assert forking.in_child(lambda: draw(backend)) == truth
        assert drawn_by(renderer) == truth
    assert forking.in_child(lambda: forking.in_child(lambda: draw(backend))) == truth


def test_a_forked_child_exposes_with_a_camera_in_use():
    """Its parent's camera, and one of its own."""
    used = camera()
    truth = expose(used)
    assert forking.in_child(lambda: expose(used)) == truth == forking.in_child(expose)


def test_a_fork_amid_frames_that_other_threads_take():
    """Ten forks while two threads expose with the pool of threads, and with the camera that the child has too."""
    used = camera()
    truth = expose(used)
    with running(lambda: expose(used)), running(expose):
        for _ in range(5):
            assert forking.in_child(lambda: expose(used)) == truth
            assert forking.in_child(expose) == truth


def test_a_fork_from_a_thread_of_a_pool():
    """As a loader does that prepares its workers in the background."""
    truth, found = draw(), []
    thread = threading.Thread(target=lambda: found.append(forking.in_child(draw)))
    thread.start()
    thread.join()
    assert found == [truth]


def test_workers_of_a_pool_draw_when_they_are_first_asked():
    """As PyTorch's DataLoader: three forked workers, several items each."""
    truth = draw()
    with multiprocessing.get_context("fork").Pool(3) as pool:
        assert pool.map_async(_item, range(6), chunksize=1).get(120.0) == [truth] * 6


def _item(_):
    return draw()


def test_a_spawned_child_draws_what_was_sent():
    """A scene with a camera that was used goes through a pickle."""
    scene = Scene.from_dict(SCENE)
    truth = draw(scene=scene)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply_async(draw, ("auto", scene)).get(120.0) == truth


def test_a_property_that_a_thread_works_out_is_not_waited_for():
    """Python 3.11 locks each cached property of a class while one object's is worked out."""
    large = threading.Thread(target=lambda: camera(6000).cos_field_angle)
    large.start()
    time.sleep(0.02)
    assert large.is_alive(), "it takes half a second"
    assert forking.in_child(lambda: camera(5).cos_field_angle[2, 2], 20.0) == 1.0
    large.join()


def test_a_module_that_a_thread_imports_is_whole_in_the_child(tmp_path, monkeypatch):
    """Loops are compiled as their module is imported: the fork waits for its end."""
    (tmp_path / "glrender_slow_module.py").write_text("import time\ntime.sleep(1.0)\nVALUE = 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    thread = threading.Thread(target=__import__, args=("glrender_slow_module",))
    thread.start()
    while "glrender_slow_module" not in sys.modules:
        time.sleep(0.001)
    assert forking.in_child(lambda: __import__("glrender_slow_module").VALUE, 20.0) == 3
    thread.join()
    del sys.modules["glrender_slow_module"]


@pytest.mark.parametrize("backend", ["auto", "raytrace"])
def test_an_inherited_renderer_says_so_at_once(backend):
    """In words, and its end in the child is not its end in the parent; nor can it be pickled, or copied in depth."""
    with open_renderer(Scene.from_dict(SCENE), backend) as renderer:
        truth = drawn_by(renderer)

        def child():
            began = time.monotonic()
            with renderer, pytest.raises(DeviceError, match=f"process {os.getppid()}, .*make one renderer in each"):
                renderer.render(state(), "navcam")
            return time.monotonic() - began

        assert forking.in_child(child) < 1.0
        assert drawn_by(renderer) == truth
        for send in (pickle.dumps, copy.deepcopy):
            with pytest.raises(TypeError, match="send the scene, which can, and make one renderer in each process"):
                send(renderer)


@pytest.mark.parametrize("empty", [{"GLRENDER_CACHE": ""}, {"GLRENDER_CACHE": "", "XDG_CACHE_HOME": ""}])
def test_an_empty_cache_variable_is_none(empty, monkeypatch):
    """As the XDG rule has it: nothing is written into the working folder."""
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    for name, value in empty.items():
        monkeypatch.setenv(name, value)
    assert cache_folder() == Path.home() / ".cache" / "glrender"
