"""The chain through the server and the command line: the bytes of `take_frame`, what `hello` tells, what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import serving
import views
from chain import BODIES, OPTICS, READ, table
from glrender import Pose, State, draw_still, load_scene, open_renderer, take_frame
from glrender_cli.__main__ import main as glrender
from glrender_client import Client, ServerError
from programs import run

EXAMPLES = Path(__file__).parents[2] / "examples"
DETECTOR = ("detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.1, "
            "bit_depth = 12, read_noise_electrons = 10.0, rolling_shutter_row_s = 1e-4 }")
SCENE = f"""
max_error = 0.1
[stars]
magnitude_limit = 5.0
year = 2031.5
[[bodies]]
name = "body"
generated = {{ kind = "three_lobes", radius_m = 100.0, subdivisions = 4 }}
brdf = {{ law = "lunar_lambert", normal_albedo = 0.2, weight = "mcewen" }}
[[cameras]]
name = "wide"
width_px = 96
height_px = 64
focal_length_px = 100.0
distortion = {{ k1 = -0.2, p1 = 0.001 }}
[cameras.model]
exposure_s = "auto"
optics = {{ aperture_diameter_m = 0.02, psf_sigma_px = 0.6 }}
{DETECTOR}
[[cameras]]
name = "colour"
width_px = 64
height_px = 64
focal_length_px = 100.0
[cameras.model]
exposure_s = 1e-4
pattern = ["RG", "GB"]
{DETECTOR}
[cameras.model.optics]
R = {{ aperture_diameter_m = 0.02, band_nm = [600.0, 700.0] }}
G = {{ aperture_diameter_m = 0.02, band_nm = [500.0, 600.0] }}
B = {{ aperture_diameter_m = 0.02, band_nm = [400.0, 500.0] }}
"""
STATE = views.state(range_m=500.0)
MOVING = State(r_sun_inertial_m=STATE.r_sun_inertial_m, bodies=STATE.bodies, spacecraft=Pose(
    r_inertial_m=STATE.spacecraft.r_inertial_m, q_from_inertial=STATE.spacecraft.q_from_inertial,
    v_inertial_m_s=[10.0, 0.0, 0.0], angular_velocity_rad_s=[0.2, 0.0, 0.0]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("capture")


@pytest.fixture(scope="module")
def client(folder):
    with serving.server(folder, "--shape-dir", str(folder), scene=SCENE) as (endpoint, _), \
            Client(endpoint, timeout_s=60.0) as client:
        yield client


@pytest.fixture(scope="module")
def renderer(client, folder):
    with open_renderer(load_scene(folder / "scene.toml")) as renderer:
        yield renderer


@pytest.mark.parametrize("camera, state, options", [
    ("wide", STATE, {"products": ["range", "body_id"]}), ("wide", STATE, {"exposure_s": 0.02}),
    ("wide", MOVING, {"exposure_s": 0.1}), ("wide", MOVING, {}), ("colour", STATE, {}),
    ("colour", MOVING, {"exposure_s": 0.05, "products": ["facet_id"]})])
def test_the_server_sends_the_bytes_of_take_frame(client, renderer, camera, state, options):
    reply = client.render(state.to_dict(), camera, output="dn", seed=7, **options)
    capture = take_frame(renderer, state, camera, seed=7, **options)
    np.testing.assert_array_equal(reply.pixels, capture.frame.dn)
    assert reply.pixels.any() and reply.header["stages"] == capture.stages
    assert reply.header["exposure_s"] == capture.frame.exposure_s
    for name in options.get("products", ()):
        np.testing.assert_array_equal(reply.arrays[name], capture.products[name])
    assert ("poses" in capture.stages["motion_blur"]) == (state is MOVING)


def test_irradiance_comes_distorted_too(client, renderer):
    reply = client.render(STATE.to_dict(), "wide")
    np.testing.assert_array_equal(reply.pixels, draw_still(renderer, STATE, "wide").irradiance_W_m2)
    assert reply.header["stages"]["distortion"].startswith("k1 -0.2, p1 0.001; drawn behind the lens")


def test_hello_tells_distortion_mosaic_and_stars(client):
    told = client.hello()
    wide, colour = told["cameras"]
    assert wide["distortion"] == {"k1": -0.2, "k2": 0.0, "k3": 0.0, "k4": 0.0, "k5": 0.0, "k6": 0.0, "p1": 0.001,
                                  "p2": 0.0}
    assert colour["distortion"] is None and colour["mosaic"] == ["RG", "GB"] and wide["mosaic"] is None
    assert told["stars"] == {"magnitude_limit": 5.0, "year": 2031.5, "aberration": False}


def test_the_memory_of_the_exposure_is_the_clients(client):
    """From a hundred times too long: the next exposure is told, and sent back; the loop ends within 5 % of "auto"."""
    told = client.render(STATE.to_dict(), "wide", output="dn", exposure_s="auto").header["exposure_s"]
    exposure_s = 100.0 * told
    for seed in range(6):
        reply = client.render(STATE.to_dict(), "wide", output="dn", exposure_s=exposure_s, seed=seed)
        exposure_s = reply.header["next_exposure_s"]
        assert exposure_s >= reply.header["exposure_s"] / 8.0 * (1.0 - 1e-9)
    np.testing.assert_allclose(exposure_s, told, rtol=0.05)
    assert "next_exposure_s" not in client.render(STATE.to_dict(), "colour", output="dn").header


@pytest.mark.parametrize("scene, path", [
    (table({"distortion": {"k9": 0.1}}), "scene.cameras[0].distortion.k9"),
    (table({"distortion": {"k1": -0.9}}), "scene.cameras[0].distortion"),
    (table(stars={"magnitude_limit": 6.0, "epoch": 2000.0}), "scene.stars.epoch"),
    (table({"model": {"pattern": ["RG"], "optics": {"R": OPTICS}, "detector": READ, "exposure_s": 1.0}}),
     "scene.cameras[0].model.optics.G"),
    ({"bodies": BODIES, "cameras": [{"name": "c", "width_px": 16384, "height_px": 4096, "focal_length_px": 1e5,
                                     "distortion": {"k1": -0.1}}]}, "scene.cameras[0].distortion")])
def test_bad_scenes_are_refused_by_field_and_the_old_one_serves_on(client, scene, path):
    with pytest.raises(ServerError) as error:
        client.load_scene(scene)
    assert error.value.code == "config" and error.value.path == path
    assert client.hello()["cameras"][0]["name"] == "wide"


def test_bad_rates_are_refused_by_field(client):
    table = MOVING.to_dict()
    table["spacecraft"]["angular_velocity_rad_s"] = [1e5, 0.0, 0.0]
    with pytest.raises(ServerError) as error:
        client.render(table, "wide", output="dn")
    assert error.value.path == "state.spacecraft.angular_velocity_rad_s"


def test_the_example_is_a_frame_with_stars_and_a_dark_body_before_them(tmp_path):
    """As its first lines say, without a warning. Inside the body's dark outline no star shines."""
    arguments = ["render", str(EXAMPLES / "starry_flyby.toml"), "--state", str(EXAMPLES / "starry_flyby.json"),
                 "--output", "dn", "--out", "frame.npy"]
    made = run(*arguments, cwd=tmp_path)
    assert made.returncode == 0 and not made.stderr, made.stderr
    dn = np.load(tmp_path / "frame.npy")
    assert dn.shape == (768, 1024) and dn.dtype == np.uint16 and dn.max() > 3900
    # Points of light: in a window on the sky, and in one of the same size on the body's night side, but for hot pixels.
    points = dn - cv2.medianBlur(dn, 5).astype(np.int32) > 40
    sensor = load_scene(EXAMPLES / "starry_flyby.toml").cameras[0].own_model.detector
    points[sensor.fixed_pattern(dn.shape).dark_electrons_per_s > sensor.dark_current_electrons_per_s] = False
    assert points[600:650, 500:550].any() and not points[410:460, 270:320].any()


