"""The camera as a unit of FMI 2.0 and 3.0: built, validated and simulated by FMPy against a real server."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from pathlib import Path

import glrender_client  # noqa: F401 - before a unit brings its own copy into this process
import numpy as np
import pytest
import serving
import zmq
from missing import needed_module

FMI = Path(__file__).parents[2] / "clients" / "fmi"
SCENE = """
[[bodies]]
name = "ball"
generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 6 }
brdf = { law = "lommel_seeliger", single_scattering_albedo = 0.3 }
[[bodies]]
name = "2nd moon"
generated = { kind = "icosphere", radius_m = 1.0, subdivisions = 2 }
brdf = { law = "lommel_seeliger", single_scattering_albedo = 0.3 }
[[cameras]]
name = "navcam"
width_px = 256
height_px = 240
focal_length_px = 1000.0
q_camera_from_spacecraft = [0.5, -0.5, -0.5, -0.5]
[cameras.model]
exposure_s = 4e-6
optics = { aperture_diameter_m = 0.01, psf_sigma_px = 0.6 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.1, bit_depth = 12, \
read_noise_electrons = 10.0, offset_DN = 50.0 }
[[cameras]]
name = "bent"
width_px = 64
height_px = 64
focal_length_px = 100.0
distortion = { k1 = 0.1 }
"""
FOCAL_PX, CENTRE_PX, RADIUS_M, RANGE_M = 1000.0, np.array([127.5, 119.5]), 100.0, 1500.0


@pytest.fixture(scope="module")
def fmpy():
    needed_module("fmpy.validation", "pip install fmpy")
    return needed_module("fmpy", "pip install fmpy")


@pytest.fixture(scope="module", autouse=True)
def own_path():
    """Units put their folders on this process' path."""
    before = list(sys.path)
    yield
    sys.path[:] = before


@pytest.fixture(scope="module")
def units(tmp_path_factory, fmpy):
    """The file of each version's unit, built by the command of the page."""
    folder, found = tmp_path_factory.mktemp("units"), {}
    for version, package in ((2, "pythonfmu"), (3, "pythonfmu3")):
        needed_module(package, "pip install 'glrender[fmi]'")
        run = subprocess.run([sys.executable, FMI / "build_fmu.py", "--fmi", str(version), "--bodies", "ball",
                              "2nd moon", "--out", folder], capture_output=True, text=True, timeout=120)
        assert run.returncode == 0, run.stderr
        found[version] = Path(run.stdout.strip())
    return found


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("server"), scene=SCENE) as (endpoint, _):
        yield endpoint


def start(endpoint, phase_deg, **more):
    """The ball off the boresight, which a mounting takes from the spacecraft's x to the camera's z."""
    phase = math.radians(phase_deg)
    return {"endpoint": endpoint, "camera": "navcam", "sun.r_x_m": -1.5e11 * math.cos(phase),
            "sun.r_y_m": 1.5e11 * math.sin(phase), "spacecraft.r_x_m": -RANGE_M, "ball.r_y_m": 20.0,
            "ball.r_z_m": -30.0, "'2nd moon'.r_x_m": -1e6, **more}


def geometry(offset_m=(20.0, -30.0), depth_m=RANGE_M):
    """Image of the ball's centre [px], its radius [px] and its range [m] in the plainest geometry."""
    range_m = math.sqrt(offset_m[0]**2 + offset_m[1]**2 + depth_m**2)
    return (CENTRE_PX + FOCAL_PX * np.array(offset_m) / depth_m,
            FOCAL_PX * RADIUS_M / math.sqrt(range_m**2 - RADIUS_M**2), range_m)


def brightness_px(offset_m, phase):
    """Centre of the light of a Lommel-Seeliger sphere before a pinhole, by a sum over its surface."""
    latitude, longitude = np.meshgrid(np.linspace(-0.5, 0.5, 801) * math.pi, np.linspace(-1.0, 1.0, 1601) * math.pi)
    normal = np.stack((np.cos(latitude) * np.sin(longitude), np.sin(latitude),
                       np.cos(latitude) * np.cos(longitude)), axis=-1)
    point_m = RADIUS_M * normal + [*offset_m, RANGE_M]
    range_m = np.linalg.norm(point_m, axis=-1)
    cos_emission = -(normal * point_m).sum(axis=-1) / range_m
    cos_incidence = normal @ [math.sin(phase), 0.0, -math.cos(phase)]
    is_seen = (cos_emission > 0.0) & (cos_incidence > 0.0)
    both = np.where(is_seen, cos_emission + cos_incidence, 1.0)
    light = np.where(is_seen, cos_emission * cos_incidence / both * np.cos(latitude) / range_m**2, 0.0)
    image_px = CENTRE_PX + FOCAL_PX * point_m[..., :2] / point_m[..., 2:]
    return np.average(image_px.reshape(-1, 2), axis=0, weights=light.ravel())


