"""`glrender campaign`: fly a navigation loop over and over, and report its errors against each parameter."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from glrender import GlrenderError
from glrender.sequences.dask_processes import dask_processes
from glrender.sequences.folder import made
from glrender.sequences.processes import checked_processes
from glrender_campaign.campaign_file import Campaign, load_campaign
from glrender_campaign.flight import fly
from glrender_campaign.pictures import Frame, for_the_eye
from glrender_campaign.report import write_report
from glrender_campaign.running import Renderers, fly_all, missing, result_of
from tqdm import tqdm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender campaign`."""
    parser.add_argument("campaign", type=Path, metavar="CAMPAIGN", help="campaign file (TOML): a scenario, and axes")
    parser.add_argument("--out", type=Path, metavar="FOLDER",
                        help="of results and report.html; default: out/ and the file's name. Its cases are kept")
    parser.add_argument("--case", metavar="ID",
                        help="fly this one case again: its frames as pictures, and its error after each")
    parser.add_argument("--processes", type=int, metavar="N", help="0, the default: one for each core")
    parser.add_argument("--dask", metavar="ADDRESS", help="of a Dask scheduler, whose workers fly")


def run(arguments: argparse.Namespace) -> int:
    """Fly the cases that the folder lacks, then write the report; or fly one case."""
    checked_processes(arguments.processes, "--processes")
    campaign = load_campaign(arguments.campaign)
    folder = arguments.out or Path("out") / arguments.campaign.stem
    if arguments.case is not None:
        return _again(campaign, arguments.case, folder)
    n_cases, n_left = len(campaign.cases), len(missing(campaign, folder))
    pool = dask_processes(arguments.dask) if arguments.dask else None
    with tqdm(total=n_cases, initial=n_cases - n_left, unit="case", disable=None) as bar:
        for _ in fly_all(campaign, folder, arguments.processes, pool):
            bar.update()
    results = [result_of(folder, case) for case in campaign.cases]
    try:
        summary = write_report(folder / "report.html", campaign, results, folder)
    except ImportError as error:
        raise GlrenderError(f"the report is drawn by matplotlib: pip install 'glrender[demo]'; all {n_cases} cases are "
                            f"in {folder}") from error
    except OSError as error:
        raise GlrenderError(f"{folder}/report.html: cannot be written: {error.strerror}; all {n_cases} cases are there "
                            "and stay: make room, and start again") from error
    sys.stdout.write(f"{folder}: {n_cases} cases, {n_left} flown now; {summary}\n{folder}/report.html\n")
    return 0


def _again(campaign: Campaign, id: str, folder: Path) -> int:
    case = campaign.case(id)
    frames: list[Frame] = []
    made(folder / id, named=folder)

    def told(frame: Frame) -> None:
        path = folder / id / f"frame_{len(frames):05d}.png"
        try:
            for_the_eye(frame).save(path)
        except OSError as error:
            raise GlrenderError(f"{path}: cannot be written: {error.strerror}; make room, or name another "
                                "--out") from error
        frames.append(frame)
        sys.stdout.write(f"{path}: t = {frame.t_s:g} s, {frame.error_m:.4g} m from the truth, "
                         f"{frame.error_m / frame.range_m:.3%} of the range{'; ' * bool(frame.reason)}{frame.reason}\n")

    renderers = Renderers()
    try:
        result = fly(campaign.setup, case, *renderers.of(campaign.setup, case), told).result
    finally:
        renderers.close()
    sys.stdout.write(json.dumps({name: result[name] for name in ("id", "values", "status", "reason")}, indent=1) + "\n")
    return 0
