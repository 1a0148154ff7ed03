"""What looks for faults in our C by itself: gcc's analyzer over all of it, and a fuzzer of the reply parser.

The fuzzer runs for 4 s; $GLRENDER_FUZZ_SECONDS says otherwise. clang's libFuzzer is guided by coverage; without clang
(tools/install_clang.sh brings it) gcc builds the same harness with a driver that mutates blindly.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import serving
from missing import missing
from octave_runner import REMEDY, REPOSITORY, SIMULINK, compiler

HERE = Path(__file__).parent / "c"
OURS = sorted([*SIMULINK.glob("*.c"), *(REPOSITORY / "benchmarks").glob("*.c"),
               # It is a part of sfun_glrender_c.c, as Simulink's own is.
               *(path for path in HERE.glob("*.c") if path.name != "simulink.c")])
INCLUDES = [f"-I{SIMULINK}", f"-I{HERE}"]
WARNINGS = ["-Wall", "-Wextra", "-Wno-unused-function", "-Werror"]
SANITIZERS = "address,undefined"
SECONDS = int(os.environ.get("GLRENDER_FUZZ_SECONDS", "4"))


@pytest.mark.parametrize("source", OURS, ids=lambda path: path.name)
def test_gccs_analyzer_finds_nothing(source):
    gcc = shutil.which("gcc")
    if gcc is None:
        missing("GCC, WHOSE ANALYZER THIS IS,", REMEDY)
    run = subprocess.run([gcc, "-std=c99", "-O1", "-fanalyzer", *WARNINGS, "-DMATLAB_MEX_FILE", "-DPLAIN_DRIVER",
                          *INCLUDES, "-c", source, "-o", os.devnull], capture_output=True, text=True)
    assert run.returncode == 0 and "warning" not in run.stderr, run.stderr


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """The golden replies, each as its TCP frame."""
    folder = tmp_path_factory.mktemp("corpus")
    golden = json.loads((REPOSITORY / "tests" / "data" / "golden.json").read_text(encoding="ascii"))
    for name, parts in golden.items():
        parts = [bytes.fromhex(part) for part in parts]
        if name.startswith(("reply_", "tcp_reply_")):
            (folder / name).write_bytes(parts[0] if name.startswith("tcp_") else serving.Framed.frame(*parts))
    assert len(list(folder.iterdir())) >= 10
    return folder


def built(folder, program, *more):
    """The harness, or None where the compiler lacks what it asks for."""
    sources = [HERE / "fuzz_reply.c", *(SIMULINK / f"glr_{name}.c" for name in ("request", "reply", "wire"))]
    run = subprocess.run([program, "-std=c99", "-g", "-O1", "-fno-sanitize-recover=all", *WARNINGS, *INCLUDES, *more,
                          *sources, "-o", folder / "fuzz_reply"], capture_output=True, text=True)
    return folder / "fuzz_reply" if run.returncode == 0 else None


def test_no_reply_leads_the_c_client_astray(tmp_path, corpus):
    """Whatever a server sends: an error with a code, or images whose every byte is there."""
    clang = shutil.which("clang")
    guided = clang and built(tmp_path, clang, f"-fsanitize=fuzzer,{SANITIZERS}")
    if guided:
        (tmp_path / "found").mkdir()
        command = [guided, f"-max_total_time={SECONDS}", "-max_len=16384", "-timeout=10", "-rss_limit_mb=4096",
                   "-verbosity=0", "-print_final_stats=1", f"-artifact_prefix={tmp_path}/", tmp_path / "found", corpus]
    else:
        plain = built(tmp_path, compiler(), f"-fsanitize={SANITIZERS}", "-DPLAIN_DRIVER")
        assert plain, "the harness does not compile"
        command = [plain, str(SECONDS), "20261126", *sorted(corpus.iterdir())]
    run = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=SECONDS + 120)
    spoilt = [f"{path.name}: {path.read_bytes().hex()}" for path in tmp_path.glob("*-*") if path.is_file()]
    assert run.returncode == 0, f"{run.stderr[-4000:]}\n{spoilt}"
    count = re.search(r"number_of_executed_units: (\d+)|(\d+) inputs", run.stderr + run.stdout)
    assert count and int(count[1] or count[2]) > 1000 * SECONDS, "it hardly ran"
