"""`glrender init --scenario` writes whole scenarios that `check` takes and that have what they say in view."""

from __future__ import annotations

import json
from pathlib import Path

import make_cookbook
import numpy as np
import pytest
from cells import slow_but
from glrender import frames
from glrender.scenario import load_scenario
from glrender_cli.__main__ import main
from glrender_cli.commands.fields import found_in
from glrender_cli.new_files import SCENARIOS
from missing import needed_module

BOOK = Path(__file__).parents[2] / "server" / "glrender_cli" / "cookbook"
# What the real image's ISD says of itself; no other scenario has a warning.
NOTES = {"isd": ["focal length 0.1208 is taken in m", "counts lines upwards"]}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(kind, folder):
    assert main(["init", "--scenario", kind, "--out", f"{kind}.toml"]) == 0
    return load_scenario(folder / f"{kind}.toml")


@pytest.mark.parametrize("kind", slow_but(SCENARIOS, 0, 1, 2))
def test_check_tries_a_frame_of_each_and_finds_it_lit(kind, folder, capsys):
    if kind == "spice":
        needed_module("spiceypy", "pip install -e '.[test]'")
    assert main(["init", "--scenario", kind]) == 0
    assert "glrender check scenario.toml" in capsys.readouterr().out
    assert main(["check", "scenario.toml", "--try", "1"]) == 0
    said = capsys.readouterr()
    assert ", 0 without light" in said.out and " 0 % of the lit pixels saturated" in said.out
    warnings, expected = said.err.splitlines(), NOTES.get(kind, [])
    assert len(warnings) == len(expected) and all(map(str.__contains__, warnings, expected)), said.err


@pytest.mark.parametrize("kind", ["csv", "oem", "spice"])
def test_tables_files_and_kernels_are_one_pass(kind, folder):
    """The pass in closed form, between the rows too: 25 frames of 13 rows; dates by NAIF's leap seconds."""
    if kind == "spice":
        needed_module("spiceypy", "pip install -e '.[test]'")
    states = written(kind, folder).states()
    t_s = np.linspace(0.0, make_cookbook.DURATION_S, 25)
    r_m, _ = make_cookbook.path(t_s)
    np.testing.assert_allclose([state.spacecraft.r_inertial_m for state in states], r_m, atol=0.01)
    for state, place in zip(states, r_m, strict=True):
        boresight = frames.dcm(state.spacecraft.q_from_inertial)[2]
        np.testing.assert_allclose(boresight, -place / np.linalg.norm(place), atol=1e-3)
    if kind != "csv":
        assert states[0].date_tdb.startswith("2005-10-13T01:01:04.182358")


def test_the_real_images_state_is_its_isds(folder):
    """Hayabusa from Itokawa [km], J2000, turned nowhere."""
    (state,) = written("isd", folder).states()
    isd = json.loads((folder / "st_2458542208.json").read_text())
    offset = state.spacecraft.r_inertial_m - state.bodies["itokawa"].r_inertial_m
    np.testing.assert_allclose(offset, 1e3 * np.array(isd["instrument_position"]["positions"][0]), rtol=1e-9)


@pytest.mark.parametrize("kind, range_m", [("encounter", 4000.0), ("hover", np.hypot(4000.0, 1500.0))])
def test_ranges_are_those_of_the_file(kind, range_m, folder):
    states = written(kind, folder).states()
    ranges = [np.linalg.norm(state.spacecraft.r_inertial_m - state.bodies["itokawa"].r_inertial_m) for state in states]
    np.testing.assert_allclose(min(ranges), range_m, atol=1.0)


def test_the_fly_by_turns_the_camera_no_faster_than_the_body_passes(folder):
    """v d / r^2 is the rate of the line of sight; a roll by an unlucky axis is 15 times as fast."""
    for state in written("encounter", folder).states():
        range_m = np.linalg.norm(state.spacecraft.r_inertial_m - state.bodies["itokawa"].r_inertial_m)
        rate_rad_s = np.linalg.norm(state.spacecraft.angular_velocity_rad_s)
        np.testing.assert_array_less(rate_rad_s, 1.1 * 6000.0 * 4000.0 / range_m**2 + 0.01)


