"""What a new user types first, in an empty folder, as README.md and the tutorial print it."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from data_folders import ITOKAWA
from glrender import load_scene
from glrender_cli.__main__ import main
from glrender_cli.commands import doctor
from PIL import Image

ROOT = Path(__file__).parents[2]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def commands(page, pattern):
    """Lines of a page that begin with `glrender`, without their comments."""
    found = re.findall(pattern, (ROOT / page).read_text(encoding="utf-8"), re.M)
    return [shlex.split(line, comments=True)[1:] for line in found]


def test_the_readmes_first_commands_draw_its_picture(folder):
    """The page's picture is its command's, averaged over 2 x 2 pixels: the light of each is true to 2 % (RMS)."""
    init, render = commands("README.md", r"^glrender (?:init|render) .*$")
    assert main(init) == 0 and main(render) == 0
    drawn, shown = ((np.asarray(picture.convert("L").resize((512, 512), Image.Resampling.BOX), float) / 255.0) ** 2.2
                    for picture in map(Image.open, (folder / "first.png", ROOT / "docs" / "img" / "first.png")))
    lit = shown > 0.0
    assert shown.max() > 0.7 and 0.1 < lit.mean() < 0.3
    assert np.sqrt(np.mean((drawn - shown)[lit] ** 2)) < np.hypot(0.02, 0.02) * shown[lit].mean()


def test_an_example_is_itokawa_and_replaces_nothing(folder, capsys):
    assert main(["init", "--example"]) == 0
    assert (folder / "itokawa.obj").read_bytes() == ITOKAWA.read_bytes()
    (body,) = load_scene(folder / "scene.toml").bodies
    # Gaskell's model: 0.561 x 0.305 x 0.243 km (Fujiwara et al. 2006 have 0.535 x 0.294 x 0.209 along its axes).
    assert len(body.shape.facets) == 12_288 and body.shape.report.is_watertight
    np.testing.assert_allclose(sorted(body.shape.report.extent_m), [243.0, 305.0, 561.0], atol=1.0)
    assert main(["init", "--example", "--out", "second.toml"]) == 0, "the same shape may be there"
    (folder / "itokawa.obj").write_text("v 0 0 0")
    assert main(["init", "--example", "--out", "third.toml"]) == 1
    assert "itokawa.obj: is there already, and is another file" in capsys.readouterr().err
    assert (folder / "itokawa.obj").read_text() == "v 0 0 0" and not (folder / "third.toml").exists()
    assert main(["init", "itokawa.obj", "--unit", "km", "--example", "--out", "third.toml"]) == 1
    assert "--example: has a shape of its own" in capsys.readouterr().err


def test_all_has_every_extra_of_a_user_and_doctor_looks_for_each():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (text,) = extras["all"]
    ours = set(re.fullmatch(r"glrender\[([\w,]+)\]", text)[1].split(","))
    assert ours | {"belief"} == set(extras) - {"all", "cycles", "docs", "peers", "test"}
    assert set(doctor._EXTRAS) == ours | {"belief"}
    listed = (ROOT / "README.md").read_text(encoding="utf-8").partition("| extra | brings |")[2].partition("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (.*?) \|", listed, re.M)))) == ours | {"belief"}


def test_a_demo_says_what_it_lacks(monkeypatch, capsys, folder):
    for module in ("matplotlib", "fast_simplification"):
        monkeypatch.setitem(sys.modules, module, None)
    assert main(["demo", "--shape", "none.obj"]) == 1
    told = capsys.readouterr().out
    assert "the on-board model is the true shape" in told and "pip install 'glrender[demo]'" in told


@pytest.mark.slow
def test_a_demo_flies_without_extras(folder):
    code = ("import sys; sys.modules.update(matplotlib=None, fast_simplification=None)\n"
            "from glrender_cli.__main__ import main\n"
            "sys.exit(main(['demo', '--frames', '40', '--size-px', '128', '--out', 'out']))")
    made = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=240)
    assert made.returncode == 0, made.stdout + made.stderr
    assert "the same" in made.stdout and "trajectory.png" not in made.stdout
    assert Image.open(folder / "out" / "contact_sheet.png").size[0] > 500
