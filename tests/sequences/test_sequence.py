"""Sequences: the same bytes by one process or several, in one go or in parts; files that other programs read."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import serving
import views
from glrender import Body, ConfigError, Scene, State, load_scene, open_renderer, take_frame
from glrender.brdf import Lambert
from glrender.sequences.formats import FORMATS, FrameFile, write
from glrender.sequences.read import read_image
from glrender.sequences.sequence import FrameOptions, FrameSequence, digest_of_scene
from glrender_camera.pattern import seed_of
from glrender_cli.__main__ import main
from missing import needed_module
from PIL import Image

EXAMPLES = Path(__file__).parents[2] / "examples"
STATES = [views.state(phase_deg=20.0 + 20.0 * k, range_m=2000.0 + 100.0 * k) for k in range(6)]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A scene file and a file of states."""
    folder = tmp_path_factory.mktemp("scene")
    (folder / "scene.toml").write_text(serving.SCENE)
    (folder / "states.jsonl").write_text("".join(json.dumps(state.to_dict()) + "\n" for state in STATES))
    return folder


@pytest.fixture(scope="module")
def scene(files):
    return load_scene(files / "scene.toml")


def sequence(scene, folder, **options):
    return FrameSequence(scene=scene, states=STATES, folder=folder, options=FrameOptions(
        **{"camera": "navcam", "output": "dn", "format": "npz", "seed": 7, **options}))


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.glob("frame_*")}


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """The folder of a sequence that one process drew in one go."""
    made = sequence(scene, tmp_path_factory.mktemp("whole"))
    assert sorted(made.draw(1)) == list(range(len(STATES))) and not made.missing()
    return made.folder


def test_a_frame_is_the_one_that_take_frame_gives(scene, whole):
    with open_renderer(scene) as renderer:
        for k in (0, 5):
            frame = take_frame(renderer, STATES[k], "navcam", seed=seed_of(7, k)).frame
            np.testing.assert_array_equal(read_image(whole / f"frame_{k:05d}.npz"), frame.dn)


@pytest.mark.slow
def test_two_processes_and_two_sittings_write_the_same_bytes(scene, whole, tmp_path):
    made = sequence(scene, tmp_path)
    for _ in zip(range(2), made.draw(2), strict=False):
        pass
    assert 2 <= len(STATES) - len(made.missing()) < len(STATES)
    (tmp_path / "frame_00003.npz").unlink(missing_ok=True)
    list(made.draw(2))
    assert contents(tmp_path) == contents(whole)


