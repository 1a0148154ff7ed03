"""The report of a campaign: one HTML file that needs no other and no network."""

from __future__ import annotations

import base64
import html
import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from glrender.sequences.folder import write_whole

from .campaign_file import Campaign, Case
from .plots import error_against, tracks
from .running import picture_of

_WORST = 6
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; background: #fff; max-width: 60rem; margin: 0 auto;
  padding: 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; overflow-wrap: anywhere; }
img { max-width: 100%; height: auto; } figure { margin: 0 0 1rem; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: 0.85rem; }
th, td { text-align: left; padding: 0.2rem 0.7rem 0.2rem 0; border-bottom: 1px solid #ddd; white-space: nowrap; }
td:last-child { white-space: normal; min-width: 8rem; }
code { background: #f2f2f2; padding: 0.1rem 0.3rem; overflow-wrap: anywhere; }
article { border-top: 1px solid #ccc; padding: 0.8rem 0; } article p { margin: 0.2rem 0; }
.lost { color: #b71c1c; font-weight: 600; }
"""


def write_report(path: Path, campaign: Campaign, results: Sequence[Mapping[str, Any]], folder: Path) -> str:
    """Write the report; returns its first sentence.

    Parameters
    ----------
    path : path
    campaign : Campaign
    results : sequence of mappings
        Of all cases, in their order.
    folder : path
        Of the cases' files.

    Raises
    ------
    ImportError
        There is no matplotlib.
    OSError
    """
    summary = _told(results)
    worst = sorted(range(len(results)), key=lambda index: -_badness(results[index]))[:_WORST]
    by_estimator = len(campaign.axes["estimator"]) > 1
    parts = [f"<h1>Campaign {html.escape(campaign.path.stem)}</h1>", f"<p>{html.escape(summary)}</p>",
             _settings(campaign),
             "<p>The error is the distance between the estimated and the true position, as a share of the range: root "
             "mean square over the last two thirds of the frames. A case has lost the body where the on-board side "
             "failed, ends more than 10 % of the range off, or accepted no measurement in these frames.</p>"]
    for name in campaign.varied:
        values = [_text(value) for value in campaign.axes[name]]
        places = [campaign.axes[name].index(case.values[name]) for case in campaign.cases]
        groups = [case.values["estimator"] if by_estimator and name != "estimator" else "" for case in campaign.cases]
        short = _short(campaign, name)
        parts += [f"<h2>Error against {html.escape(short)}</h2>",
                  _figure(error_against(short, values, results, places, groups), f"error against {name}"),
                  _table_of_axis(short, values, results, places)]
    parts += ["<h2>Error along the flight</h2>", _figure(tracks(results), "error after each frame"),
              "<h2>Worst cases</h2>", "<p>First, worst and last frame of each: the green ring is where the body's "
              "origin is, the orange cross where the estimator has it.</p>",
              *(_article(campaign, campaign.cases[index], results[index], folder) for index in worst),
              "<h2>All cases</h2>", _table_of_cases(campaign, results)]
    page = ('<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width">'
            f"<title>{html.escape(campaign.path.stem)}</title><style>{_STYLE}</style></head><body>"
            f"{''.join(parts)}</body></html>\n")
    write_whole(path, page.encode())
    return summary


def command_of(campaign: Campaign, case: Case, folder: Path) -> str:
    """The command that flies a case again."""
    return f"glrender campaign {shlex.quote(str(campaign.path))} --out {shlex.quote(str(folder))} --case {case.id}"


def _told(results: Sequence[Mapping[str, Any]]) -> str:
    kept = [100.0 * result["error_over_range"]["rms_settled"] for result in results if result["status"] == "kept"]
    text = f"{len(kept)} of {len(results)} cases kept the body, {len(results) - len(kept)} lost it"
    if not kept:
        return f"{text}."
    return (f"{text}; of those kept the median error is {np.median(kept):.2g} % of the range, the 95th percentile "
            f"{np.percentile(kept, 95):.2g} %.")


def _badness(result: Mapping[str, Any]) -> float:
    # Lost ones first.
    return result["error_over_range"]["rms_settled"] + 1e9 * (result["status"] == "lost")


def _settings(campaign: Campaign) -> str:
    setup, axes = campaign.setup, campaign.axes
    span_s = setup.states[-1].t_s - setup.states[0].t_s
    rows = {"flight": f"{len(setup.states)} frames over {span_s:g} s about {setup.body}, camera {setup.camera}, "
                      f"pointed by the {setup.pointing}",
            "first estimate": f"off by {setup.handover:.3g} of the range", "glrender": setup.version,
            **{_short(campaign, name): ", ".join(map(_text, values)) for name, values in axes.items()}}
    return _table([], [[f"<b>{html.escape(name)}</b>", html.escape(text)] for name, text in rows.items()])


def _table_of_axis(name: str, values: Sequence[str], results: Sequence[Mapping[str, Any]],
                   places: Sequence[int]) -> str:
    rows = []
    for place, value in enumerate(values):
        own = [result for result, at in zip(results, places, strict=True) if at == place]
        kept = [100.0 * result["error_over_range"]["rms_settled"] for result in own if result["status"] == "kept"]
        ms = np.median([result["on_board_ms"] for result in own])
        errors = [f"{number(kept):.3g} %" if kept else "" for number in (np.median, _percentile_95)]
        rows.append([html.escape(value), str(len(own)), _lost(len(own) - len(kept)), *errors, f"{ms:.3g} ms"])
    return _table([name, "cases", "lost", "median error", "95th percentile", "on board, a frame"], rows)


def _table_of_cases(campaign: Campaign, results: Sequence[Mapping[str, Any]]) -> str:
    rows = [[f"<code>{case.id}</code>", *(html.escape(_text(case.values[name])) for name in campaign.varied),
             _error(result), f"{result['accepted']} of {result['frames']}", html.escape(result["reason"][:120])]
            for case, result in zip(campaign.cases, results, strict=True)]
    varied = [_short(campaign, name) for name in campaign.varied]
    return _table(["case", *varied, "error", "accepted frames", "why it is lost"], rows)


def _article(campaign: Campaign, case: Case, result: Mapping[str, Any], folder: Path) -> str:
    picture = base64.b64encode(picture_of(folder, case)).decode()
    values = ", ".join(f"{_short(campaign, name)} {_text(case.values[name])}" for name in campaign.varied)
    lost = f'<p class="lost">lost: {html.escape(result["reason"])}</p>' if result["status"] == "lost" else ""
    return (f"<article><p><b>{_error(result)}</b> {html.escape(values)}</p>{lost}"
            f'<p><img alt="first, worst and last frame" src="data:image/png;base64,{picture}"></p>'
            f"<p><code>{html.escape(command_of(campaign, case, folder))}</code></p></article>")


def _error(result: Mapping[str, Any]) -> str:
    return f"{100.0 * result['error_over_range']['rms_settled']:.3g} %"


def _lost(count: int) -> str:
    return f'<span class="lost">{count}</span>' if count else "0"


def _percentile_95(values: Sequence[float]) -> float:
    return float(np.percentile(values, 95))


def _short(campaign: Campaign, name: str) -> str:
    """An axis' name without the tables that beliefs are in: ``believed itokawa.facets``."""
    if name not in campaign.paths:
        return name
    steps = campaign.paths[name]
    return f"believed {'.'.join(steps[2:] if len(steps) > 3 else steps[1:])}"


def _text(value: Any) -> str:
    """A value of an axis, for a person."""
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list) and all(isinstance(each, Mapping) and "kind" in each for each in value):
        # Faults.
        return ", ".join(map(_fault, value)) or "none"
    return json.dumps(value, default=str)


def _fault(table: Mapping[str, Any]) -> str:
    share = table.get("probability", 1.0)
    return str(table["kind"]) + f" in {share:.3g} of the frames" * (share < 1.0)


def _figure(svg: str, alt: str) -> str:
    data = base64.b64encode(svg.encode()).decode()
    return f'<figure><img alt="{html.escape(alt)}" src="data:image/svg+xml;base64,{data}"></figure>'


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of cells that are HTML already, under a head that is text."""
    top = f"<tr>{''.join(f'<th>{html.escape(each)}</th>' for each in head)}</tr>" if head else ""
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f'<div class="scroll"><table>{top}{body}</table></div>'
