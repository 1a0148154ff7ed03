"""The tutorial of the MATLAB client, run as it is printed by GNU Octave against a live server; its pictures with it."""

from __future__ import annotations

import json
import os
import re
import shutil

import numpy as np
import pytest
import serving
from missing import missing
from octave_runner import REMEDY, REPOSITORY, SIMULINK, octave
from PIL import Image

PAGE = SIMULINK / "README.md"
BLOCKS = re.findall(r"```matlab tutorial\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
PICTURES = ("frame", "range", "loop")


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The folder with what the tutorial left; of the address only the port is another."""
    for program, package in (("gnuplot", "gnuplot-nox"), ("gs", "ghostscript")):
        if shutil.which(program) is None:
            missing(f"{program.upper()} ({package}), WHICH OCTAVE DRAWS WITH", REMEDY)
    folder = tmp_path_factory.mktemp("tutorial")
    scene = (REPOSITORY / "examples" / "contact_binary.toml").read_text(encoding="utf-8")
    with serving.server(folder, "--tcp", "127.0.0.1:0", scene=scene) as (_, process):
        host, port = serving.tcp_address(process)
        for number, block in enumerate(BLOCKS, 1):
            text = block.replace("'127.0.0.1', 5556", f"'{host}', {port}, 'Timeout', 60")
            (folder / f"block_{number}.m").write_text(text.replace("addpath clients/simulink\n", ""))
        octave("tutorial_script.m", folder, timeout=300)
    if target := os.environ.get("GLRENDER_TUTORIAL_PICTURES"):
        for name in PICTURES:
            # A palette: a third of the bytes.
            picture = Image.open(folder / f"tutorial_{name}.png").convert("RGB").quantize(64)
            picture.save(f"{target}/tutorial_{name}.png", optimize=True)
    return folder


def test_the_blocks_do_what_the_tutorial_tells(ran):
    found = json.loads((ran / "found.json").read_text())
    assert len(BLOCKS) == 5 and found["n_warnings"] == 0 and 500 < found["dn_max"] < 4000
    # The moonlet of 40 m is nearest, at a depth of 3700 m; the beam along the boresight meets the primary.
    assert 3640.0 < found["range_m"] < 3740.0 and 3650.0 < np.ravel(found["ranges_m"])[0] < 4000.0
    # It settles where the centre of brightness lies, on the lit side.
    errors = np.ravel(found["errors_px"])
    assert errors[0] > 100.0 and errors[-3:].max() < 50.0


@pytest.mark.parametrize("name", PICTURES)
def test_the_pictures_are_those_that_octave_draws(ran, name):
    """GLRENDER_TUTORIAL_PICTURES=clients/simulink/img writes them anew."""
    kept = SIMULINK / "img" / f"tutorial_{name}.png"
    drawn, stored = (np.asarray(Image.open(path).convert("L").resize((112, 84)), float)
                     for path in (ran / kept.name, kept))
    assert np.corrcoef(drawn.ravel(), stored.ravel())[0, 1] > 0.97 and kept.stat().st_size < 60_000
    assert f"img/{kept.name}" in PAGE.read_text(encoding="utf-8")
