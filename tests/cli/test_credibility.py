"""`glrender credibility`: numbers of this machine, their verdicts, and faults that the documents have too."""

from __future__ import annotations

import html
import json
import math
import re
from pathlib import Path

import pytest
from glrender import Body, PinholeCamera, generate
from glrender.brdf import Lambert
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
    found = [*checks._sphere("auto"), *checks._facets("auto"), checks._noise()]
    assert len(found) == 6 and all(each.holds for each in found), found
    monkeypatch.setattr(checks, "RANGE_M", 1.01 * checks.RANGE_M)
    monkeypatch.setattr(checks, "_state", lambda phase_deg, body, range_m, state=checks._state: state(
        phase_deg, body, range_m / 1.01))
    assert not next(checks._sphere("auto")).holds


def test_the_light_of_facets_is_a_spheres():
    """Closed forms: Lambert's sphere, its light centred at 3 pi / 16 of the radius times a law of phase, to 1e-4."""
    body = Body(name="body", shape=generate.icosphere(radius_m=checks.RADIUS_M, subdivisions=6),
                brdf=Lambert(normal_albedo=0.3))
    camera = PinholeCamera(name="camera", width_px=128, height_px=128, focal_length_px=5.0e6)
    for phase_deg in checks.PHASES_DEG:
        g = math.radians(phase_deg)
        law = math.sin(g) + (math.pi - g) * math.cos(g)
        flux, place_px = checks._light_of_facets(body, camera, checks._state(phase_deg, "body", checks.RANGE_M))
        assert flux == pytest.approx(0.2 * law / math.pi * (checks.RADIUS_M / checks.RANGE_M)**2, rel=3e-4)
        offset_px = 50.0 * 3.0 * math.pi / 16.0 * math.sin(g) * (1.0 + math.cos(g)) / law
        assert list(place_px - 63.5) == pytest.approx([offset_px, 0.0], abs=50.0 * 1e-4)


@pytest.mark.slow
def test_the_command_writes_a_page_and_json(tmp_path, capsys):
    assert main(["credibility", "--out", str(tmp_path / "pack")]) == 0
    assert capsys.readouterr().out.count("holds ") == 7
    assert (tmp_path / "pack" / "credibility.html").stat().st_size > 3000


def test_a_file_in_the_folders_place_is_refused(tmp_path, capsys):
    (tmp_path / "pack").write_text("")
    assert main(["credibility", "--out", str(tmp_path / "pack")]) == 1
    assert "--out: must be a folder" in capsys.readouterr().err
