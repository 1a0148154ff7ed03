"""No example, no listing of a page and no preset has a field that is improbable for its unit.

The Python programs of examples are watched where they run in the tests' own process: `tests/examples/conftest.py`, and
a page's in `test_docs.py`. Others read scenes and scenarios of files, which are checked here.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import views
from glrender import Scene
from glrender.brdf import Lambert
from glrender.scenario.plausible import refuse_impossible, scenario_doubts, written_tables
from glrender_camera import CameraModel
from glrender_camera.presets import PRESETS
from likely import all_likely, doubts

ROOT = Path(__file__).parents[2]
# Scenes and scenarios; what the adapter for Basilisk reads has no camera's optics.
FILES = sorted(path for path in (ROOT / "examples").rglob("*.toml")
               if "focal_length_px" in str(tomllib.loads(path.read_text()).get("cameras")))
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
LISTINGS = [pytest.param(text, id=f"{page.name}-{index}") for page in PAGES
            for index, text in enumerate(re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.S))
            if "[[bodies]]" in text and "[[cameras]]" in text and "models" not in text]
# What no source of a preset gives: of the sensors' data sheets, rounded.
GAIN = {"gain_DN_per_electron": 0.04}
LEFT_OUT = {"dawn_framing_camera": {"full_well_electrons": 3e5}, "hayabusa_amica": {"quantum_efficiency": 0.5},
            "rosetta_navcam": GAIN, "rosetta_navcam_attenuated": GAIN}
# Shapes that are not in the project.
_RADII_M = {"67p": 1650.0, "sat": 5.0}


def test_there_are_examples_and_listings():
    assert len(FILES) >= 6 and len(LISTINGS) >= 2


def scene_of(table):
    """The bodies and cameras of a scene or scenario file; a sphere for a shape, and a law, that are of other files."""
    lambert, sphere = {"law": "lambert", "normal_albedo": 0.3}, {"kind": "icosphere", "subdivisions": 2}
    bodies = [{"name": body["name"], "brdf": body.get("brdf", lambert), "generated": body.get(
        "generated", {**sphere, "radius_m": _RADII_M.get(body["name"], 250.0)})} for body in table["bodies"]]
    given = {key: table[key] for key in ("cameras", "solar_irradiance_1au_W_m2") if key in table}
    return Scene.from_dict({"bodies": bodies, **given})


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_an_examples_file_is_likely(path):
    """The scene, and the tables of its scenario as they are written: kernels need not be there."""
    table = tomllib.loads(path.read_text())
    scene, written = scene_of(table), written_tables(table, table["bodies"])
    refuse_impossible(written, scene.bodies)
    assert doubts(scene) == [] and scenario_doubts(written, scene.bodies) == []


@pytest.mark.parametrize("text", LISTINGS)
def test_a_pages_listing_is_likely(text):
    assert doubts(scene_of(tomllib.loads(text))) == []


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_likely(name):
    model = CameraModel.from_dict({"preset": name, "detector": LEFT_OUT.get(name, {})})
    scene = Scene(bodies=[views.sphere(Lambert(normal_albedo=0.2), 1)], cameras=[views.camera(model=model)])
    assert doubts(scene) == []


def test_the_watch_can_fail():
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "optics": {"aperture_diameter_m": 15.1}})
    with pytest.raises(AssertionError, match="aperture_diameter_m"), all_likely() as made:
        Scene(bodies=[views.sphere(Lambert(normal_albedo=0.2), 1)], cameras=[views.camera(model=model)])
    assert len(made) == 1
