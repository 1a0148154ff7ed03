"""Contexts without a display: choice, limits, release."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from backends import WORKING, backend_or_skip
from glrender.base.errors import ConfigError, DeviceError
from glrender.engines.raster.gl.context import BACKENDS, Context


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_context_names_what_it_found(backend):
    with Context(backend_or_skip(backend)) as context:
        assert context.info["backend"] == backend
        assert context.info["gl_renderer"]
        assert context.info["max_texture_px"] >= 4096


def test_auto_takes_egl_first():
    with Context("auto") as context:
        assert context.backend == ("egl" if "egl" in WORKING else "osmesa")


def test_unknown_backend_is_refused_by_name():
    with pytest.raises(ConfigError, match="backend: must be one of 'auto', 'egl', 'osmesa', got 'vulkan'"):
        Context("vulkan")


def test_a_device_that_is_not_there_says_how_many_are():
    backend_or_skip("egl")
    with pytest.raises(DeviceError, match=r"egl: requested device index 99, but found \d+ devices"):
        Context("egl", device_index=99)


@pytest.mark.parametrize("device_index", [-1, "a", 1.5, True])
def test_a_device_index_that_is_none_is_refused(device_index):
    with pytest.raises(ConfigError, match="device_index: must be an integer >= 0, got"):
        Context("auto", device_index=device_index)


def test_a_device_asked_for_is_not_another_one():
    with pytest.raises(ConfigError, match="device_index: belongs to EGL"):
        Context("osmesa", device_index=0)
    with pytest.raises(DeviceError, match="99"):
        Context("auto", device_index=99)


def test_a_closed_context_says_so():
    context = Context("auto")
    context.close()
    with pytest.raises(DeviceError, match="this renderer is closed"):
        context.make_current()


def _python(code: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], env={**os.environ, **environment}, capture_output=True,
                          text=True, timeout=400)


def test_without_egl_auto_falls_back_to_osmesa():
    """EGL finds no vendor library: OSMesa draws, and nothing is asked of the caller."""
    backend_or_skip("osmesa")
    run = _python("from glrender.engines.raster.gl.context import Context\nprint(Context('auto').info['backend'])",
                  __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent.json")
    assert run.stdout.split() == ["osmesa"], run.stderr


def test_when_nothing_works_the_error_says_what_to_install():
    run = _python("import glrender.engines.raster.gl.context as c, glrender.engines.raster.gl.osmesa as o\n"
                  "o.find_osmesa = lambda: None\n"
                  "try:\n    c.Context('auto')\nexcept c.DeviceError as e:\n    print(e)",
                  __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent.json")
    assert "egl: " in run.stdout and "osmesa: libOSMesa was not found" in run.stdout, run.stderr
    assert "apt-get install" in run.stdout


@pytest.mark.slow
@pytest.mark.parametrize("n_cycles", [300, 1000])
@pytest.mark.parametrize("backend", BACKENDS)
def test_hundreds_of_contexts_leak_no_more_than_mesa_itself(backend, n_cycles):
    """RSS by at most 50 kB a cycle (Mesa's own is 38 to 42 kB on 22.3), and no file descriptor."""
    backend_or_skip(backend)
    run = _python(f"""
import os
from glrender.engines.raster.gl.context import Context
from glrender.engines.raster.gl.targets import Target
def cycle():
    with Context({backend!r}) as context, Target(context, [1, 4]) as target:
        target.begin(64, 64)
def state():
    pages = int(open('/proc/self/statm').read().split()[1])
    count = lambda name: len(os.listdir('/proc/self/' + name))
    return pages * os.sysconf('SC_PAGE_SIZE') / 1024, count('fd'), count('task')
for _ in range(50):
    cycle()
before = state()
for _ in range({n_cycles}):
    cycle()
after = state()
print((after[0] - before[0]) / {n_cycles}, after[1] - before[1], after[2] - before[2])
""")
    kilobytes, descriptors, threads = map(float, run.stdout.split())
    assert kilobytes < 50.0
    assert descriptors == 0
    assert threads == 0


def test_another_thread_is_refused_not_crashed():
    errors = []
    with Context() as context:

        def use():
            try:
                context.make_current()
            except DeviceError as error:
                errors.append(str(error))

        thread = threading.Thread(target=use)
        thread.start()
        thread.join()
    assert errors and "another thread" in errors[0]


def test_two_contexts_of_one_thread_keep_their_buffers():
    with Context() as first, Context() as second:
        first.make_current()
        a = first.own(first.gl.buffer(b"first"))
        second.make_current()
        b = second.own(second.gl.buffer(b"other"))
        first.make_current()
        assert a.read() == b"first"
        second.make_current()
        assert b.read() == b"other"


def test_doctor_tells_what_works():
    glrender = Path(sys.executable).with_name("glrender")
    run = subprocess.run([glrender, "doctor", "--json"], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stdout + run.stderr
    levels = {finding["name"]: finding["level"] for finding in json.loads(run.stdout)}
    for backend in WORKING:
        assert levels[f"OpenGL by {backend}"] == "ok"
