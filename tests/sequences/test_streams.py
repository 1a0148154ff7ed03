"""Output "compressed" as files: streams of `render` and `sequence` with their headers, resumed, shown, refused."""

from __future__ import annotations

import json
import re
import tomllib

import cv2
import numpy as np
import pytest
import serving
from glrender import ConfigError, PinholeCamera, Scene, take_frame
from glrender.renderer import open_renderer
from glrender.scenario import load_scenario
from glrender.sequences.dataset.dataset import DataSet
from glrender.sequences.formats import FrameFile, range_type, write
from glrender.sequences.options import FrameOptions
from glrender.sequences.read import read_header, read_image
from glrender.sequences.sequence import FrameSequence
from glrender_camera.compression import CODECS, Compression, decode
from glrender_camera.pattern import seed_of
from glrender_cli.__main__ import main
from missing import needed_module

CODEC = {"codec": "jpeg_ls", "max_error_DN": 3}
STATES = """
[sun]
r_m = [1.5e11, 0.0, 0.0]
[trajectory]
kind = "at_rest"
r_m = [1500.0, 0.0, 500.0]
[time]
times_s = [0.0, 1.0, 2.0]
"""


def scene_text(codec='codec = "jpeg_ls"\nmax_error_DN = 3'):
    """The room's scene, not saturated and with an offset, its first camera with compression; the second has none."""
    model = serving.SCENE.replace("exposure_s = 0.01", "exposure_s = 3e-7").replace(
        "read_noise_electrons = 10.0 }", "read_noise_electrons = 10.0, offset_DN = 20.0 }")
    bare = '[[cameras]]\nname = "bare"'
    return model.replace(bare, f"[cameras.model.compression]\n{codec}\n{bare}")


@pytest.fixture
def scenario(tmp_path):
    (tmp_path / "s.toml").write_text(scene_text() + STATES + '[output]\noutput = "compressed"\nseed = 3\n')
    return tmp_path / "s.toml"


def sequence(folder, scenario, **changes):
    made = load_scenario(scenario)
    options = FrameOptions(**{"camera": "navcam", "output": "compressed", "seed": 3, **changes})
    return FrameSequence(scene=made.scene, states=list(made.iter_states()), folder=folder, options=options)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "contact_sheet.png"}


def test_a_sequences_file_is_the_stream_that_the_camera_sends(scenario, tmp_path, capsys):
    """The very bytes of `take_frame`; what a decoder needs stands in the manifest, the rest in the frame's header."""
    assert main(["check", str(scenario)]) == 0
    told = capsys.readouterr().out
    assert "output: stream of compressed DN, camera navcam, seed 3" in told
    assert " a pixel, detector, jpeg_ls\n" in told and " a pixel, no detector\n" in told
    out = tmp_path / "out"
    assert main(["sequence", str(scenario), "--out", str(out), "--processes", "1"]) == 0
    names = [f"frame_{k:05d}.jpeg_ls{end}" for k in range(3) for end in ("", ".json")]
    assert sorted(path.name for path in out.iterdir()) == ["contact_sheet.png", *names, "manifest.json"]
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["decoding"] == {"codec": "jpeg_ls", "shape": [64, 96], "bit_depth": 12}
    made = sequence(out, scenario)
    with open_renderer(made.scene, "auto") as renderer:
        frame = take_frame(renderer, made.states[1], "navcam", seed=seed_of(3, 1)).frame
    stream = (out / "frame_00001.jpeg_ls").read_bytes()
    assert stream == frame.stream and 0 < len(stream) < 2 * frame.dn.size
    np.testing.assert_array_equal(decode(stream, **manifest["decoding"]), frame.dn)
    np.testing.assert_array_equal(read_image(out / "frame_00001.jpeg_ls"), frame.dn)
    header = read_header(out / "frame_00001.jpeg_ls")
    assert header["index"] == 1 and header["seed"] == seed_of(3, 1) and header["unit"] == "DN"
    assert header["camera"]["compression"] == CODEC and header["exposure_s"] == 3e-7