def test_a_picture_of_an_exposure_and_a_seed_that_are_asked_for(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)

    def drawn(seed, exposure_s):
        assert glrender(["render", str(tmp_path / "scene.toml"), "--output", "dn", "--exposure-s", str(exposure_s),
                         "--seed", str(seed), "--out", str(tmp_path / "frame.npy")]) == 0
        return np.load(tmp_path / "frame.npy").astype(float)

    first, again, other, longer = drawn(3, 4e-9), drawn(3, 4e-9), drawn(4, 4e-9), drawn(3, 8e-9)
    np.testing.assert_array_equal(first, again)
    # Frames differ by the noise of the signal and of reading, 10 e- at 0.1 DN, and by rounding; a well has 3000 DN.
    lit = (first > 200.0) & (longer < 2800.0)
    assert lit.sum() > 100
    noise = np.sqrt(0.1 * first[lit].mean() + (0.1 * 10.0) ** 2 + 1.0 / 12.0)
    np.testing.assert_allclose(np.std((first - other)[lit]) / np.sqrt(2.0), noise, rtol=0.2)
    np.testing.assert_allclose(longer[lit].sum() / first[lit].sum(), 2.0, rtol=0.02)
    assert glrender(["render", str(tmp_path / "scene.toml"), "--output", "dn", "--exposure-s", "auto",
                     "--out", str(tmp_path / "frame.png")]) == 0
    picture = cv2.imread(str(tmp_path / "frame.png"), cv2.IMREAD_GRAYSCALE)
    assert np.median(picture[lit]) > 150 and np.median(picture[first < 20.0]) < 60


def test_the_command_line_refuses_what_is_no_exposure(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(SCENE)
    assert glrender(["render", str(tmp_path / "scene.toml"), "--output", "dn", "--exposure-s", "long",
                     "--out", str(tmp_path / "f.png")]) == 1
    assert "exposure-s: must be a number of seconds, or auto, got 'long'" in capsys.readouterr().err