@pytest.mark.parametrize("version", [2, 3])
def test_the_unit_is_valid(fmpy, units, version):
    """By FMPy's rules; its bodies are inputs by name."""
    assert fmpy.validation.validate_fmu(str(units[version])) == []
    description = fmpy.read_model_description(str(units[version]))
    names = {each.name for each in description.modelVariables if each.causality == "input"}
    assert len(names) == 3 + 3 * 7 and {"spacecraft.q_w", "ball.r_z_m", "'2nd moon'.q_z"} <= names


@pytest.mark.parametrize("version", [2, 3])
def test_measurements_are_the_geometrys(fmpy, units, endpoint, version):
    """Centre, radius and range by the limb within 0.1 px, 0.2 px and 0.3 %; the light's centre within 0.1 px."""
    where_px, radius_px, range_m = geometry()
    for phase_deg in (10.0, 45.0, 90.0):
        last = fmpy.simulate_fmu(str(units[version]), stop_time=1.0, output_interval=1.0,
                                 start_values=start(endpoint, phase_deg))[-1]
        assert last["is_valid"] and last["saturated_share"] == 0.0 and 100.0 < last["max_dn"] < 4000.0
        assert last["limb_x_px"] == pytest.approx(where_px[0], abs=0.1)
        assert last["limb_y_px"] == pytest.approx(where_px[1], abs=0.1)
        assert last["limb_radius_px"] == pytest.approx(radius_px, abs=0.2)
        assert last["range_m"] == pytest.approx(range_m, rel=3e-3) and 0.0 < last["predicted_error"] < 0.02
        x_px, y_px = brightness_px((20.0, -30.0), math.radians(phase_deg))
        assert last["brightness_x_px"] == pytest.approx(x_px, abs=0.1)
        assert last["brightness_y_px"] == pytest.approx(y_px, abs=0.1)


def test_a_step_measures_the_state_of_its_beginning(fmpy, units, endpoint):
    """A ball that moves through the image, and noise that differs from step to step but not from run to run."""
    times = np.arange(0.0, 5.0)
    moving = np.array(list(zip(times, 5.0 * times, strict=True)), dtype=[("time", float), ("ball.r_y_m", float)])
    runs = [fmpy.simulate_fmu(str(units[3]), stop_time=4.0, output_interval=1.0, input=moving,
                              start_values=start(endpoint, 20.0, seed=7)) for _ in range(2)]
    np.testing.assert_array_equal(runs[0]["limb_x_px"], runs[1]["limb_x_px"])
    for row in runs[0][1:]:
        where_px, _, _ = geometry((5.0 * (row["time"] - 1.0), -30.0))
        assert row["limb_x_px"] == pytest.approx(where_px[0], abs=0.1)


def test_what_an_image_does_not_have_is_nan(fmpy, units, endpoint):
    """No body; one whose limb is outside; one that is a point has a centre of brightness, and no limb."""
    for more, is_bright in (({"spacecraft.q_w": 0.0, "spacecraft.q_z": 1.0}, False), ({"ball.r_y_m": 260.0}, True),
                            ({"spacecraft.r_x_m": -9e4, "exposure_s": 2e-4}, True)):
        last = fmpy.simulate_fmu(str(units[3]), stop_time=1.0, output_interval=1.0,
                                 start_values=start(endpoint, 30.0, **more))[-1]
        assert not last["is_valid"] and math.isnan(last["range_m"]) and math.isnan(last["limb_x_px"])
        assert math.isnan(last["brightness_x_px"]) != is_bright


