"""`glrender credibility`: numbers of this machine, their verdicts, and faults that the documents have too."""

from __future__ import annotations

import html
import json
import math
import re
from pathlib import Path

import pytest
from glrender_cli.__main__ import main
from glrender_cli.credibility import checks
from glrender_cli.credibility.checks import Check
from glrender_cli.credibility.report import KNOWN_FAULTS, write_pack

ACCURACY = Path(__file__).parents[2] / "docs" / "accuracy.md"


def check(number, most=1.0, name="<flux>"):
    return Check(name=name, requirement="error", reference="rays", domain="a sphere", number=number, most=most)


@pytest.mark.parametrize("number, holds", [(1.0, True), (1.001, False), (math.nan, False)])
def test_a_check_holds_up_to_its_bound(number, holds):
    assert check(number).holds is holds


def test_the_pack_says_what_fails_and_has_no_markup_of_names(tmp_path):
    data, page = write_pack(tmp_path / "a" / "pack", [check(2.0), check(0.5, name="place")])
    pack, text = json.loads(data.read_text()), page.read_text()
    assert [each["holds"] for each in pack["checks"]] == [False, True]
    assert text.count('class="no">no') == 1 and "1 of 2 checks hold" in text and "&lt;flux&gt;" in text
    assert "<flux>" not in text and pack["versions"]["numpy"] in text
    assert all(0 <= each["level"] <= 4 and html.escape(each["reason"]) in text for each in pack["levels"])


def test_known_faults_are_the_documents():
    told = ACCURACY.read_text(encoding="utf-8")
    numbers = [number for fault in KNOWN_FAULTS for number in re.findall(r"\d\.\d+|\d{2} %", fault)]
    assert len(numbers) >= 8 and not [number for number in numbers if number not in told]


def test_a_sphere_and_noise_hold(monkeypatch):
    """The quick checks; a law of another albedo or a detector of another gain fails them."""
    found = [*checks._sphere("auto"), checks._noise()]
    assert len(found) == 4 and all(each.holds for each in found), found
    monkeypatch.setattr(checks, "RANGE_M", 1.01 * checks.RANGE_M)
    monkeypatch.setattr(checks, "_state", lambda phase_deg, body, range_m, state=checks._state: state(
        phase_deg, body, range_m / 1.01))
    assert not next(checks._sphere("auto")).holds


@pytest.mark.slow
def test_the_command_writes_a_page_and_json(tmp_path, capsys):
    assert main(["credibility", "--out", str(tmp_path / "pack")]) == 0
    assert capsys.readouterr().out.count("holds ") == 7
    assert (tmp_path / "pack" / "credibility.html").stat().st_size > 3000


def test_a_file_in_the_folders_place_is_refused(tmp_path, capsys):
    (tmp_path / "pack").write_text("")
    assert main(["credibility", "--out", str(tmp_path / "pack")]) == 1
    assert "--out: must be a folder" in capsys.readouterr().err