def test_a_file_that_is_not_there_is_named_with_the_way_out(folder, capsys):
    """A camera's ISD is not called bad JSON."""
    assert main(["init", "--scenario", "isd"]) == 0
    (folder / "st_2458542208.json").unlink()
    assert main(["check", "scenario.toml"]) == 1
    said = capsys.readouterr().err
    assert "st_2458542208.json: cannot be read: No such file" in said and "relative to that" in said
    assert "JSON:" not in said


def test_a_table_of_semicolons_is_told_of_commas(folder, capsys):
    assert main(["init", "--scenario", "csv"]) == 0
    table = folder / "states.csv"
    table.write_text(table.read_text().replace(",", ";"))
    assert main(["check", "scenario.toml"]) == 1
    assert "commas are between columns" in capsys.readouterr().err


def test_the_text_files_are_made_by_their_script(tmp_path, monkeypatch):
    """Kernels are compared by the states that they give, above."""
    monkeypatch.setattr(make_cookbook, "write_kernels", lambda *_: None)
    make_cookbook.main(tmp_path)
    for name in ("states.csv", "hayabusa.oem", "hayabusa.aem"):
        assert (tmp_path / name).read_text() == (BOOK / name).read_text(), name


def test_nothing_is_replaced(folder, capsys):
    (folder / "states.csv").write_text("mine")
    assert main(["init", "--scenario", "csv"]) == 1
    assert "states.csv: is there already, and is another file" in capsys.readouterr().err
    assert [path.name for path in folder.iterdir()] == ["states.csv"] and (folder / "states.csv").read_text() == "mine"
    assert main(["init", "x.obj", "--unit", "m", "--scenario", "csv"]) == 1
    assert "--scenario: has a shape of its own" in capsys.readouterr().err


def test_fields_of_a_table_are_printed(capsys):
    assert main(["fields", "cameras.model.detector"]) == 0
    assert "  bit_depth: int, 1..16, required\n" in capsys.readouterr().out
    assert main(["fields", "spice.ids"]) == 0
    assert capsys.readouterr().out.startswith("spice\n  ids: mapping of name to str\n")
    assert main(["fields", "trajectory.csv"]) == 0
    assert "  file: text\n" in capsys.readouterr().out
    assert main(["fields"]) == 0
    names = capsys.readouterr().out.splitlines()
    assert "bodies.spin" in names and len(names) > 50
    assert main(["fields", "cameras.model.detectr"]) == 1
    assert "did you mean 'cameras.model.detector'" in capsys.readouterr().err


def test_a_table_is_found_by_its_path_its_choice_or_a_field_of_it():
    tables = {"the file": [("max_error",)], 'bodies.brdf, law = "hapke"': [("b",)], "bodies.brdf, preset": [("id",)]}
    assert list(found_in(tables, "bodies.brdf")) == ['bodies.brdf, law = "hapke"', "bodies.brdf, preset"]
    assert list(found_in(tables, "bodies.brdf.hapke")) == ['bodies.brdf, law = "hapke"']
    assert found_in(tables, "bodies.brdf.b") == {'bodies.brdf, law = "hapke"': [("b",)]}
    assert found_in(tables, "max_error") == {"the file": [("max_error",)]} and not found_in(tables, "bodies.spin")


def test_a_path_may_be_a_messages_and_a_field_may_come_alone():
    tables = {"the file": [("max_error",)], "cameras": [("width_px",)], "spice": [("ids",)], "random": [("frames",)],
              "time": [("frames",)]}
    for asked in ("cameras[0]", "[[cameras]]", "[cameras]"):
        assert found_in(tables, asked) == {"cameras": [("width_px",)]}, asked
    assert found_in(tables, "cameras[1].width_px") == {"cameras": [("width_px",)]}
    assert found_in(tables, "ids") == {"spice": [("ids",)]}
    assert list(found_in(tables, "frames")) == ["random", "time"] and not found_in(tables, "")
