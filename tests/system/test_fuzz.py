"""What reads a stranger's bytes, fuzzed: the wire's header and frames, scenes, shape files, textures and tables.

A value or a GlrenderError in bounded time and memory; never another exception. Each runs for 4 s, or for
$GLRENDER_FUZZ_SECONDS, which `make test-all` sets to 15, guided by coverage where Atheris is installed; what
`benchmarks/fuzz.py` does with whole servers is in tests/server, the C client's fuzzer in tests/clients.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SECONDS = int(os.environ.get("GLRENDER_FUZZ_SECONDS", "2"))
# Inputs a second: a hundredth of what an idle machine does. Below that it would be no fuzzer.
LEAST = {"codec": 100, "framing": 20, "scene": 0.5, "shape": 2, "texture": 2}


def fuzzed(target, folder, *more, seconds=SECONDS):
    return subprocess.run([sys.executable, str(BENCHMARKS / "fuzz_guided.py"), target, "--seconds", str(seconds),
                           "--corpus", str(folder), *more], capture_output=True, text=True, timeout=seconds + 240)


@pytest.mark.parametrize("target", LEAST)
def test_any_bytes_give_a_value_or_an_error_of_ours(tmp_path, target):
    run = fuzzed(target, tmp_path)
    spoilt = [f"{path.name}: {path.read_bytes()[:2000].hex()}" for path in tmp_path.glob("*-*")
              if path.name.startswith(("crash", "timeout", "oom", "slow"))]
    assert run.returncode == 0 and not spoilt, f"{run.stderr[-6000:]}\n{spoilt}"
    record = json.loads(run.stdout.splitlines()[-1])
    assert record["inputs"] > LEAST[target] * SECONDS, record


def test_without_atheris_the_same_is_done_blindly(tmp_path):
    run = fuzzed("codec", tmp_path, "--blind", seconds=2)
    assert run.returncode == 0, run.stderr[-4000:]
    record = json.loads(run.stdout)
    assert not record["guided"] and record["inputs"] > 100


@pytest.mark.parametrize("more", [[], ["--blind"]], ids=["guided", "blind"])
def test_what_is_wrong_is_found_and_kept(tmp_path, monkeypatch, more):
    """A framing whose refusals are an exception that is none of ours."""
    (tmp_path / "sitecustomize.py").write_text("import glrender_server.framing as framing\n"
                                               "framing.ProtocolError = lambda *_: KeyError('planted')\n")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    run = fuzzed("framing", tmp_path / "corpus", *more, seconds=30)
    assert run.returncode != 0 and "planted" in run.stderr + run.stdout
    (found,) = (tmp_path / "corpus").glob("crash-*")
    again = fuzzed("framing", tmp_path / "corpus", "--input", str(found))
    assert again.returncode != 0 and "planted" in again.stderr
