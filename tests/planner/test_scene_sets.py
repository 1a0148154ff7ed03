"""Sets of random scenes: what numbers were fitted to is never what holds the promises."""

from __future__ import annotations

import ast
import runpy
from itertools import product
from pathlib import Path

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SETS = runpy.run_path(str(BENCHMARKS / "fits" / "scene_sets.py"))


def test_no_seed_that_numbers_were_fitted_to_holds_a_promise():
    fitted, never = SETS["FITTED"], SETS["NEVER_FITTED"]
    for maker, seeds in never.items():
        assert all(not set(one) & set(other) for one, other in product(seeds, fitted.get(maker, ())))
        assert sum(SETS["n_fitted"](maker, each) for each in seeds) == 0
    assert SETS["n_fitted"]("draw", range(390, 410)) == 10
    assert SETS["n_fitted"]("draw_small", SETS["COVERAGE_FITTED"]) == len(SETS["COVERAGE_FITTED"])


def test_every_kind_of_scene_that_is_held_out_has_its_seeds():
    """The kinds of `heldout.py`, by the names of the functions that make them."""
    tree = ast.parse((BENCHMARKS / "heldout.py").read_text(encoding="utf-8"))
    made, = (node.value.values for node in tree.body if isinstance(node, ast.Assign)
             and ast.unparse(node.targets[0]) == "_DRAWS")
    makers = {ast.unparse(each).rpartition(".")[2] for each in made}
    assert {*makers, "draw"} == set(SETS["NEVER_FITTED"])