@pytest.mark.parametrize("version", [2, 3])
def test_before_the_first_frame_nothing_is_measured(fmpy, units, endpoint, version):
    """At t = 0 all numbers are NaN, and `is_valid` is false."""
    first = fmpy.simulate_fmu(str(units[version]), stop_time=1.0, output_interval=1.0,
                              start_values=start(endpoint, 30.0))[0]
    assert first["time"] == 0.0 and not first["is_valid"]
    numbers = [name for name in first.dtype.names if name not in ("time", "is_valid", "is_late")]
    assert len(numbers) == 12 and all(math.isnan(first[name]) for name in numbers)


@pytest.mark.parametrize("version", [2, 3])
def test_what_is_odd_or_late_is_said(fmpy, units, endpoint, version):
    """Each kind of warning once in the log, its number at each step; a frame in a microsecond is late."""
    lines, late = [], {"exposure_s": 0.01, "deadline_s": 1e-6}
    rows = fmpy.simulate_fmu(str(units[version]), stop_time=2.0, output_interval=1.0, debug_logging=True, logger=(
        lambda *each: lines.append(str(each))), start_values=start(endpoint, 30.0, **late))
    assert all(rows["is_late"][1:]) and min(rows["n_warnings"][1:]) >= 1.0
    np.testing.assert_array_equal(rows["used_exposure_s"][1:], 0.01)
    assert "\n".join(lines).count("glrender: saturated: ") == 1
    last = fmpy.simulate_fmu(str(units[version]), stop_time=1.0, output_interval=1.0,
                             start_values=start(endpoint, 30.0))[-1]
    assert not last["is_late"] and last["n_warnings"] == 0.0 and last["used_exposure_s"] == pytest.approx(4e-6)


@pytest.mark.parametrize("version, status", [(2, "fatal"), (3, "error")])
@pytest.mark.parametrize("more, said", [
    ({"endpoint": "tcp://127.0.0.1:9", "timeout_s": 0.2}, "nothing listens there"), ({"camera": "far"}, "navcam, bent"),
    ({"endpoint": "nowhere"}, "nowhere"), ({"camera": "bent"}, "must have no distortion"),
    ({"target": "sun"}, "must be one of"), ({"timeout_s": 0.0}, "timeout_s: must be > 0"),
    ({"seed": -1}, "seed: must be from 0 to 4294967295, got -1"),
    ({"spacecraft.q_w": 2.0}, "norm must be 1"), ({"exposure_s": -1.0}, "exposure_s")])
def test_a_frame_that_cannot_be_had_is_an_error_soon(fmpy, units, endpoint, version, status, more, said):
    lines, began = [], time.monotonic()
    with pytest.raises(Exception, match=rf"DoStep failed with status \d \({status}\)"):
        fmpy.simulate_fmu(str(units[version]), stop_time=1.0, output_interval=1.0, logger=lambda *each: lines.append(
            str(each)), debug_logging=True, start_values=start(endpoint, 30.0) | more)
    assert time.monotonic() - began < 20.0 and said in "\n".join(lines), lines


def test_a_server_that_says_nothing_is_not_waited_for(fmpy, units):
    """Whatever listens there: two tries of `timeout_s`, and a look whether somebody is there."""
    with zmq.Context() as context, context.socket(zmq.ROUTER) as silent:
        silent.linger, port = 0, silent.bind_to_random_port("tcp://127.0.0.1")
        lines, began = [], time.monotonic()
        with pytest.raises(Exception, match="error"):
            fmpy.simulate_fmu(str(units[3]), stop_time=1.0, logger=lambda *each: lines.append(str(each)),
                              debug_logging=True, start_values={"endpoint": f"tcp://127.0.0.1:{port}",
                                                                "timeout_s": 0.3})
    assert time.monotonic() - began < 15.0 and "did not answer `hello` within 0.3 s, 2 times" in "\n".join(lines)


def test_bodies_that_the_server_does_not_have_are_told(fmpy, units, tmp_path):
    with serving.server(tmp_path) as (endpoint, _):
        lines = []
        with pytest.raises(Exception, match="error"):
            fmpy.simulate_fmu(str(units[3]), stop_time=1.0, logger=lambda *each: lines.append(str(each)),
                              debug_logging=True, start_values={"endpoint": endpoint, "camera": "navcam"})
    assert "was built for the bodies ball, 2nd moon, and the server has body; build it anew" in "\n".join(lines)
