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
    "Thin crescents: beyond a phase angle of 160 deg light falls in slivers narrower than a pixel, and no engine meets "
    "a tolerance of 0.02. The plan warns of it; the backend raytrace is more exact.",
    "Panels, booms and other parts narrower than 0.5 px, by rays or OpenGL: samples pass them by, and an RMS error of "
    "0.05 may be left. The prediction shows it, but not behind a lens, nor with a texture or with smooth normals on "
    "10,000 facets or more. Coverage draws flat facets exactly.",
    "Coverage by centroids (each facet is lit or dark as a whole): the prediction is calibrated, not a bound. A rough "
    "body of 29 px had an RMS error of 0.058 where 0.019 was predicted, and no warning.",
    "Few, large facets at phase angles of 80 to 100 deg: light between the corners of a facet is missed. A shape of "
    "464 facets had an RMS error of 0.031 where 0.018 was predicted.",
    "Boulders that are shells of their own, on larger facets: coverage counts the ground below them too, and they come "
    "out 0.1 to 0.9 % too bright.",
    "Bodies below 3 px: only 78 % of RMS errors and 74 % of errors of the centre are within the prediction; the worst "
    "centre was off by 10.6 times it.",
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
            "<h2>Known faults</h2><p>RMS errors are over the mean of the lit pixels: 0.02 is 2 %. The page "
            "docs/accuracy.md has more of each, under Where it fails.</p>"
            f"<ul>{''.join(f'<li>{html.escape(each)}</li>' for each in pack['known_faults'])}</ul>"
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
