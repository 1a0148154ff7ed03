"""What `glrender check --plot` draws: numbers against closed forms, and the picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from glrender import Pose, Scene, State, frames
from glrender.base.constants import AU_M
from glrender_cli.__main__ import main
from missing import needed_module
from PIL import Image

EXAMPLE = Path(__file__).parents[2] / "examples" / "scenarios" / "comet_flyby.toml"
BODY = {"name": "moon", "generated": {"kind": "icosphere", "radius_m": 100.0, "subdivisions": 2},
        "brdf": {"law": "lambert", "normal_albedo": 0.1}}


@pytest.fixture
def plots():
    needed_module("matplotlib", "pip install -e '.[test]'")
    from glrender_cli import scenario_plots

    return scenario_plots


@pytest.fixture
def flyby(tmp_path):
    """The example of a fly-by with fewer facets."""
    text = EXAMPLE.read_text()
    assert "seed = 67 }" in text
    (tmp_path / "flyby.toml").write_text(text.replace("seed = 67 }", "seed = 67, subdivisions = 3 }"))
    return str(tmp_path / "flyby.toml")


def scene(**camera):
    return Scene.from_dict({"bodies": [BODY], "cameras": [{"name": "c", "width_px": 64, "height_px": 64,
                                                           "focal_length_px": 300.0, **camera}]})


def state(r, sun, q_body=(1.0, 0.0, 0.0, 0.0), aim=(0.0, 0.0, 0.0), t_s=0.0):
    return State(t_s=t_s, r_sun_inertial_m=AU_M * np.array(sun), bodies={"moon": Pose(r_inertial_m=np.zeros(3),
                                                                                     q_from_inertial=q_body)},
                 spacecraft=Pose(r_inertial_m=np.array(r), q_from_inertial=frames.look_at(np.array(r), np.array(aim))))


def test_a_track_has_the_angles_of_the_geometry(plots):
    """2 km along -Y, the Sun along +X: phase 90 deg, longitude -90 under the camera and 0 under the Sun."""
    camera = scene().cameras[0]
    quarter = np.sqrt(0.5)
    track = plots.track_of([state([0.0, -2e3, 0.0], [1.0, 0.0, 0.0]),
                            state([0.0, 0.0, 3e3], [0.0, 0.6, 0.8], aim=(300.0, 0.0, 0.0)),
                            state([2e3, 0.0, 0.0], [1.0, 0.0, 0.0], q_body=(quarter, 0.0, 0.0, quarter))],
                           camera, "moon")
    np.testing.assert_allclose(track.range_m, [2e3, 3e3, 2e3])
    np.testing.assert_allclose(track.phase_deg, [90.0, np.degrees(np.arccos(0.8)), 0.0], atol=1e-6)
    # Aimed 300 m aside at 3 km: the foot of the perpendicular on the line of sight.
    np.testing.assert_allclose(track.off_axis_m, [0.0, 300.0 * 3000.0 / np.hypot(300.0, 3000.0), 0.0], atol=1e-9)
    np.testing.assert_allclose(track.sub_camera_deg[0], [-90.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(track.sub_camera_deg[1, 1], 90.0, atol=1e-6)
    np.testing.assert_allclose(track.subsolar_deg[0], [0.0, 0.0], atol=1e-6)
    # Body components of +X after a turn that takes x to y.
    np.testing.assert_allclose(track.sub_camera_deg[2], [90.0, 0.0], atol=1e-9)


def test_a_camera_beside_the_spacecrafts_origin_counts(plots):
    camera = scene(r_camera_spacecraft_m=[0.0, 0.0, -500.0]).cameras[0]
    track = plots.track_of([state([0.0, -2e3, 0.0], [1.0, 0.0, 0.0])], camera, "moon")
    np.testing.assert_allclose(track.range_m, [2500.0])


def test_the_suns_direction_is_that_of_the_image(plots):
    """From -Y, +Z up in the image: a Sun at +X is to the right, one at +Z above, one behind at 180 deg."""
    camera = scene().cameras[0]
    suns = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.6, 0.8, 0.0]]
    found = plots.sun_in_camera_deg([state([0.0, -2e3, 0.0], sun) for sun in suns], camera)
    np.testing.assert_allclose(found[:2], [[90.0, 0.0], [90.0, -90.0]], atol=1e-4)
    np.testing.assert_allclose(found[2:, 0], [180.0, np.degrees(np.arccos(0.8))], atol=1e-4)


def test_a_line_is_cut_where_an_angle_wraps(plots):
    along, angle = plots._cut(np.arange(4.0), np.array([170.0, -170.0, -100.0, 120.0]))
    np.testing.assert_array_equal(angle, [170.0, np.nan, -170.0, -100.0, np.nan, 120.0])
    np.testing.assert_array_equal(along, [0.0, np.nan, 1.0, 2.0, np.nan, 3.0])


def test_the_command_draws_it(plots, flyby, tmp_path, capsys):
    assert main(["check", flyby, "--plot", str(tmp_path / "flyby.png")]) == 0
    assert capsys.readouterr().out.endswith(f"plot: {tmp_path / 'flyby.png'}\n")
    picture = np.asarray(Image.open(tmp_path / "flyby.png").convert("L"))
    assert picture.shape[0] > 500 and 0.02 < (picture < 200).mean() < 0.3


@pytest.mark.parametrize("arguments, message", [
    (["--plot", "plot.gif2"], "--plot: cannot be written: Format 'gif2' is not supported"),
    (["--plot", "nowhere/plot.png"], "--plot: must be in a folder that is there"),
    (["--plot", "plot.png", "--camera", "wac"], "camera: unknown camera, got 'wac'"),
    (["--plot", "plot.png", "--phase-deg", "30"], "--plot: is of a scenario's sequence, not of one frame"),
])
def test_mistakes_are_told(plots, flyby, tmp_path, monkeypatch, capfd, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(["check", flyby, *arguments]) == 1
    told = capfd.readouterr().err
    assert message in told and "Traceback" not in told


def test_one_frame_and_two_bodies_are_drawn(plots, tmp_path):
    other = {**BODY, "name": "moonlet"}
    both = Scene.from_dict({"bodies": [BODY, other], "cameras": [{"name": "c", "width_px": 64, "height_px": 48,
                                                                  "focal_length_px": 300.0}]})
    one = state([0.0, -2e3, 0.0], [1.0, 0.0, 0.0])
    one.bodies["moonlet"] = Pose(r_inertial_m=np.array([400.0, 0.0, 0.0]))
    plots.scenario_plot(tmp_path / "one.png", "one", both, [one], both.cameras[0])
    assert np.asarray(Image.open(tmp_path / "one.png").convert("L")).std() > 10
