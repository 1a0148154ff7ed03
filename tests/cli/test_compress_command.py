"""`glrender compress`: rows of each codec for a frame, against what is put into the frame and decoded elsewhere."""

from __future__ import annotations

import json
import sys

import cv2
import numpy as np
import pytest
from glrender import PinholeCamera, Pose, State
from glrender.sequences.formats import FrameFile, write
from glrender.sequences.header import camera_table
from glrender_camera.codec_table import COMPRESSIONS, codec_rows
from glrender_camera.compression import CODECS, Compression
from glrender_cli.__main__ import main
from missing import needed_module
from PIL import Image

DETECTOR = {"gain_DN_per_electron": 0.1, "offset_DN": 48.0, "bit_depth": 12, "read_noise_electrons": 10.0,
            "full_well_electrons": 40000.0}
HEIGHT, WIDTH = 200, 240


def frame_dn():
    """A ball with craters on a sky at the offset, shot noise and read noise as the detector tells."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    signal = np.where(np.hypot(x - 110, y - 90) < 70, 1.2e4, 0.0)
    for _ in range(150):
        at_x, at_y, radius = rng.uniform(45, 175), rng.uniform(25, 155), rng.uniform(2.0, 7.0)
        signal = signal * (1.0 - 0.7 * np.exp(-0.5 * ((x - at_x) ** 2 + (y - at_y) ** 2) / radius**2))
    electrons = rng.poisson(signal) + rng.normal(0.0, 10.0, signal.shape)
    return np.clip(np.rint(48.0 + 0.1 * electrons), 0, 4095).astype(np.uint16), signal


def header(compression=None):
    """As a sequence writes it, but for what no reader of the frame's numbers needs."""
    camera = PinholeCamera(name="c", width_px=WIDTH, height_px=HEIGHT, focal_length_px=300.0)
    state = State(r_sun_inertial_m=[1e11, 0.0, 0.0], spacecraft=Pose(r_inertial_m=[0.0, 0.0, 0.0]), bodies={})
    return {"glrender": "1", "index": 0, "date_tdb": None, "inertial_axes": "unknown", "state": state.to_dict(),
            "unit": "DN", "exposure_s": None, "plan": {"asked": {}, "max_error": 0.1, "predicted_error": 0.1},
            "camera": {**camera_table(camera), "detector": DETECTOR, "compression": compression}}


def small_frame(path, **of_header):
    """A part of the frame on which the whole table takes a second; as it is written, and its signal [e-]."""
    dn, signal = (each[20:100, 40:150] for each in frame_dn())
    write(path, FrameFile(pixels=dn, unit="DN", products={}, header=header(**of_header)))
    return dn, signal


@pytest.fixture(scope="module")
def rows():
    return list(codec_rows(frame_dn()[0], 12, noise_DN=4.0, offset_DN=48.0))


def test_there_is_a_row_for_each_codec_and_loss(rows):
    assert [row.compression.to_dict() for row in rows] == list(COMPRESSIONS)
    assert {row.compression.codec for row in rows if len(row.compression.to_dict()) == 1} == set(CODECS)


def test_rows_without_loss_have_none(rows):
    for row in rows[:len(CODECS)]:
        assert row.psnr_db is None and (row.largest_error_DN, row.body_rms_DN, row.centre_px) == (0, 0.0, 0.0)
        assert row.features_kept == 1.0 and row.features_px == 0.0 and 1.0 < row.bits_per_pixel < 12.0


def test_bounds_rates_and_psnr_are_those_asked_for(rows):
    for row in rows[len(CODECS):]:
        asked = row.compression
        if asked.max_error_DN is not None:
            # Errors that are even between the bounds have an RMS of sqrt(n (n + 1) / 3).
            bound = asked.max_error_DN
            assert row.largest_error_DN == bound
            assert row.body_rms_DN == pytest.approx(np.sqrt(bound * (bound + 1) / 3.0), rel=0.15)
        if asked.share_of_noise is not None:
            assert 0.2 * 4.0 <= row.body_rms_DN <= 0.55 * 4.0
        if asked.rate_bpp is not None:
            assert row.bits_per_pixel == pytest.approx(asked.rate_bpp, rel=0.1)
        if asked.psnr_db is not None:
            assert row.psnr_db == pytest.approx(asked.psnr_db, abs=1.0)
        assert 0.0 < row.features_kept <= 1.0 and 0.0 <= row.features_px < 1.5 and 0.0 < row.centre_px < 0.2
        assert row.encode_s >= 0.0 and row.decode_s >= 0.0
    assert rows[4].bits_per_pixel > rows[5].bits_per_pixel > rows[6].bits_per_pixel
    assert rows[4].features_kept >= rows[6].features_kept


