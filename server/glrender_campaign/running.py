"""Runs a campaign's flights in processes, and keeps each as it is done."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from glrender import GlrenderError, Scene, open_renderer
from glrender.base.errors import error_path
from glrender.sequences.folder import made, write_whole
from glrender.sequences.header import same_version
from glrender.sequences.processes import Pool, own_processes

from .believed_side import onboard_scene
from .campaign_file import Campaign, Case, Setup
from .flight import RESULT_KEYS, Flight, fly

_FOLDER = "cases"


def fly_all(campaign: Campaign, folder: Path, n_processes: int | None = None,
            pool: AbstractContextManager[Pool] | None = None) -> Iterator[Case]:
    """Fly the cases that a folder has not yet; yields each when its files are there.

    Parameters
    ----------
    campaign : Campaign
    folder : path
        Made if it is missing. Each case has a result, `cases/ID.json`, and a picture.
    n_processes : int, optional
        By default one for each core.
    pool : context manager of Pool, optional
        Processes elsewhere, as of `dask_processes`, instead of this machine's.

    Raises
    ------
    GlrenderError
        A case cannot be drawn or written; cases that are done stay.
    """
    cases = missing(campaign, folder)
    if not cases:
        return
    made(folder / _FOLDER, named=folder)
    with pool or own_processes(n_processes, start, (campaign.setup,), stop) as processes:
        tasks = ((number, *_task(campaign.setup, case, processes, pool is None)) for number, case in enumerate(cases))
        for number, flight in processes.done(tasks):
            _put(campaign, folder, cases[number], flight)
            yield cases[number]


def missing(campaign: Campaign, folder: Path) -> list[Case]:
    """The cases of a campaign whose whole results a folder has not yet."""
    return [case for case in campaign.cases if result_of(folder, case) is None]


def result_of(folder: Path, case: Case) -> dict[str, Any] | None:
    """The kept result of a case; None where its files are missing, cut or another program's."""
    try:
        result = json.loads(_path(folder, case, "json").read_text(encoding="utf-8"))
        is_whole = (_path(folder, case, "png").stat().st_size and result["id"] == case.id
                    and result.keys() >= RESULT_KEYS and result["error_over_range"].keys() >= {"rms_settled", "last"}
                    and 0 < len(result["track"]) == result["frames"])
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
    return result if is_whole else None


def picture_of(folder: Path, case: Case) -> bytes:
    """The kept picture of a case (PNG)."""
    return _path(folder, case, "png").read_bytes()


def _path(folder: Path, case: Case, ending: str) -> Path:
    return folder / _FOLDER / f"{case.id}.{ending}"


def _task(setup: Setup, case: Case, pool: Pool, is_here: bool) -> tuple[Callable[..., Flight], tuple]:
    return (fly_here, (case,)) if is_here else (fly_elsewhere, (pool.given(setup), case))


def _put(campaign: Campaign, folder: Path, case: Case, flight: Flight) -> None:
    """Write a case's files, the result last: who has one has both."""
    path = _path(folder, case, "json")
    try:
        write_whole(_path(folder, case, "png"), flight.picture)
        write_whole(path, (json.dumps(flight.result) + "\n").encode())
    except OSError as error:
        n_cases = len(campaign.cases)
        n_there = n_cases - len(missing(campaign, folder))
        raise GlrenderError(f"{path}: cannot be written: {error.strerror}; {n_there} of {n_cases} cases are there and "
                            "stay: make room, and start again") from error


class Renderers:
    """The renderers of a process: of the true scene, and of the belief that was asked for last."""

    def __init__(self):
        self._open: dict[str, tuple[Any, Any]] = {}

    def of(self, setup: Setup, case: Case) -> tuple[Any, Any]:
        """The true scene's and the believed scene's."""
        truth = self._kept("truth", setup, lambda: setup.scene)
        return truth, self._kept("belief", case.belief_key, lambda: _believed(setup, case))

    def close(self) -> None:
        """Close both."""
        for _, renderer in self._open.values():
            renderer.close()
        self._open = {}

    def _kept(self, role: str, key: Any, scene: Callable[[], Scene]) -> Any:
        if role not in self._open or self._open[role][0] != key:
            if role in self._open:
                self._open.pop(role)[1].close()
            self._open[role] = (key, open_renderer(scene()))
        return self._open[role][1]


def _believed(setup: Setup, case: Case) -> Scene:
    with error_path(f"case {case.id}"):
        return onboard_scene(setup.scene, case.belief)


# A process has its renderers, the setup that it got at its start, and the thread that OpenGL stays on.
_renderers = Renderers()
_setup: Setup | None = None
_thread = ThreadPoolExecutor(1)


def start(setup: Setup) -> None:
    """Begin a process of this machine."""
    global _setup
    _setup = setup


def stop() -> None:
    """End what `start` began, where the process goes on."""
    _renderers.close()


def fly_here(case: Case) -> Flight:
    """Fly a case in a process that `start` began."""
    return fly(_setup, case, *_renderers.of(_setup, case))


def fly_elsewhere(setup: Setup, case: Case) -> Flight:
    """Fly a case in a process that others began.

    Raises
    ------
    ConfigError
        Another version of glrender there.
    """
    same_version(setup.version)
    return _thread.submit(lambda: fly(setup, case, *_renderers.of(setup, case))).result()
