"""Both cases of the SISPO paper: their geometry as the issue has it, and a small run from scenario to summary."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from glrender import generate
from glrender.base.rotations import dcm
from glrender.scenario import load_scenario
from glrender_photogrammetry import Mesh
from missing import needed_module

PAPER = Path(__file__).parents[2] / "examples" / "paper"
BODY = "../../out/paper/67p.obj"


@pytest.fixture
def paper(monkeypatch):
    for name, extra in (("pycolmap", "reconstruction"), ("imagecodecs", "compression")):
        needed_module(name, f"pip install 'glrender[{extra}]'")
    monkeypatch.syspath_prepend(str(PAPER))
    monkeypatch.delitem(sys.modules, "paper", raising=False)
    return __import__("paper")


def scenario(name, folder, *changes):
    """The scenario of a case about a ball, with some texts changed."""
    text = (PAPER / f"{name}.toml").read_text()
    generate.icosphere(radius_m=2000.0, subdivisions=2).to_file(folder / "ball.obj")
    for old, new in ((BODY, "ball.obj"), *changes):
        assert old in text, old
        text = text.replace(old, new)
    (folder / f"{name}.toml").write_text(text)
    return folder / f"{name}.toml"


def geometry(path):
    """Unit vectors to camera and Sun (N, 3) in the body's axes, and ranges (N,) [m]."""
    states = load_scenario(path).states()
    turns = [dcm(state.bodies["67p"].q_from_inertial) for state in states]
    cameras, suns = (np.array([turn @ (getattr(state, name) if name == "r_sun_inertial_m" else
                                       state.spacecraft.r_inertial_m) - turn @ state.bodies["67p"].r_inertial_m
                               for turn, state in zip(turns, states, strict=True)]) for name in ("r_camera",
                                                                                               "r_sun_inertial_m"))
    range_m = np.linalg.norm(cameras, axis=1)
    return cameras / range_m[:, None], suns / np.linalg.norm(suns, axis=1, keepdims=True), range_m


def steps_deg(up):
    return np.degrees(np.arccos(np.clip((up[1:] * up[:-1]).sum(axis=1), -1.0, 1.0)))


def test_the_flyby_crosses_the_suns_direction(tmp_path):
    """25 frames of equal turns, 20 km at the nearest, 67, 40 and 67 deg of phase: the issue's."""
    up, sun, range_m = geometry(scenario("flyby", tmp_path))
    phase_deg = np.degrees(np.arccos((up * sun).sum(axis=1)))
    np.testing.assert_allclose(phase_deg[[0, 12, 24]], [67.0, 40.0, 67.0], atol=1.0)
    np.testing.assert_allclose([range_m.min(), len(range_m)], [20e3, 25])
    np.testing.assert_allclose(steps_deg(up), 5.0, atol=0.05)


def test_the_orbit_sees_both_sides_in_steps_below_15_deg(tmp_path):
    """53 frames in two turns at 20 km, from 50 deg north to 50 deg south, the Sun 40 deg of longitude aside."""
    up, sun, range_m = geometry(scenario("orbit", tmp_path))
    np.testing.assert_allclose(range_m, 20e3, rtol=1e-6)
    np.testing.assert_allclose(np.degrees(np.arcsin(up[[0, 26, 52], 2])), [50.0, 0.0, -50.0], atol=0.1)
    longitude = np.unwrap(np.arctan2(up[:, 1], up[:, 0]))
    np.testing.assert_allclose(np.abs(np.degrees(longitude[-1] - longitude[0])) / 360.0, 52 * 13.6 / 360, rtol=1e-3)
    apart = np.degrees(longitude - np.arctan2(sun[:, 1], sun[:, 0]))
    np.testing.assert_allclose(np.abs((apart + 180.0) % 360.0 - 180.0), 40.0, atol=0.1)
    assert len(up) == 53 and steps_deg(up).max() < 15.0


def test_frames_after_a_codec_are_within_its_bound(paper, tmp_path):
    """Noise about an offset: errors of at most 10 DN; a rate of 1 bit a pixel within a tenth."""
    frames = tmp_path / "frames"
    frames.mkdir()
    (frames / "manifest.json").write_text("{}")
    dn = (500.0 + 60.0 * np.random.default_rng(1).normal(size=(64, 64))).astype(np.uint16)
    np.savez(frames / "frame_00000.npz", image=dn, header=json.dumps({"camera": {"detector": {"bit_depth": 12}}}))
    for key, bound_DN in (("compressed", 10), ("compressed_jpeg_2000", 500)):
        rate_bpp = paper.recoded(frames, tmp_path / key, paper.CODECS[key])
        with np.load(tmp_path / key / "frame_00000.npz") as stored:
            error_DN = np.abs(stored["image"].astype(int) - dn)
            assert json.loads(str(stored["header"]))["camera"]["detector"]["bit_depth"] == 12
        assert 0 < error_DN.max() <= bound_DN and (tmp_path / key / "manifest.json").is_file()
    np.testing.assert_allclose(rate_bpp, 1.0, rtol=0.1)


