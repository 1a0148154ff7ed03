"""Blender's process: kept from frame to frame, ended with us, and never waited for beyond its deadline."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
import views
from glrender import Body, DeviceError
from glrender.brdf import GlslText, Lambert, LommelSeeliger
from glrender.engines.cycles import Cycles
from glrender.engines.cycles.finder import SERVE
from glrender.engines.cycles.inside import framing
from glrender.engines.cycles.process import BlenderProcess
from glrender.engines.cycles.rounds import MAX_SAMPLES, Rounds
from processes import children

SCENE = views.scene([views.sphere(Lambert(normal_albedo=0.4), 3)], [views.camera(48, 300.0)])


def blenders(pid):
    """Process numbers of the Blenders that a process began."""
    return children(pid, SERVE.name.encode())


def is_alive(pid):
    """Whether a process runs; one that nobody waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)


@pytest.mark.usefixtures("blender")
def test_one_process_draws_all_frames_and_ends_with_the_renderer():
    with Cycles(SCENE) as cycles:
        pid, = blenders(os.getpid())
        images = [cycles.render(views.state(phase_deg=phase), samples=4).irradiance_W_m2 for phase in (20, 90, 20)]
        assert blenders(os.getpid()) == [pid]
    assert not is_alive(pid)
    np.testing.assert_array_equal(images[0], images[2])
    assert images[0].sum() > 1.5 * images[1].sum()


