"""The pack: one HTML page and one JSON file of the checks, with versions, known faults and levels of credibility."""

from __future__ import annotations

import html
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from glrender.engines.raster.gl.context import probe

from .checks import Check

_PACKAGES = ("glrender", "numpy", "scipy", "numba", "moderngl", "embreex", "opencv-contrib-python-headless", "pyzmq")
KNOWN_FAULTS = (
    "At phase angles beyond 150 deg light falls in slivers narrower than a pixel; the plan warns of missed tolerances.",
    "Parts narrower than 0.5 px by rays or OpenGL may keep an error of 0.05; behind a lens, or with textures or smooth "
    "normals of 10,000 facets or more, without a sign.",
    "The error by centroids is calibrated, not a bound: 0.058 was found where 0.019 was predicted.",
    "Facets that are larger than shadows between their corners miss light: 0.031 where 0.018 was predicted.",
    "Boulders that are shells of their own come out 0.1 to 0.9 % too bright by coverage.",
    "Errors of the shape model, of the reflectance law, light between facets and light time are in no prediction.")
"""Of docs/accuracy.md, "Where it fails"."""
LEVELS = (
    ("Data pedigree", 2, "Shapes and laws of public archives with their sources; a mission's own are the user's."),
    ("Verification", 3, "Closed forms, float64 rays, Mitsuba and Cycles in the project's tests; this pack has a few."),
    ("Validation", 2, "Against flight images of three bodies, by correlation and by another program's ray casts; "
                      "no camera of a mission was calibrated with it."),
    ("Input pedigree", 1, "Scenes and states are the caller's; units are checked for plausibility."),
    ("Uncertainty characterization", 2,
     "Each frame predicts its sampling error in five units; that of shape and law is not predicted."),
    ("Results robustness", 2, "Random, hostile and fuzzed scenes in the project's tests; campaigns vary a user's own."),
    ("Use history", 0, "No mission is known to have flown on it."),
    ("Process management", 1, "Versions, changes and tests are kept; there is no independent review."))
"""Factors, levels from 0 to 4 and reasons, by the authors' own judgement after NASA-STD-7009B."""
_STYLE = ("body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
          "table{border-collapse:collapse;width:100%}td,th{border-bottom:1px solid #bbb;padding:.3rem .6rem;"
          "text-align:left;vertical-align:top}.no{color:#b00020;font-weight:bold}"
          "@media(prefers-color-scheme:dark){body{background:#111;color:#ddd}.no{color:#ff7b7b}}")


def versions() -> dict[str, str]:
    """Versions of packages, and the machine."""
    found = {"Python": platform.python_version(), "machine": f"{platform.system()} {platform.machine()}"}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found | {f"OpenGL by {each['backend']}": each.get("gl_renderer") or f"none: {each.get('error', '')}"
                    for each in probe()}


def write_pack(folder: Path, found: Sequence[Check]) -> tuple[Path, Path]:
    """Write `credibility.json` and `credibility.html` into a folder, which is made; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    pack = {"checks": [asdict(check) | {"holds": check.holds} for check in found], "known_faults": list(KNOWN_FAULTS),
            "levels": [{"factor": factor, "level": level, "reason": reason} for factor, level, reason in LEVELS],
            "levels_of": "authors' own judgement, after NASA-STD-7009B; 0 to 4", "versions": versions()}
    paths = folder / "credibility.json", folder / "credibility.html"
    paths[0].write_text(json.dumps(pack, indent=1) + "\n", encoding="utf-8")
    paths[1].write_text(_page(pack), encoding="utf-8")
    return paths


def _page(pack: dict[str, Any]) -> str:
    names = ("check", "number is", "number", "at most", "holds", "domain", "against")
    checks = [(each["name"], each["requirement"], f"{each['number']:.3g}", f"{each['most']:.3g}", each["holds"],
               each["domain"], each["reference"]) for each in pack["checks"]]
    held = sum(each["holds"] for each in pack["checks"])
    return ("<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
            f"content=\"width=device-width\"><title>Credibility of glrender</title><style>{_STYLE}</style></head><body>"
            f"<h1>Credibility of glrender {html.escape(pack['versions']['glrender'])}</h1>"
            f"<p>{held} of {len(checks)} checks hold on this machine. A number of 0 against rays is below "
            "the rays' own error. Each holds for its domain alone.</p>"
            f"<h2>Checks</h2>{_table(names, checks)}"
            f"<h2>Known faults</h2><ul>{''.join(f'<li>{html.escape(each)}</li>' for each in pack['known_faults'])}</ul>"
            "<h2>Levels of credibility</h2><p>These are the authors' own judgement, after the factors of "
            "NASA-STD-7009B, from 0 to 4; nobody else has assessed them.</p>"
            f"{_table(('factor', 'level', 'reason'), [tuple(each.values()) for each in pack['levels']])}"
            f"<h2>Versions</h2>{_table(('part', 'version'), pack['versions'].items())}</body></html>\n")


def _table(names: Sequence[str], rows: Any) -> str:
    def cell(value: Any) -> str:
        if isinstance(value, bool):
            return "<td>yes</td>" if value else '<td class="no">no</td>'
        return f"<td>{html.escape(str(value))}</td>"

    body = "".join(f"<tr>{''.join(map(cell, row))}</tr>" for row in rows)
    return f"<table><tr>{''.join(f'<th>{html.escape(name)}</th>' for name in names)}</tr>{body}</table>"
