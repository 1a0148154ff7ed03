"""The table [output] of a scenario file, options that override it, and videos."""

from __future__ import annotations

import json
import resource
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
import serving
from glrender import ConfigError, PinholeCamera, Pose, State, load_scene
from glrender.sequences.contact_sheet import contact_sheet
from glrender.sequences.formats import FORMATS, FrameFile, write
from glrender.sequences.header import camera_table
from glrender.sequences.options import options_of
from glrender.sequences.read import read_image
from glrender.sequences.video import write_video
from glrender_camera.pattern import seed_of
from glrender_cli.__main__ import main
from missing import needed_module

SCENARIO = """
[sun]
r_m = [1.5e11, 0.0, 0.0]
[trajectory]
kind = "at_rest"
r_m = [2000.0, 0.0, 500.0]
[time]
times_s = [0.0, 1.0]
[output]
{}
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(serving.SCENE)
    return load_scene(path)


def scenario(folder, output):
    (folder / "s.toml").write_text(serving.SCENE + SCENARIO.format(output))
    return str(folder / "s.toml")


def test_the_table_gives_the_options_and_what_is_asked_overrides_it(scene):
    table = {"camera": "navcam", "output": "dn", "format": "npz", "products": ["range", "body_id"], "labels": True,
             "seed": 3, "exposure_s": 0.02, "max_error": 0.1}
    made = options_of(scene, table)
    assert (made.camera, made.output, made.format, made.products) == ("navcam", "dn", "npz", ("range", "body_id"))
    assert (made.has_labels, made.seed, made.exposure_s, made.max_error) == (True, 3, 0.02, 0.1)
    assert made.text == ("npz of DN, camera navcam, products range, body_id, labels, seed 3, exposure 0.02 s, "
                         "max_error 0.1")
    asked = options_of(scene, table, {"seed": 9, "labels": False, "format": None, "exposure_s": "auto"})
    assert (asked.seed, asked.has_labels, asked.format, asked.exposure_s) == (9, False, "npz", "auto")
    assert options_of(scene, {}).text == f"fits of W/m2, camera {scene.cameras[0].name}"


@pytest.mark.parametrize("output, message", [
    ("formt = 'npz'", "output.formt: unknown key; did you mean 'format'? known keys are camera, exposure_s, format, "
                      "labels, max_error, output, products, seed"),
    ("exposure = 0.1", "output.exposure: unknown key; did you mean 'exposure_s'?"),
    ("format = 'jpg'", "output.format: must be one of fits, npz, png, exr, got 'jpg'"),
    ("format = 'png'", "output.format: png holds digital numbers alone, got 'W/m2'; use fits, npz or exr, or"),
    ("output = 'frames'", "output.output: must be one of 'irradiance', 'dn', 'compressed', got 'frames'"),
    ("output = 'dn'\ncamera = 'bare'", "output.output: camera 'bare' has no optics and detector, got 'dn'"),
    ("camera = 'wide'", "output.camera: unknown camera, got 'wide'"),
    ("products = ['rnge']", "output.products[0]: must be one of irradiance, range"),
    ("products = 'range'", "output.products: must be a list of names, got 'range'"),
    ("labels = 1", "output.labels: must be true or false, got 1"),
    ("seed = -1", "output.seed: must be an integer between 0 and"),
    ("exposure_s = 0.1", "output.exposure_s: goes with output 'dn' or 'compressed' alone, got 0.1"),
    ("output = 'dn'\nexposure_s = -0.1", "output.exposure_s: must be > 0, got -0.1"),
    ("max_error = 0", "output.max_error: must be > 0 and <= 1, got 0"),
])
def test_check_tells_what_is_wrong_with_the_table(tmp_path, capsys, output, message):
    assert main(["check", scenario(tmp_path, output)]) == 1
    assert message in capsys.readouterr().err


def test_a_command_draws_what_the_table_asks_for(tmp_path, capsys):
    """Two frames of NPZ with a product, the seed overridden, and a video that is there after a second sitting too.

    And an OEM, which is not written over if it is another.
    """
    file = scenario(tmp_path, "camera = 'navcam'\noutput = 'dn'\nformat = 'npz'\nproducts = ['range']\nseed = 5")
    assert main(["check", file]) == 0
    assert "output: npz of DN, camera navcam, products range, seed 5, exposure the camera's" in capsys.readouterr().out
    video = tmp_path / "v.mp4"
    Path(file).write_text(Path(file).read_text().replace("[time]", '[time]\nstart_tdb = "2029-02-13T12:00:00"'))
    other = ["--spacecraft", "probe", "--with", "oem"]
    command = ["sequence", file, *other, "--out", str(tmp_path / "out"), "--seed", "6", "--processes", "1",
               "--video", str(video)]
    assert main(command) == 0 and "with frames.oem" in capsys.readouterr().out
    oem = tmp_path / "out" / "frames.oem"
    assert "OBJECT_NAME = PROBE" in oem.read_text()
    with np.load(tmp_path / "out" / "frame_00001.npz") as stored:
        assert stored["image"].dtype.kind == "u" and "range" in stored
        assert json.loads(str(stored["header"]))["seed"] == seed_of(6, 1)
    first = frames_of(video)
    assert len(first) == 2
    video.unlink()
    assert main(command) == 0 and "2 frames, 0 drawn now" in capsys.readouterr().out
    np.testing.assert_array_equal(frames_of(video), first)
    assert main([*command[:-1], str(tmp_path / "v.avi")]) == 1 and "video: must end in .mp4" in capsys.readouterr().err
    oem.write_text("another's")
    assert main(command) == 1 and f"--with: must not write over a file with other contents, got '{oem}'" in (
        capsys.readouterr().err)
    assert main([*command, "--write-states", str(tmp_path / "states")]) == 1
    assert main(["sequence", file, "--out", str(tmp_path / "out"), "--ids", "probe=-5"]) == 1
    text = capsys.readouterr().err
    assert "--with: has no effect here" in text and "--ids: has no effect here" in text
    assert main([*command, "--with", "pds4"]) == 1 and "must be one of 'oem', 'aem'" in capsys.readouterr().err
    for word in ("probe", "probe=--5"):
        assert main([*command, "--ids", word]) == 1 and "--ids: must be NAME=NUMBER" in capsys.readouterr().err
    assert main([*command, "--ids", "probe=-5", "probe=-6"]) == 1
    assert "--ids: must name 'probe' once, got 'probe=-6'" in capsys.readouterr().err


def frames_of(path):
    reader, found = cv2.VideoCapture(str(path)), []
    while (pair := reader.read())[0]:
        found.append(pair[1][..., 0])
    return np.array(found)


@pytest.mark.parametrize("height, width", [(64, 96), (33, 51), (16, 17)])
def test_a_video_has_one_scale_for_all_frames(tmp_path, height, width):
    """Discs of irradiance that double from frame to frame: levels by gamma 2.2, to 3 of 255 after compression."""
    y, x = np.mgrid[:height, :width]
    disc = np.hypot(y - height / 2, x - width / 2) < height / 3
    for k in range(6):
        np.savez(tmp_path / f"{k}.npz", image=(1e-9 * 2.0**k * disc).astype(np.float32))
    write_video(tmp_path / "v.mp4", [tmp_path / f"{k}.npz" for k in range(6)], rate_hz=10.0)
    found = frames_of(tmp_path / "v.mp4")
    assert found.shape == (6, height + height % 2, width + width % 2)
    middle = found[:, height // 2 - 2:height // 2 + 2, width // 2 - 2:width // 2 + 2].mean(axis=(1, 2))
    np.testing.assert_allclose(middle, 255.0 * 2.0 ** (np.arange(-5, 1) / 2.2), atol=4.0)
    assert found[:, 0, 0].max() <= 4
    assert list(tmp_path.glob(".*part*")) == []


@pytest.mark.parametrize("format", FORMATS)
def test_a_small_body_at_an_offset_is_bright_on_a_dark_sky(tmp_path, format):
    """Sky of 200 DN, a body of 16 px of 3000 DN: in contact sheet and video, whatever the frames' format."""
    needed_module({"fits": "astropy", "exr": "OpenEXR"}.get(format, "numpy"), f"pip install 'glrender[{format}]'")
    image = np.random.default_rng(0).normal(200.0, 3.0, (220, 220))
    image[100:104, 60:64] = 3000.0
    camera = PinholeCamera(name="c", width_px=220, height_px=220, focal_length_px=300.0)
    state = State(r_sun_inertial_m=[1e11, 0.0, 0.0], spacecraft=Pose(r_inertial_m=[0.0, 0.0, 0.0]), bodies={})
    header = {"glrender": "1", "index": 0, "date_tdb": None, "inertial_axes": "unknown", "state": state.to_dict(),
              "unit": "DN", "exposure_s": None, "camera": camera_table(camera),
              "plan": {"asked": {}, "max_error": 0.1, "predicted_error": 0.1}}
    path = tmp_path / f"0.{format}"
    write(path, FrameFile(pixels=np.rint(image).astype(np.uint16), unit="DN", products={}, header=header))
    write_video(tmp_path / "v.mp4", [path])
    contact_sheet(tmp_path / "s.png", [("0", read_image(path))])
    sheet = cv2.imread(str(tmp_path / "s.png"), cv2.IMREAD_GRAYSCALE)[6:226, 6:226]
    for shown in (frames_of(tmp_path / "v.mp4")[0], sheet):
        assert np.median(shown) < 30.0 and shown[101:103, 61:63].min() > 170.0