def test_it_goes_on_where_it_was_stopped_and_shows_what_is_decoded(scenario, tmp_path, capsys):
    """A header alone is no frame: its writer was killed before the stream was there."""
    out, whole = tmp_path / "out", tmp_path / "whole"
    command = ["sequence", str(scenario), "--processes", "1", "--out"]
    assert main([*command, str(out)]) == 0 and main([*command, str(whole)]) == 0
    (out / "frame_00001.jpeg_ls").unlink()
    (out / "contact_sheet.png").unlink()
    capsys.readouterr()
    assert sequence(out, scenario).missing() == [1]
    assert main([*command, str(out), "--video", str(tmp_path / "v.mp4")]) == 0
    assert "3 frames, 1 drawn now" in capsys.readouterr().out and (tmp_path / "v.mp4").exists()
    assert contents(out) == contents(whole)
    sheet = cv2.imread(str(out / "contact_sheet.png"), cv2.IMREAD_GRAYSCALE)[6:153, 6:226]
    dn = cv2.resize(read_image(out / "frame_00000.jpeg_ls").astype(np.float32), (220, 147),
                    interpolation=cv2.INTER_AREA)
    assert np.median(sheet[dn < 25.0]) <= 40 < 200 <= np.median(sheet[dn > 0.6 * dn.max()])
    assert main([*command, str(out), "--output", "dn"]) == 1
    assert "options.output" in capsys.readouterr().err