def test_a_command_that_is_killed_goes_on_where_it_was(files, whole, tmp_path):
    command = [sys.executable, "-m", "glrender_cli", "sequence", files / "scene.toml", "--states",
               files / "states.jsonl", "--out", tmp_path, "--output", "dn", "--format", "npz", "--seed", "7",
               "--camera", "navcam", "--processes", "1"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as first:
        deadline = time.monotonic() + 60.0
        while not contents(tmp_path) and time.monotonic() < deadline:
            time.sleep(0.002)
        first.send_signal(signal.SIGKILL)
    time.sleep(0.5)  # its process ends with it
    n_left = len(STATES) - len(contents(tmp_path))
    told = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert f"6 frames, {n_left} drawn now" in told.stdout
    assert contents(tmp_path) == contents(whole) and not list(tmp_path.glob("*.part.npz"))
    assert Image.open(tmp_path / "contact_sheet.png").size[0] > 500


@pytest.mark.parametrize("format", FORMATS)
def test_every_format_gives_the_pixels_back(scene, whole, tmp_path, format):
    needed_module({"fits": "astropy", "exr": "OpenEXR"}.get(format, "numpy"), f"pip install 'glrender[{format}]'")
    made = sequence(scene, tmp_path, format=format)
    next(iter(made.draw(1)))
    found, expected = read_image(made.path(0)), read_image(whole / "frame_00000.npz")
    np.testing.assert_array_equal(found, expected)
    assert found.max() > 100 and found.dtype == expected.dtype


def test_a_fits_file_says_what_it_holds(scene, tmp_path):
    fits = needed_module("astropy.io.fits", "pip install 'glrender[fits]'")
    made = sequence(scene, tmp_path, format="fits", output="irradiance", products=("range", "r_body"), has_labels=True)
    next(iter(made.draw(1)))
    with fits.open(made.path(0)) as opened:
        opened.verify("exception")
        header = opened[0].header
        assert (header["BUNIT"], header["INSTRUME"], header["FOCALPX"]) == ("W/m2", "navcam", 400.0)
        assert header["SC_X"] == STATES[0].spacecraft.r_inertial_m[0]
        assert opened["R_BODY"].data.shape == (3, 64, 96)
        told = json.loads(opened["GLRENDER"].data.tobytes())
        assert told["state"] == STATES[0].to_dict()
        x0, y0, x1, y1 = told["labels"]["bodies"]["body"]["box_px"]
        is_seen = np.isfinite(np.flipud(opened["RANGE"].data))
        assert is_seen[y0:y1, x0:x1].sum() == is_seen.sum()
        # The boresight is where the header says, by FITS' own count: the body is in the middle of the frame.
        lit = np.argwhere(np.isfinite(opened["RANGE"].data))
        assert np.abs(lit.mean(axis=0)[::-1] + 1.0 - (header["CRPIX1"], header["CRPIX2"])).max() < 4.0


@pytest.mark.parametrize("asked, told", [({"centroid_px": 0.05, "flux": 0.001}, "flux=0.001,centroid_px=0.05"),
                                         (0.03, "rms=0.03"), (None, "rms=0.1")])
def test_a_frame_says_what_was_asked(scene, tmp_path, asked, told):
    """By unit, as it was asked; the RMS that it was drawn for stands beside."""
    fits = needed_module("astropy.io.fits", "pip install 'glrender[fits]'")
    made = sequence(scene, tmp_path, format="fits", output="irradiance", max_error=asked)
    next(iter(made.draw(1)))
    with fits.open(made.path(0)) as opened:
        header, plan = opened[0].header, json.loads(opened["GLRENDER"].data.tobytes())["plan"]
    assert header["ASKED"] == told and header["MAXERR"] == plan["max_error"]
    assert plan["asked"] == (asked if isinstance(asked, dict) else {"rms": asked or 0.1})
    assert all(plan["predicted"][unit] <= most for unit, most in plan["asked"].items())


@pytest.mark.parametrize("changes, differing", [
    ({"seed": 8}, "options.seed"), ({"camera": "bare", "output": "irradiance"}, "options.camera, options.output")])
def test_a_folder_with_another_sequence_is_refused(scene, whole, changes, differing):
    with pytest.raises(ConfigError, match=f"another sequence: {differing} differ.*choose another folder"):
        list(sequence(scene, whole, **changes).draw(1))


def test_another_scene_is_another_sequence(files, whole, tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE.replace("radius_m = 100.0", "radius_m = 101.0"))
    with pytest.raises(ConfigError, match="scene_sha256 differ"):
        list(sequence(load_scene(tmp_path / "scene.toml"), whole).draw(1))


PLATE = "v -50 -50 0\nv 50 -50 0\nv 50 50 0\nv -50 50 0\n{}f 1/1 3/3 2/2\nf 1/1 4/4 3/3\n"
PLATES = {"first": (0, 1, 1, 0), "again": (0, 1, 1, 0), "mirrored": (1, 0, 0, 1), "moved": (0, 1, 1, 0.01)}


def plate(folder, name):
    """A textured plate whose texture coordinates are those of the name, read of a file of the name."""
    corners = "".join(f"vt {u} {v}\n" for u, v in zip(PLATES[name], (0, 0, 1, 1), strict=True))
    (folder / f"{name}.obj").write_text(PLATE.format(corners))
    law = Lambert(normal_albedo=0.3)
    body = Body.from_file(folder / f"{name}.obj", name="plate", length_unit="m", brdf=law)
    body = replace(body, albedo_map=np.linspace(0.2, 1.0, 64).reshape(1, 64))
    return Scene(bodies=[body], cameras=[views.camera(48)])


def test_the_digest_is_of_the_content_and_of_all_of_it(tmp_path):
    """Texture coordinates count, file names do not; a law without a __repr__ of its own counts by what it holds."""
    digests = {name: digest_of_scene(plate(tmp_path, name)) for name in PLATES}
    assert digests["first"] == digests["again"] and len(set(digests.values())) == 3

    class Rough:
        def __init__(self, *values):
            self.values = np.array(values)

    class Smooth(Rough):
        pass

    assert digest_of_scene([Rough(1.0, 2.0)]) == digest_of_scene([Rough(1.0, 2.0)])
    others = [[Rough(1.0, 2.0)], [Rough(1.0, 3.0)], [Smooth(1.0, 2.0)], [], [[]], [()], [None], ["None"], [1], [1.0],
              {1: 1}]
    assert len({digest_of_scene(other) for other in others}) == len(others)


def test_numbers_of_facets_are_whole_in_exr(tmp_path):
    """Beyond 2**24, where float32 has every second number; beside the bodies -1, as 32 bits without a sign have it."""
    exr = needed_module("OpenEXR", "pip install 'glrender[exr]'")
    ids = np.array([[-1, 0, 1], [2**24 - 1, 2**24 + 1, 2**31 - 1]], np.int32)
    products = {"facet_id": ids, "body_id": ids, "range": np.full((2, 3), 2.5, np.float32),
                "r_body": np.ones((2, 3, 3), np.float32)}
    write(tmp_path / "f.exr", FrameFile(pixels=np.ones((2, 3), np.float32), unit="W/m2", products=products, header={}))
    with exr.File(str(tmp_path / "f.exr")) as file:
        channels = file.channels()
        for name in ("facet_id", "body_id"):
            assert channels[name].pixels.dtype == np.uint32
            np.testing.assert_array_equal(channels[name].pixels.astype(np.int32), ids)
        assert channels["range"].pixels.dtype == np.float32 and "r_body.X" in channels


@pytest.mark.parametrize("options, message", [
    ({"format": "jpg"}, "format: must be one of fits"),
    ({"format": "png", "output": "irradiance"}, "png holds digital"),
    ({"format": "png", "products": ("range",)}, "products: must be none with format png, which holds the image alone"),
    ({"products": ("irradiance", "range")}, "must not have 'irradiance' with output 'dn': .* a second sequence"),
    ({"output": "image"}, "output"), ({"seed": -1}, "seed")])
def test_options_that_are_none(scene, tmp_path, options, message):
    with pytest.raises(ConfigError, match=message):
        sequence(scene, tmp_path, **options)


def test_what_cannot_be_drawn_is_told_with_its_number(scene, tmp_path):
    inside = views.state(range_m=10.0)
    made = FrameSequence(scene=scene, states=[*STATES[:2], inside], folder=tmp_path,
                         options=FrameOptions(camera="bare", format="npz"))
    with pytest.raises(ConfigError, match=r"states\[2\]"):
        list(made.draw(1))
    assert len(contents(tmp_path)) == 2
    other = State.from_dict({**STATES[0].to_dict(), "bodies": {"bdy": STATES[0].bodies["body"].to_dict()}})
    with pytest.raises(ConfigError, match=r"^states\[0\]\.bodies\.bdy: unknown body"):
        list(FrameSequence(scene=scene, states=[other], folder=tmp_path / "other",
                           options=FrameOptions(camera="bare", format="npz")).draw(1))


def test_the_command_labels_a_scenarios_keypoints(files, tmp_path, capsys):
    """With states of a file it follows the scenario's [output] too; a keypoint off the surface is told."""
    (tmp_path / "scenario.toml").write_text(serving.SCENE.replace(
        "[[cameras]]", "[bodies.keypoints]\nnear = [0.0, 0.0, -90.0]\nfar = [0.0, 0.0, 900.0]\n[[cameras]]", 1)
        + '[output]\ncamera = "bare"\nformat = "npz"\nlabels = true\n')
    assert main(["sequence", str(tmp_path / "scenario.toml"), "--states", str(files / "states.jsonl"), "--out",
                 str(tmp_path / "out"), "--processes", "1"]) == 0
    assert "keypoint 'far' is" in capsys.readouterr().err
    with np.load(tmp_path / "out" / "frame_00000.npz") as stored:
        header = json.loads(str(stored["header"]))
    assert header["camera"]["name"] == "bare"
    assert set(header["labels"]["bodies"]["body"]["keypoints"]) == {"near", "far"}


def test_states_that_are_none_are_told_with_their_line(files, tmp_path):
    from glrender_cli.commands.sequence import read_states

    for text, message in (("{}\n", r"s\[1\]\.r_sun_inertial_m"), ("\n{\n", "line 2: is not JSON"), ("\n", "no state")):
        (tmp_path / "s").write_text(text)
        with pytest.raises(ConfigError, match=message):
            read_states(tmp_path / "s")


def test_a_scenarios_states_are_written(tmp_path, capsys):
    text, example = (EXAMPLES / "scenarios" / "comet_flyby.toml").read_text(), str(tmp_path / "flyby.toml")
    Path(example).write_text(text.replace("seed = 67", "seed = 67, subdivisions = 3"))
    assert main(["sequence", example, "--write-states", str(tmp_path / "states.jsonl")]) == 0
    lines = (tmp_path / "states.jsonl").read_text().splitlines()
    assert len(lines) == 25 and "25 states" in capsys.readouterr().out
    middle = json.loads(lines[12])
    nearest = np.linalg.norm(np.subtract(middle["spacecraft"]["r_inertial_m"], middle["bodies"]["67p"]["r_inertial_m"]))
    assert nearest == pytest.approx(20000.0, abs=1.0)
    assert main(["check", example]) == 0 and "sequence: 25 states over 6 s from 2014-08-08" in capsys.readouterr().out
    assert main(["sequence", example]) == 1 and "--out: missing" in capsys.readouterr().err