def test_the_folder_of_a_codec_has_no_frames_of_an_earlier_run(paper, tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "manifest.json").write_text("{}")
    header = json.dumps({"camera": {"detector": {"bit_depth": 12}}})
    for k in range(3):
        np.savez(tmp_path / "frames" / f"frame_0000{k}.npz", image=np.full((8, 8), 9, np.uint16), header=header)
    for left in (3, 2):
        paper.recoded(tmp_path / "frames", tmp_path / "coded", paper.CODECS["compressed"])
        assert len(list((tmp_path / "coded").glob("frame_*"))) == left
        (tmp_path / "frames" / "frame_00002.npz").unlink(missing_ok=True)


def test_the_fine_shape_is_that_of_the_file_that_is_named(paper, tmp_path):
    """Balls of 1 and 2 km; relief lifts no vertex of theirs by a tenth. Made once for each file."""
    coarse, out = tmp_path / "coarse.obj", tmp_path / "out" / "67p.obj"
    for radius_km in (1.0, 2.0):
        generate.icosphere(radius_m=radius_km, subdivisions=2).to_file(coarse)
        radius_m = np.linalg.norm(paper.fine_shape(coarse, out).vertices_m, axis=1)
        np.testing.assert_allclose(radius_m.mean(), 1e3 * radius_km, rtol=0.1)
        made_ns = out.stat().st_mtime_ns
        paper.fine_shape(coarse, out)
        assert out.stat().st_mtime_ns == made_ns
    coarse.unlink()
    with pytest.raises(ValueError, match="--shape: must be a file of comet 67P"):
        paper.fine_shape(coarse, out)


def test_frames_of_another_scenario_or_shape_are_drawn_anew(paper, tmp_path, monkeypatch):
    """Once for each; surfaces and decoded frames of the former ones are gone, other cases stay."""
    calls = []
    monkeypatch.setattr(paper, "glrender", lambda words: calls.append(words) or 0)
    path, later, other = tmp_path / "flyby.toml", tmp_path / "flyby_compressed", tmp_path / "orbit"
    balls = [Mesh.of(generate.icosphere(radius_m=radius_m, subdivisions=1)) for radius_m in (1.0, 2.0)]
    other.mkdir()
    for n_drawn, (text, ball) in enumerate((("a", 0), ("b", 0), ("b", 1), ("a", 0)), start=1):
        path.write_text(text)
        taken_s = paper.drawn(path, "flyby", tmp_path, balls[ball])
        assert len(calls) == n_drawn and not later.exists()
        later.mkdir()
        assert paper.drawn(path, "flyby", tmp_path, balls[ball]) == taken_s and len(calls) == n_drawn
        assert later.is_dir() and other.is_dir()


def test_frames_that_were_stopped_go_on_in_their_folder(paper, tmp_path, monkeypatch):
    path, ball = tmp_path / "flyby.toml", Mesh.of(generate.icosphere(radius_m=1.0, subdivisions=1))
    path.write_text("a")
    monkeypatch.setattr(paper, "glrender", lambda words: Path(words[3]).mkdir() or 1)
    with pytest.raises(SystemExit):
        paper.drawn(path, "flyby", tmp_path, ball)
    monkeypatch.setattr(paper, "glrender", lambda words: 0 if Path(words[3]).is_dir() else 1)
    assert paper.drawn(path, "flyby", tmp_path, ball) >= 0.0


def test_what_is_not_there_is_said_in_one_line(paper, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(paper, "OUT", tmp_path / "out")
    for arguments, message in ((["--shape", "none.obj"], "--shape: must be a file of comet 67P in km, got 'none.obj'"),
                               (["landing"], "CASE: must be one of flyby, orbit, got 'landing'")):
        monkeypatch.setattr(sys, "argv", ["paper.py", *arguments])
        with pytest.raises(SystemExit):
            paper.main()
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_small_case_from_scenario_to_summary(paper, tmp_path, monkeypatch):
    """The fly-by with a quarter of the pixels and half of the frames, of a lumpy ball: deviations below a pixel."""
    rough = generate.gaussian_random_sphere(radius_m=1700.0, sigma=0.1, seed=4, subdivisions=4)
    generate.subdivide_with_relief(rough, levels=2, relief=0.08, seed=2).to_file(tmp_path / "67p.obj")
    path = scenario("flyby", tmp_path, ("ball.obj", "67p.obj"), ("= 1024", "= 256"), ("3522.0", "880.5"),
                    ("0.0035", "0.00022"), ("frames = 25", "frames = 13"))
    monkeypatch.delitem(paper.CODECS, "compressed_jpeg_2000")
    truth = Mesh.from_file(tmp_path / "67p.obj")
    found = paper.case("flyby", path, tmp_path, truth)
    for numbers in (found, found["compressed"]):
        px_m = numbers["px_m"]
        np.testing.assert_allclose(px_m, 20e3 / 880.5, rtol=1e-3)
        assert abs(numbers["mean_m"]) < 0.3 * px_m and numbers["sigma_m"] < px_m and numbers["cpu_s"] > 1.0
        assert numbers["complete_2px"] > 0.6 and numbers["max_m"] < 15.0 * px_m
    assert found["compressed"]["sigma_m"] < 1.2 * found["sigma_m"]
    for ending in ("", "_compressed"):
        assert (tmp_path / f"flyby{ending}.png").stat().st_size > 10_000
    assert paper.case("flyby", path, tmp_path, truth) == found, "taken up, with the seconds of the first run"