@pytest.mark.usefixtures("blender")
def test_nothing_is_left_in_the_folder_of_temporary_files(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Cycles(SCENE) as cycles:
        cycles.render(views.state(), samples=2)
        assert list(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
def test_equal_requests_give_equal_bytes_whatever_came_between():
    """Cycles keeps its tables of samples: they are as large as they get from the start."""
    with Cycles(SCENE, bounces=0) as cycles:
        drawn = [cycles.render(views.state(), samples=samples).irradiance_W_m2.tobytes()
                 for samples in (8, 32, 8, 64, 32, 8)]
    assert drawn[0] == drawn[2] == drawn[5] != drawn[1] == drawn[4]


@pytest.mark.usefixtures("blender")
def test_progress_rises_to_the_end():
    told = []
    with Cycles(SCENE) as cycles:
        cycles.render(views.state(), max_error=0.02, on_progress=told.append)
    assert told == sorted(told) and told[-1] == 1.0 and len(told) > 3


@pytest.mark.usefixtures("blender")
def test_a_frame_beyond_its_deadline_is_given_up_and_the_next_is_drawn():
    with Cycles(SCENE) as cycles:
        pid, = blenders(os.getpid())
        cycles._deadline_s = 0.6
        with pytest.raises(DeviceError, match="took longer than its deadline"):
            cycles.render(views.state(), samples=128)
        assert not is_alive(pid)
        cycles._deadline_s = 60.0
        assert cycles.render(views.state(), samples=2).irradiance_W_m2.sum() > 0.0


@pytest.mark.usefixtures("blender")
def test_blender_that_dies_is_told_and_replaced():
    with Cycles(SCENE) as cycles:
        os.kill(*blenders(os.getpid()), signal.SIGKILL)
        with pytest.raises(DeviceError, match="Blender (died|does not take the request)"):
            cycles.render(views.state(), samples=2)
        assert cycles.render(views.state(), samples=2).irradiance_W_m2.sum() > 0.0


@pytest.mark.usefixtures("blender")
def test_a_caller_who_gives_up_gets_the_next_frame_and_not_the_last():
    class EnoughError(Exception):
        pass

    def stop(share):
        raise EnoughError

    with Cycles(SCENE) as cycles:
        expected = cycles.render(views.state(phase_deg=90.0), samples=2).irradiance_W_m2
        with pytest.raises(EnoughError):
            cycles.render(views.state(phase_deg=10.0), samples=16, on_progress=stop)
        np.testing.assert_array_equal(cycles.render(views.state(phase_deg=90.0), samples=2).irradiance_W_m2, expected)


@pytest.mark.usefixtures("blender")
def test_blender_ends_when_we_are_killed_amid_a_frame():
    code = f"""
import sys
sys.path.append({str(Path(__file__).parents[2] / 'support')!r})
import views
from glrender.brdf import Lambert
from glrender.engines.cycles import Cycles
cycles = Cycles(views.scene([views.sphere(Lambert(normal_albedo=0.4), 3)], [views.camera(48, 300.0)]))
print("open", flush=True)
cycles.render(views.state(), samples=128, on_progress=lambda share: print("drawing", flush=True))
"""
    ours = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert ours.stdout.readline() == "open\n"
    pid, = blenders(ours.pid)
    assert ours.stdout.readline() == "drawing\n"
    assert is_alive(pid)
    ours.kill()
    ours.wait()
    wait_until(lambda: not is_alive(pid))


@pytest.mark.usefixtures("blender")
def test_a_law_that_is_no_osl_is_named():
    class Odd(LommelSeeliger):
        glsl = GlslText("odd", "float brdf(vec3 a, vec3 b, vec3 normal, float albedo_scale) { return nonsense(a); }")

    body = Body(name="rock", shape=SCENE.bodies[0].shape, brdf=Odd(single_scattering_albedo=0.3))
    with pytest.raises(DeviceError, match="the law of 'rock' does not compile as OSL"):
        Cycles(views.scene([body], SCENE.cameras))


@pytest.mark.parametrize("program, message", [
    ("/nowhere/blender", "GLRENDER_BLENDER: must be a program, got '/nowhere/blender'; `make blender` brings it"),
    ("PYTHON", "Blender failed: ModuleNotFoundError: No module named 'bpy'"),
    ("false", "Blender died")])
def test_no_blender_is_a_device_error_that_says_what_to_do(monkeypatch, tmp_path, program, message):
    if program == "PYTHON":
        # A Python of this version without our packages.
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv"], check=True)
        packages = next((tmp_path / "venv" / "lib").iterdir()) / "site-packages"
        (packages / "numpy.py").write_text("")
        program = str(tmp_path / "venv" / "bin" / "python")
    monkeypatch.setenv("GLRENDER_BLENDER", program)
    with pytest.raises(DeviceError, match=message):
        BlenderProcess()


def test_what_is_no_message_is_no_blender(monkeypatch, tmp_path):
    program = tmp_path / "python_that_babbles"
    program.write_text(f"#!{sys.executable}\nimport socket, sys\n"
                       "socket.socket(fileno=int(sys.argv[-1])).sendall(b'Blender 9.9 says hello')\n")
    program.chmod(0o755)
    monkeypatch.setenv("GLRENDER_BLENDER", str(program))
    with pytest.raises(DeviceError, match="sent bytes that are no message"):
        BlenderProcess()


def test_framing_gives_back_what_was_sent():
    ours, theirs = socket.socketpair()
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.zeros((0, 3), np.int32),
              "c": np.asfortranarray(np.random.default_rng(1).normal(size=(4, 5)))}
    framing.send(ours, {"op": "draw", "n": [1, 2.5]}, arrays)
    head, got = framing.receive(theirs)
    assert head == {"op": "draw", "n": [1, 2.5]}
    for name, array in arrays.items():
        np.testing.assert_array_equal(got[name], array)
        assert got[name].dtype == array.dtype
    ours.close()
    with pytest.raises(EOFError):
        framing.receive(theirs)


@pytest.mark.parametrize("told", [
    {"name": "a", "dtype": "|O", "shape": [1]}, {"name": "a", "dtype": "<f4", "shape": [-1]},
    {"name": "a", "dtype": "<f8", "shape": [1 << 40]}])
def test_framing_refuses_arrays_that_cannot_be(told):
    import json
    import struct

    ours, theirs = socket.socketpair()
    text = json.dumps({"arrays": [told]}).encode()
    ours.sendall(framing.MAGIC + struct.pack("<I", len(text)) + text)
    with pytest.raises(framing.FramingError):
        framing.receive(theirs)


@pytest.mark.parametrize("budget, most", [(1e-9, 8), (3e-4, 8), (5e-3, MAX_SAMPLES), (0.02, 4000)])
def test_a_budget_out_of_reach_is_not_paid_for(budget, most):
    """1e-12 had 16384 samples drawn: over the wire two workers killed at their deadline, and `poison`."""
    drawn = []

    def draw(n, seed, tell):
        drawn.append(n)
        return 1.0 + np.random.default_rng(seed).normal(size=(40, 40)) / np.sqrt(n)

    rounds = Rounds(draw, 0, lambda share: None)
    error = rounds.until(budget)
    assert rounds.n_samples == sum(drawn) <= most
    assert error <= budget or budget < 1.0 / np.sqrt(MAX_SAMPLES)


def test_one_sample_a_pixel_tells_its_error_by_contrast():
    """A step: two of forty columns have the contrast of what is lit, half of all; 0.235 of it is the error there."""
    step = np.repeat([[0.0, 1.0]], 20, axis=1) * np.ones((40, 1))
    rounds = Rounds(lambda n, seed, tell: step, 0, lambda share: None)
    assert rounds.fixed(1) == pytest.approx(0.235 * (2.0 / 20.0) ** 0.5, rel=1e-6)
