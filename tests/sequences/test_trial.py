"""A sequence or data set is tried before it is made: exposures, numbers, saturation, darkness, seconds and bytes."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import serving
import views
from glrender import ConfigError, load_scene
from glrender.sequences.options import FrameOptions
from glrender.sequences.sequence import FrameSequence
from glrender.sequences.trial import chosen, tried
from glrender_camera import AutoExposure, Detector
from glrender_cli.__main__ import main

STATES = [views.state(phase_deg=30.0, range_m=range_m) for range_m in (1500.0, 900.0, 4000.0, 1200.0, 2500.0)]
RANDOM = "[random]\nrange_m = [700.0, 1500.0]\nframes = 9\nseed = 3\n"
AUTO = serving.SCENE.replace("exposure_s = 0.01", 'exposure_s = "auto"')


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene.toml").write_text(AUTO)
    return load_scene(tmp_path / "scene.toml")


@pytest.mark.parametrize("n, expected", [(2, (1, 2)), (3, (0, 1, 2)), (5, (0, 1, 2, 3, 4)), (12, (0, 1, 2, 3, 4)),
                                         (1, (1,))])
def test_the_nearest_and_the_farthest_are_tried(n, expected):
    assert chosen(STATES, "body", n) == expected


def test_a_trial_has_the_figures_of_the_frames_that_are_made_later(scene, tmp_path):
    """All frames are tried, so that each figure is the sequence's own."""
    options = FrameOptions(camera="navcam", output="dn", format="npz", seed=4, products=("range", "flow"))
    trial = tried(scene, STATES, options, 12)
    sequence = FrameSequence(scene=scene, states=STATES, folder=tmp_path / "out", options=options)
    assert list(sequence.draw(1)) == list(trial.indices)
    with np.load(sequence.path(2)) as stored:
        assert (trial.least[2], trial.greatest[2]) == (stored["image"].min(), stored["image"].max())
        assert trial.exposure_s[2] == json.loads(str(stored["header"]))["exposure_s"]
    size = sum(sequence.path(index).stat().st_size for index in range(5))
    np.testing.assert_allclose(trial.n_bytes * 5, size, rtol=0.01)
    assert trial.n_dark == 0 and (trial.saturated_share < 0.02).all() and not trial.warnings


@pytest.mark.parametrize("stop, share", [("min_s = 0.5", 1.0), ("", 0.0)])
def test_a_shutter_that_is_too_slow_is_predicted_for_the_whole_set(tmp_path, capsys, stop, share):
    """All lit pixels are saturated at 0.5 s; a camera that names no stop has none."""
    scenario = tmp_path / "s.toml"
    scenario.write_text(AUTO.replace("optics", f"auto_exposure = {{ {stop} }}\noptics", 1) + RANDOM)
    assert main(["check", str(scenario)]) == 0
    said = capsys.readouterr()
    assert ("(9 of 9 frames: saturated)" in said.err) == bool(share)
    assert ("% of the lit pixels saturated" in said.out) and (" 100 % of the" in said.out) == bool(share)
    assert "tried: 9 of 9 frames: " in said.out and " s on " in said.out and " MB" in said.out
    assert main(["check", str(scenario), "--try", "3"]) == 0
    assert "tried: 3 of 9 frames" in capsys.readouterr().out
    assert main(["check", str(scenario), "--try", "0"]) == 0
    assert "tried" not in capsys.readouterr().out


def test_bytes_of_a_data_set_are_those_on_disk(tmp_path, capsys):
    scenario, out = tmp_path / "s.toml", tmp_path / "out"
    scenario.write_text(AUTO + RANDOM)
    assert main(["check", str(scenario)]) == 0
    said = capsys.readouterr().out
    predicted_MB = float(said.partition(" cores; some ")[2].split()[0])
    assert main(["dataset", str(scenario), "--out", str(out), "--processes", "1"]) == 0
    made = sum(path.stat().st_size for path in out.rglob("*") if path.suffix in (".tar", ".jsonl"))
    np.testing.assert_allclose(1e6 * predicted_MB, made, rtol=0.1)


def test_frames_without_light_are_counted(scene):
    """Two of three look away from the body."""
    away = [replace(state, spacecraft=replace(state.spacecraft, q_from_inertial=views.state(
        phase_deg=30.0, range_m=1500.0, target=(0.0, 0.0, 1e6)).spacecraft.q_from_inertial)) for state in STATES[:2]]
    trial = tried(scene, [*away, STATES[2]], FrameOptions(camera="navcam", output="dn", format="npz"), 12)
    assert trial.n_dark == 2 and sum(entry["n_frames"] for entry in trial.warnings.values()) >= 2


def test_a_state_that_cannot_be_drawn_is_named(scene):
    with pytest.raises(ConfigError, match=r"states\[1\]"):
        tried(scene, [STATES[0], views.state(range_m=10.0)], FrameOptions(camera="bare", format="npz"), 12)


def test_a_library_that_is_missing_leaves_the_size_open(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "astropy", None)
    monkeypatch.setitem(sys.modules, "astropy.io", None)
    trial = tried(scene, STATES[:1], FrameOptions(camera="bare"), 12)
    assert np.isnan(trial.n_bytes) and "glrender[fits]" in trial.problem


@pytest.mark.parametrize("wanted_s", [1e-3, 1e-5, 1e-8])
def test_auto_exposure_has_no_lower_stop_of_its_own(wanted_s):
    """Target times full well over the rate: one pixel, no dark current."""
    detector = Detector(quantum_efficiency=0.5, full_well_electrons=1e4, gain_DN_per_electron=0.1, bit_depth=12)
    rate = 0.7 * 1e4 / wanted_s
    found = AutoExposure().of_irradiance(np.ones((1, 1), np.float32), rate, detector)
    np.testing.assert_allclose(found, wanted_s, rtol=1e-6)


def test_the_manifest_counts_warnings_also_after_a_second_sitting(tmp_path, capsys):
    """Three of five frames are saturated; two of them are drawn later."""
    (tmp_path / "scene.toml").write_text(AUTO)
    scene, out = load_scene(tmp_path / "scene.toml"), tmp_path / "out"
    states = [replace(state, r_sun_inertial_m=state.r_sun_inertial_m * (0.02 if k < 3 else 1.0))
              for k, state in enumerate(STATES)]
    sequence = FrameSequence(scene=scene, states=states, folder=out, options=FrameOptions(
        camera="navcam", output="dn", format="npz", exposure_s=3e-7))
    list(sequence.draw(1))
    counts = {code: entry["n_frames"] for code, entry in json.loads(
        (out / "manifest.json").read_text())["warnings"].items()}
    assert counts["saturated"] == 3
    for index in (0, 1):
        sequence.path(index).unlink()
    assert list(sequence.draw(1)) == [0, 1]
    again = json.loads((out / "manifest.json").read_text())["warnings"]
    assert {code: entry["n_frames"] for code, entry in again.items()} == counts
    assert any("(3 of 5 frames: saturated)" in text for text in sequence.warnings())
