"""Find which fitted constants tests hold: `python benchmarks/fits/mutate.py [--only NAME ...] [--full] [--out FILE]`.

Each number that a module of the planner, the views or exact coverage assigns on top is doubled, then halved, and the
tests of the planner and the views are run with it: those that need no OpenGL, or with `--full` all of them. Default
arguments and numbers within functions are left out. Writes a table of constants with the test that notices; a number
that none notices is no more than a round choice, and its comment should say so.

Each run is a process of its own, in which the constant's module is evaluated anew; loops that Numba has compiled keep
the numbers that they were compiled with, so that constants of `*_loops.py` are not tried.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import subprocess
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = ("tests/planner", "tests/view")
# Seconds that a run may take, and what a child writes before its answer.
_MOST_S, _MARK = 1800, "noticed by:"
# Words of tests that draw: what they need takes seconds.
_DRAWING = ("renderer", "Renderer", "RayTracer", "RayEngine", "lattice", "take_frame", "draw_still", "check_units")


def constants() -> Iterator[tuple[Path, ast.stmt, ast.Constant]]:
    """Numbers in the assignments of the rooms' modules, with their files and statements."""
    rooms = [ROOT / "glrender" / room for room in ("planner", "view", "engines/coverage")]
    files = [*(file for room in rooms for file in sorted(room.glob("*.py"))), ROOT / "glrender/engines/irradiance.py"]
    for file in files:
        if file.name.endswith(("_loops.py", "accumulate.py")):
            continue
        for statement in _assignments(ast.parse(file.read_text(encoding="utf-8"))):
            for node in ast.walk(statement.value):
                if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
                    yield file, statement, node


def _assignments(tree: ast.Module) -> list[ast.stmt]:
    return [each for each in tree.body if isinstance(each, (ast.Assign, ast.AnnAssign)) and each.value is not None]


def name_of(statement: ast.stmt) -> str:
    """The name, or names, that a statement assigns."""
    return ast.unparse(statement.targets[0] if isinstance(statement, ast.Assign) else statement.target)


def mutate(file: Path, place: tuple[int, int], factor: float) -> None:
    """Multiply the number at a line and column of a file, in this process."""
    module = importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
    tree = ast.parse(file.read_text(encoding="utf-8"))
    before = dict(vars(module))
    for statement in _assignments(tree):
        for node in ast.walk(statement.value):
            if isinstance(node, ast.Constant) and (node.lineno, node.col_offset) == place:
                node.value = type(node.value)(node.value * factor) if node.value * factor >= 1 else node.value * factor
        exec(compile(ast.Module([statement], []), str(file), "exec"), vars(module))  # noqa: S102
    changed = {name: value for name, value in vars(module).items() if name in before and before[name] is not value}
    for other in [each for each in list(sys.modules.values()) if each is not module and hasattr(each, "__dict__")]:
        for name, value in changed.items():
            if name in vars(other) and vars(other)[name] is before[name]:
                setattr(other, name, value)


class _Plugin:
    """Leaves out tests that draw, and keeps the first that fails."""

    def __init__(self, is_full: bool):
        self.is_full, self.failed = is_full, ""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if not self.is_full:
            items[:] = [item for item in items if "renderer" not in item.fixturenames and not any(
                word in inspect.getsource(item.function) for word in _DRAWING)]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid.rpartition("/")[2]

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.failed = f"{report.nodeid} is not imported"


def run_mutated(file: Path, place: tuple[int, int], factor: float, is_full: bool, tests: list[str]) -> str:
    """The first test that fails in this process with a number multiplied, or nothing."""
    plugin = _Plugin(is_full)
    try:
        mutate(file, place, factor)
        pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *tests], plugins=[plugin])
    except Exception:
        return traceback.format_exc().splitlines()[-1]
    return plugin.failed


def noticed_by(file: Path, place: tuple[int, int], factor: float, is_full: bool, tests: list[str]) -> str:
    """The same in a process of its own."""
    asked = [str(file), str(place[0]), str(place[1]), str(factor)]
    command = [sys.executable, __file__, *(["--full"] if is_full else []), "--child", *asked, "--tests", *tests]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_MOST_S, check=False)
    except subprocess.TimeoutExpired:
        return f"no end in {_MOST_S} s"
    _, _, told = done.stdout.rpartition(_MARK)
    return told.strip() if _MARK in done.stdout else f"ends with {done.returncode}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", metavar="NAME", help="constants or files with one of these names")
    parser.add_argument("--full", action="store_true", help="also tests that draw")
    parser.add_argument("--factors", nargs="*", type=float, default=(2.0, 0.5))
    parser.add_argument("--tests", nargs="*", default=[str(ROOT / each) for each in TESTS])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutations.md")
    parser.add_argument("--child", nargs=4, metavar=("FILE", "LINE", "COLUMN", "FACTOR"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        file, line, column, factor = arguments.child
        told = run_mutated(Path(file), (int(line), int(column)), float(factor), arguments.full, arguments.tests)
        sys.stdout.write(f"{_MARK} {told}\n")
        return
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    rows, n_noticed, found = [], 0, list(constants())
    first, _, number = found[0]
    if told := noticed_by(first, (number.lineno, number.col_offset), 1.0, arguments.full, arguments.tests):
        parser.exit(1, f"a test fails without any change: {told}\n")
    for file, statement, node in found:
        name = name_of(statement)
        if arguments.only and not any(each in name or each == file.name for each in arguments.only):
            continue
        told = [noticed_by(file, (node.lineno, node.col_offset), factor, arguments.full, arguments.tests)
                for factor in arguments.factors]
        n_noticed += all(told)
        rows.append(f"| {file.relative_to(ROOT / 'glrender')} | `{name}` | {node.value:g} | {' | '.join(told)} |")
        sys.stderr.write(rows[-1] + "\n")
        head = "| file | constant | value | " + " | ".join(f"times {factor:g}" for factor in arguments.factors) + " |"
        arguments.out.write_text("\n".join([head, "|" + "---|" * (3 + len(arguments.factors)), *rows, "",
                                            f"{n_noticed} of {len(rows)} are noticed."]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