def test_numbers_are_those_of_another_decoder(rows):
    """JPEG 2000 at 1 bit/px, decoded by OpenCV; the centre by the light inside the ball."""
    dn, _ = frame_dn()
    row = next(row for row in rows if row.compression == Compression(codec="jpeg_2000", rate_bpp=1.0))
    stream = row.compression.encode(dn, 12)
    made = cv2.imdecode(np.frombuffer(stream[8:], np.uint8), cv2.IMREAD_UNCHANGED).astype(float)
    error = made - dn
    assert row.largest_error_DN == np.abs(error).max()
    assert row.psnr_db == pytest.approx(10.0 * np.log10(4095.0**2 / np.mean(error**2)), abs=1e-6)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    inside = np.hypot(x - 110, y - 90) < 68
    assert row.body_rms_DN == pytest.approx(np.sqrt(np.mean(error[inside] ** 2)), rel=0.1)
    centre = [np.array([np.sum(each * axis) for axis in (x, y)]) / np.sum(each)
              for each in (np.where(inside, made - 48.0, 0.0), np.where(inside, dn - 48.0, 0.0))]
    assert row.centre_px == pytest.approx(np.hypot(*(centre[0] - centre[1])), abs=0.01)


def test_features_that_move_are_measured():
    """A frame shifted by 0.5 px has features that moved by it."""
    from glrender_camera import codec_table
    dn, signal = frame_dn()
    clean = lambda shift: cv2.warpAffine(  # noqa: E731
        48.0 + 0.1 * signal, np.float64([[1, 0, shift], [0, 1, 0]]), (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)
    before, after = (codec_table._features(clean(shift), 48.0, 1250.0) for shift in (0.0, 0.5))
    kept, moved_px = codec_table._moved(before, after)
    assert kept > 0.5 and moved_px == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("format", ["npz", "fits", "png", "exr"])
def test_the_command_reads_what_we_write(tmp_path, capsys, format):
    needed_module({"fits": "astropy", "exr": "OpenEXR"}.get(format, "numpy"), f"pip install 'glrender[{format}]'")
    path = tmp_path / f"frame.{format}"
    dn, signal = small_frame(path)
    assert main(["compress", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    lossless, bounded, shared = told["rows"][0], *told["rows"][6:8]
    rate = 8.0 * len(Compression(codec="jpeg_ls").encode(dn, 12)) / dn.size
    assert told["bit_depth"] == 12 and (lossless["codec"], lossless["bits_per_pixel"]) == ("jpeg_ls", rate)
    assert lossless["psnr_db"] is None and bounded["max_error_DN"] == bounded["largest_error_DN"] == 10
    # Shot noise of the mean signal, the reading's 10 e-, and rounding.
    noise = np.sqrt(0.1**2 * (signal[signal > 100.0].mean() + 10.0**2) + 1.0 / 12.0)
    assert shared["share_of_noise"] == 0.5 and told["noise_DN"] == pytest.approx(noise, rel=0.02)
    assert main(["compress", str(path)]) == 0
    first, head, *lines = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{path}: 110 x 80, 12 bit, noise of the lit pixels") and head.startswith("codec")
    assert [line.split()[0] for line in lines] == [table["codec"] for table in COMPRESSIONS]
    assert "within 10 DN" in lines[6] and f"{bounded['bits_per_pixel']:.3f}" in lines[6]
    assert all(len(line) <= 120 for line in (head, *lines))


def test_a_frame_that_was_compressed_with_loss_is_warned_of(tmp_path, capsys):
    for compression, is_warned in (({"codec": "jpeg_ls", "max_error_DN": 3}, True), ({"codec": "jpeg_ls"}, False)):
        small_frame(tmp_path / "frame.npz", compression=compression)
        assert main(["compress", str(tmp_path / "frame.npz")]) == 0
        assert ("decoded from jpeg_ls with loss" in capsys.readouterr().err) == is_warned


def test_a_frame_without_a_header_needs_its_depth(tmp_path, capsys):
    path = tmp_path / "real.png"
    Image.fromarray(np.ascontiguousarray(frame_dn()[0][20:100, 40:150])).save(path)
    assert main(["compress", str(path)]) == 1
    assert "--bit-depth: missing: the frame has no header of a camera" in capsys.readouterr().err
    assert main(["compress", str(path), "--bit-depth", "12", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["noise_DN"] is None and len(told["rows"]) == len(COMPRESSIONS) - 1
    assert not [row for row in told["rows"] if "share_of_noise" in row], "a share of a noise that nobody knows"
    assert main(["compress", str(path), "--bit-depth", "8"]) == 1
    assert "--bit-depth: must hold the frame's largest number" in capsys.readouterr().err


def test_a_dark_frame_has_no_body():
    (row,) = codec_rows(np.full((40, 50), 48, np.uint16), 12, 1.0, 48.0, [{"codec": "jpeg_ls"}])
    assert row.body_rms_DN is row.centre_px is row.features_kept is row.features_px is None


def test_what_is_no_frame_of_digital_numbers_is_refused(tmp_path, capsys):
    np.savez(tmp_path / "light.npz", image=np.ones((8, 8), np.float32))
    np.savez(tmp_path / "other.npz", points=np.ones((8, 8)))
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 no more")
    (tmp_path / "broken.fits").write_bytes(b"SIMPLE")
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / "colour.png")
    for name, message in (("none.npz", "is no file"), ("light.npz", "must hold digital numbers, got 'float32 of shape"),
                          ("other.npz", "cannot be read as a frame"), ("broken.npz", "cannot be read as a frame"),
                          ("broken.fits", "cannot be read as a frame"), ("colour.png", "must hold digital numbers")):
        assert main(["compress", str(tmp_path / name)]) == 1, name
        assert message in capsys.readouterr().err, name
    (tmp_path / "scene.toml").write_text("")
    assert main(["compress", str(tmp_path / "scene.toml")]) == 1
    assert "must be a frame's file" in capsys.readouterr().err


@pytest.mark.parametrize("camera, message", [
    ("navcam", "header.camera: must be a table, got 'navcam'"), ({"detector": [1]}, "header.detector: must be a table"),
    ({"detector": DETECTOR, "compression": "jpeg_ls"}, "header.compression: must be a table"),
    *(({"detector": {**DETECTOR, name: value}}, f"header.camera.detector.{name}: must be")
      for name in ("offset_DN", "gain_DN_per_electron", "read_noise_electrons") for value in (None, "much")),
    ({"detector": {**DETECTOR, "gain_DN_per_electron": 0.0}}, "gain_DN_per_electron: must be > 0"),
    ({"detector": {**DETECTOR, "bit_depth": "12"}}, "--bit-depth: must be an integer")])
def test_odd_headers_are_refused_by_field(tmp_path, capsys, camera, message):
    path = tmp_path / "frame.npz"
    write(path, FrameFile(pixels=frame_dn()[0][:40, :40], unit="DN", products={}, header={"camera": camera}))
    assert main(["compress", str(path)]) == 1
    assert message in capsys.readouterr().err


def test_a_loss_without_a_codecs_name_is_warned_of_too(tmp_path, capsys):
    path = tmp_path / "frame.npz"
    write(path, FrameFile(pixels=frame_dn()[0][:40, :40], unit="DN", products={}, header={
        "camera": {"detector": DETECTOR, "compression": {"rate_bpp": 1.0, "of": "nobody"}}}))
    assert main(["compress", str(path)]) == 0 and "with loss" in capsys.readouterr().err


def test_headers_that_are_no_tables_and_frames_of_no_pixel_are_refused(tmp_path, capsys):
    for name, arrays, message in (
            ("a", {"image": np.zeros((0, 4), np.uint16)}, "must hold digital numbers, got 'uint16 of shape (0, 4)'"),
            ("b", {"image": np.zeros((8, 8), np.uint16), "header": "[1]"}, "must have a header that is a table"),
            ("c", {"image": np.zeros((8, 8), np.uint16), "header": "{"}, "cannot be read as a frame")):
        np.savez(tmp_path / f"{name}.npz", **arrays)
        assert main(["compress", str(tmp_path / f"{name}.npz"), "--bit-depth", "12"]) == 1
        assert message in capsys.readouterr().err


def test_without_the_package_the_extra_is_named(tmp_path, monkeypatch, capsys):
    small_frame(tmp_path / "frame.npz")
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    assert main(["compress", str(tmp_path / "frame.npz")]) == 1
    assert "codec: needs imagecodecs" in capsys.readouterr().err