def test_the_command_overrides_a_table_of_another_output(scenario, tmp_path, capsys):
    """Each of the errors on the way names the argument that helps."""
    other = tmp_path / "other.toml"
    table = '[output]\noutput = "dn"\nformat = "npz"\nproducts = ["range"]\nseed = 3\n'
    other.write_text(scene_text() + STATES + table)
    command = ["sequence", str(other), "--out", str(tmp_path / "out"), "--processes", "1", "--output", "compressed"]
    assert main(command) == 1 and "(--format stream)" in capsys.readouterr().err
    assert main([*command, "--format", "stream"]) == 1 and "(--products without a name)" in capsys.readouterr().err
    assert main([*command, "--format", "stream", "--products"]) == 0
    list(sequence(tmp_path / "whole", scenario).draw(1))
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_a_stream_that_was_spoilt_is_told_with_its_file(scenario, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["sequence", str(scenario), "--processes", "1", "--out", str(out)]
    assert main(command) == 0
    file = out / "frame_00002.jpeg_ls"
    file.write_bytes(file.read_bytes()[:-5])
    assert main(command) == 1
    told = capsys.readouterr().err
    assert f"{file}.stream: must be a whole stream of jpeg_ls" in told and "remove the frame's files" in told
    file.unlink()
    assert main(command) == 0


@pytest.mark.parametrize("codec", CODECS)
def test_render_writes_the_stream_and_its_header(tmp_path, monkeypatch, capsys, codec):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(scene_text(f'codec = "{codec}"'))
    assert main(["render", "scene.toml", "--output", "compressed", "--seed", "5", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["file"] == f"frame.{codec}" and said["compressed_bytes"] == (tmp_path / f"frame.{codec}").stat().st_size
    assert said["compression"].startswith(f"{codec}, ") and said["bits_per_pixel"] < 12.0
    assert main(["render", "scene.toml", "--output", "dn", "--seed", "5", "--out", "frame.npz"]) == 0
    assert f", {codec}, " in capsys.readouterr().out
    with np.load(tmp_path / "frame.npz") as stored:
        np.testing.assert_array_equal(read_image(tmp_path / f"frame.{codec}"), stored["image"])
        header = json.loads(str(stored["header"]))
    assert read_header(tmp_path / f"frame.{codec}") == header


@pytest.mark.parametrize("arguments, message", [
    (["--camera", "bare"], "output: camera 'bare' has no optics and detector, got 'compressed'"),
    (["--out", "frame.png"], "--out: must have an ending of its own with --output compressed.*ask for --output dn"),
    (["--out", "frame.NPZ"], "--out: must have an ending of its own"),
    (["--out", "no/frame.jpeg_ls"], "--out: must be in a folder that is there"),
    (["--raw"], "--raw: is of pixels"), (["--white", "3"], "--white: is of pixels"),
    (["--white", "0"], "--white: is of pixels"), (["--stretch", "gamma"], "--stretch: is of pixels"),
    (["--out", "frame.jpeg_xl"], "--out: must end in .jpeg_ls, the codec of camera 'navcam'.*name it frame.jpeg_ls"),
    (["--out", "frame.JPEG_2000"], "--out: must end in .jpeg_ls"),
    (["--products", "range"], "products: must be none with format stream.*or ask for output 'dn'")])
def test_render_refuses_what_a_stream_has_not(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(scene_text())
    assert main(["render", "scene.toml", "--output", "compressed", *arguments]) == 1
    told = capsys.readouterr().err.replace("\n", " ")
    assert re.search(message, told), told


@pytest.mark.parametrize("arguments", [["frame.npy", "--stretch", "log"], ["frame.npz", "--white", "3"],
                                       ["frame.png", "--output", "dn", "--raw", "--stretch", "log"]])
def test_render_refuses_a_stretch_of_numbers(tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(scene_text())
    assert main(["render", "scene.toml", "--out", *arguments]) == 1
    assert "is of a picture for the eye, and the file has the numbers" in capsys.readouterr().err


@pytest.mark.parametrize("changes, message", [
    ({"format": "npz"}, "format: must be stream with output 'compressed', got 'npz'; leave it out \\(--format"),
    ({"output": "dn", "format": "stream"}, "format: goes with output 'compressed' alone, got 'stream'"),
    ({"products": ("range",)}, "products: must be none with format stream"),
    ({"products": ("irradiance",)}, "products: must not have 'irradiance' with output 'compressed'"),
    ({"camera": "bare"}, "output: camera 'bare' has no optics and detector")])
def test_options_that_a_stream_has_not(scenario, tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message):
        sequence(tmp_path / "out", scenario, **changes)


def test_a_camera_without_compression_and_a_data_set_are_refused(scenario, tmp_path):
    table = tomllib.loads(scene_text())
    del table["cameras"][0]["model"]["compression"]
    made = sequence(tmp_path / "out", scenario)
    with pytest.raises(ConfigError, match="output: camera 'navcam' has no compression, got 'compressed'; give its "
                                          "model `compression = .*, or ask for 'dn'"):
        FrameSequence(scene=Scene.from_dict(table), states=made.states, folder=tmp_path, options=made.options)
    with pytest.raises(ConfigError, match="output: must be 'irradiance' or 'dn' in a data set.*ask for 'dn'"):
        DataSet(scene=made.scene, states=made.states, folder=tmp_path / "set", options=made.options)


def test_a_frame_as_npz_takes_a_tenth_of_its_numbers(tmp_path):
    """Of a round body 2 km away, its ranges of the type that files have; equal frames are equal bytes."""
    y, x = np.mgrid[:256, :256]
    on_body = np.hypot(x - 128, y - 128) < 60
    rng = np.random.default_rng(0)
    pixels = np.where(on_body, 800.0 + 100.0 * rng.normal(size=x.shape), 48.0).astype(np.uint16)
    for name in ("a", "b"):
        write(tmp_path / f"{name}.npz", FrameFile(pixels=pixels, unit="DN", header={}, products={
            "range": np.where(on_body, 2000.0 - np.sqrt(np.maximum(60.0**2 - (x - 128) ** 2 - (y - 128) ** 2, 0.0)),
                              np.nan).astype(range_type(camera(5000.0)))}))
    assert (tmp_path / "a.npz").stat().st_size < 0.1 * (2 + 8) * x.size
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def camera(focal_length_px):
    return PinholeCamera(name="c", width_px=64, height_px=64, focal_length_px=focal_length_px)


@pytest.mark.parametrize("focal_length_px", np.geomspace(1e2, 1e9, 15))
def test_ranges_of_files_are_as_fine_as_a_tenth_of_a_pixels_footprint(focal_length_px):
    """At any range; and they are float32 wherever that is as fine: its steps are 2**-24 to 2**-23 of a number."""
    ranges_m = np.geomspace(1e-2, 1e12, 999)
    kind = range_type(camera(focal_length_px))
    assert (np.spacing(ranges_m.astype(kind)) <= 0.1 * ranges_m / focal_length_px).all()
    if kind is np.float64:
        assert (np.spacing(ranges_m.astype(np.float32)) > 0.1 * ranges_m / focal_length_px).any()


def stored_ranges(path):
    if path.suffix == ".npz":
        with np.load(path) as stored:
            return stored["range"]
    return needed_module("astropy.io.fits", "pip install 'glrender[fits]'").getdata(path, "RANGE")


@pytest.mark.parametrize("format", ["npz", "fits"])
def test_ranges_of_files_are_float32_but_of_a_camera_with_very_small_pixels(scenario, tmp_path, format):
    """From 300 000 km a pixel of the second sees 30 m, and a step of float32 is 32 m: 5 of them in 100 m of relief."""
    made = sequence(tmp_path / "out", scenario, output="dn", format=format, products=("range",))
    list(made.draw(1))
    distances = stored_ranges(made.path(0))
    assert distances.dtype.itemsize == 4
    # The body's surface: 100 m lobes about an origin 1581 m away.
    assert 1350.0 < np.nanmin(distances) < np.nanmax(distances) < 1650.0
    scenario.write_text(scene_text().replace("focal_length_px = 400.0", "focal_length_px = 1e7") + STATES.replace(
        "[1500.0, 0.0, 500.0]", "[3e8, 0.0, 0.0]"))
    far = sequence(tmp_path / "far", scenario, output="irradiance", format=format, products=("range",))
    list(far.draw(1))
    distances = stored_ranges(far.path(0))
    assert distances.dtype.itemsize == 8 and np.unique(distances[np.isfinite(distances)]).size > 10
    assert (np.abs(distances[np.isfinite(distances)] - 3e8) < 250.0).all()


def test_ranges_that_exr_is_too_coarse_for_are_refused(scenario, tmp_path):
    scenario.write_text(scene_text().replace("focal_length_px = 400.0", "focal_length_px = 1e7") + STATES)
    made = sequence(tmp_path / "exr", scenario, output="irradiance", format="exr", products=("range",))
    needed_module("OpenEXR", "pip install 'glrender[exr]'")
    with pytest.raises(ConfigError, match="exr holds float32, which is too coarse for this camera's range; use"):
        list(made.draw(1))


def test_a_frame_without_its_header_is_drawn_again(scenario, tmp_path):
    made = sequence(tmp_path / "out", scenario)
    list(made.draw(1))
    whole = contents(tmp_path / "out")
    (tmp_path / "out/frame_00001.jpeg_ls.json").unlink()
    assert made.missing() == [1] and list(made.draw(1)) == [1] and contents(tmp_path / "out") == whole


@pytest.mark.parametrize("header, message", [
    (None, "cannot be read as a frame"), ("", "cannot be read"), ('{"camera": {"na', "cannot be read"),
    ("[1]", "must have a header that is a table"), ("{}", "must have the detector and the compression of a camera"),
    *((json.dumps({"camera": table}), "must have the detector and the compression of a camera")
      for table in (None, "navcam", {}, {"compression": None}, {"compression": CODEC, "width_px": 9, "height_px": 9})),
    (json.dumps({"camera": {"compression": CODEC, "width_px": 9, "height_px": 9, "detector": {"bit_depth": 12}}}),
     r"shape: must be \(64, 96\), the stream's own")])
def test_a_header_that_is_missing_cut_or_of_another_camera_is_told(tmp_path, header, message):
    path = tmp_path / "frame.jpeg_ls"
    path.write_bytes(Compression(codec="jpeg_ls").encode(np.zeros((64, 96), np.uint16), 12))
    if header is not None:
        (tmp_path / "frame.jpeg_ls.json").write_text(header)
    with pytest.raises(ConfigError, match=f"frame.jpeg_ls.*{message}.*remove the frame's files, and draw it"):
        read_image(path)


@pytest.mark.parametrize("ending", ["npz", "png", "fits", "exr", "jpeg_xl"])
def test_a_file_that_is_spoilt_or_missing_is_told_by_its_name(tmp_path, ending):
    path = tmp_path / f"frame.{ending}"
    for content in (None, b"", b"no frame"):
        if content is not None:
            path.write_bytes(content)
        for read in (read_image, read_header):
            with pytest.raises(ConfigError, match=f"frame.{ending}.*: cannot be read as a frame"):
                read(path)