def test_a_dark_sequence_gives_a_dark_video(tmp_path):
    np.savez(tmp_path / "0.npz", image=np.zeros((32, 32), np.float32))
    write_video(tmp_path / "v.mp4", [tmp_path / "0.npz"])
    assert frames_of(tmp_path / "v.mp4").max() <= 2
    for name, rate_hz, message in (("v.mp4", 0.0, "video_rate_hz: must be between 1 and 240"),
                                   ("no/v.mp4", 25.0, "video: must be in a folder that is there"),
                                   ("v.webm", 25.0, "video: must end in .mp4")):
        with pytest.raises(ConfigError, match=message):
            write_video(tmp_path / name, [tmp_path / "0.npz"], rate_hz=rate_hz)


@contextmanager
def _room_for(n_bytes):
    """No file of this process grows beyond it, as where a disk is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_no_part_of_a_frame_or_video_and_names_the_file(tmp_path):
    frame = FrameFile(pixels=np.random.default_rng(1).integers(0, 4095, (128, 128)).astype(np.uint16), unit="DN",
                      products={}, header={})
    needed_module("OpenEXR", "pip install 'glrender[exr]'")
    for name in ("f.npz", "f.png", "f.exr"):
        with _room_for(4096), pytest.raises(OSError, match=name):
            write(tmp_path / name, frame)
    frames = [tmp_path / f"{k}.png" for k in range(3)]
    for file in frames:
        write(file, frame)
    with _room_for(4096), pytest.raises(OSError, match="0 of 3 frames could be written: is the disk full"):
        write_video(tmp_path / "v.mp4", frames)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["0.png", "1.png", "2.png"]
