"""README.md repeats the figures of the results' pages, as benchmarks/readme.py fills them in."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "readme.py"))
README, RESULTS, SERVICE = SCRIPT["pages"]()


def test_the_readme_has_the_results_figures():
    """Otherwise: python benchmarks/readme.py."""
    assert SCRIPT["filled"](README, RESULTS, SERVICE) == README


@pytest.mark.parametrize("before, after, line", [
    ("| 7.04, 0.029 | 7.21, 0.029 |", "| 7.04, 0.029 | 9.3, 0.029 |", "takes 9 ms at an RMS error of 5 %"),
    ("3.1M | 1270, 0.043 | 1470, 0.020 | 474,", "3.1M | 1270, 0.043 | 1470, 0.020 | 9,",
     "| 3.1 million rough facets | 9 |"),
    ("| 512, 1024 | 304, 107 |", "| 512, 1024 | 299, 107 |", "to 299 frames/s"),
    ("| all | 58 | 97 % | 97 % |", "| all | 61 | 97 % | 93 % |", "Of 61 random scenes 93 %"),
    ("| 224 s on the same", "| 300 s on the same", "5.0 minutes")])
def test_other_results_make_another_readme(before, after, line):
    assert RESULTS.count(before) == 1
    assert line not in README and line in SCRIPT["filled"](README, RESULTS.replace(before, after), SERVICE)


def test_a_sentence_or_a_row_that_is_gone_is_named():
    with pytest.raises(LookupError, match="frames/s"):
        SCRIPT["filled"](README.replace("frames/s", "images/s"), RESULTS, SERVICE)
    with pytest.raises(LookupError, match="python tcp"):
        SCRIPT["filled"](README, RESULTS, SERVICE.replace("| python tcp", "| python pipe"))
