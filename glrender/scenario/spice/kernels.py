"""SPICE's kernels: loaded, asked, and named in errors where they have no answer."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.validate import one_of, text

from ...base.attitude import from_spice
from ...base.errors import ConfigError, error_path
from ..epochs import Epoch

ABERRATIONS = ("NONE", "LT", "LT+S", "CN+S")
_M_PER_KM = 1000.0
SUN, SPACECRAFT = "sun", "spacecraft"
# Whose kernels SPICE's pool has, and the files in it: one pool for a process.
_POOL: dict[str, list] = {}


@dataclass(frozen=True, kw_only=True, eq=False)
class Spice:
    """Kernels, and the positions that they give.

    SPICE has one pool of kernels in a process. Before anything is asked, the pool is made that of `kernels`, in their
    order: of kernels with the same data the last one counts. Others' kernels, and values put into the pool, are
    unloaded.

    Parameters
    ----------
    kernels : sequence of path
        SPK, CK, PCK, FK, IK, SCLK, leap seconds, or meta-kernels.
    observer : str
        SPICE's name or number of the spacecraft.
    aberration : "NONE", "LT", "LT+S" or "CN+S"
        How the observer sees bodies, as in `spkezr`; bodies turn back by the light time too, and the Sun
        stands where each body saw it then.
    ids : mapping of name to str
        SPICE's names or numbers of bodies that have others in the scenario.

    Raises
    ------
    ConfigError
        No spiceypy, a kernel that is missing or that SPICE refuses, with its name.
    """

    kernels: Sequence[str | Path]
    observer: str
    aberration: str = "NONE"
    ids: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self):
        one_of("aberration", self.aberration, ABERRATIONS)
        text("observer", self.observer)
        if not isinstance(self.ids, Mapping):
            raise ConfigError("ids", "must map names to SPICE's names or numbers", self.ids)
        object.__setattr__(self, "kernels", tuple(self.kernels))
        self._load(spiceypy_of("spice"))

    def close(self) -> None:
        """Unload the kernels, where they are those that are loaded."""
        if _POOL.get("kernels") == self._key:
            _POOL.clear()
            spiceypy_of("spice").kclear()

    def code(self, name: str, path: str = "ids") -> int:
        """SPICE's number of a name of the scenario, or of SPICE's own."""
        if name in self._codes:
            return self._codes[name]
        asked = {SUN: "SUN", SPACECRAFT: self.observer}.get(name, str(self.ids.get(name, name)))
        try:
            return self._codes.setdefault(name, self.tool.bods2c(asked))
        except self.error:
            field = "observer" if name == SPACECRAFT else path
            raise ConfigError(field, "must lead to a name or number that SPICE knows", asked,
                              f"give {'another spice.observer' if name == SPACECRAFT else f'spice.ids of {name!r}'}, "
                              "or load the kernel that defines it") from None

    def light_time_s(self, body: str, et_s: float) -> float:
        """How long light takes from a body to the observer [s]; 0 where no aberration is asked for."""
        return 0.0 if self.aberration == "NONE" else self.seen(body, SPACECRAFT, et_s)[1]

    def seen(self, target: str, observer: str, et_s: float, aberration: str | None = None) -> tuple[np.ndarray, float]:
        """State (6,) [m, m/s] in J2000 of a target from an observer, and its light time [s]."""
        codes = self.code(target), self.code(observer)
        state, light_time = self.asked(et_s, "", self.tool.spkez, codes[0], et_s, "J2000",
                                        self.aberration if aberration is None else aberration, codes[1])
        return np.asarray(state) * _M_PER_KM, float(light_time)

    def turned(self, frame: str, et_s: float) -> tuple[np.ndarray, np.ndarray | None]:
        """`frame_from_j2000` (3, 3), and its angular velocity (3,) [rad/s] in the frame, or None if not known.

        Raises
        ------
        ConfigError
            A frame that is not in the kernels, or that a matrix defines that mirrors or shears: SPICE would not say.
        """
        if frame not in self._rotations:
            self.refuse_shears(frame)
            self._rotations.add(frame)
        if frame not in self._without_rates:
            try:
                rotation, rate = self.tool.xf2rav(self.tool.sxform("J2000", frame, et_s))
                return rotation, rotation @ rate
            except self.error:
                pass
        # A CK may have attitudes without rates; to ask for them at each time costs 0.5 ms.
        rotation = self.asked(et_s, "frame", self.tool.pxform, "J2000", frame, et_s)
        self._without_rates.add(frame)
        return rotation, None

    def coverage(self) -> list[str]:
        """The kernels' coverage, a line for each object of each SPK and CK, also of meta-kernels' members."""
        lines, tool = [], self.tool
        for kernel in dict.fromkeys(_pool(tool)):
            kind = tool.getfat(kernel)[1]
            if kind in ("SPK", "CK"):
                for code in tool.spkobj(kernel) if kind == "SPK" else tool.ckobj(kernel):
                    try:
                        cover = (tool.spkcov(kernel, code) if kind == "SPK"
                                 else tool.ckcov(kernel, code, False, "INTERVAL", 0.0, "TDB"))
                    except self.error:
                        lines.append(f"{Path(kernel).name} has {code}, and needs the clock's kernel (SCLK)")
                        continue
                    spans = [tool.wnfetd(cover, index) for index in range(tool.wncard(cover))]
                    if spans:
                        lines.append(f"{Path(kernel).name} has {code} from {_date(spans[0][0])} to "
                                     f"{_date(spans[-1][1])}{f' in {len(spans)} parts' if len(spans) > 1 else ''}")
        return lines

    def asked(self, et_s: float | None, path: str, function: Any, *arguments: Any) -> Any:
        """Ask SPICE; what it refuses is an error with the epoch and the coverage that there is."""
        try:
            return function(*arguments)
        except self.error as error:
            when = "" if et_s is None else f" at {_date(et_s)}"
            loaded = ", ".join(Path(kernel).name for kernel in self.kernels)
            way_out = "coverage: " + ("; ".join(self.coverage()) or f"none in {loaded}")
            if getattr(error, "short", "") == "SPICE(UNKNOWNFRAME)":
                way_out = f"load the frame kernel (FK) that defines it; loaded are {loaded}"
            raise ConfigError(path, f"is not in the kernels{when}: {told_by(error)}", hint=way_out) from None

    def refuse_shears(self, frame: str) -> None:
        """Refuse a frame that kernels define by a matrix that is no rotation, or relative to such a one."""
        chain: list[str] = []
        while frame not in chain:
            chain.append(frame)
            for key in (self.tool.namfrm(frame), frame):
                if self.tool.expool(f"TKFRAME_{key}_MATRIX"):
                    with error_path("frame"):
                        # The check holds for rows and columns alike, so their order does not matter.
                        _of_matrix(f"TKFRAME_{key}_MATRIX", self.tool.gdpool(f"TKFRAME_{key}_MATRIX", 0, 9))
                with contextlib.suppress(self.error):
                    frame = self.tool.gcpool(f"TKFRAME_{key}_RELATIVE", 0, 1)[0]

    @cached_property
    def _codes(self) -> dict[str, int]:
        return {}

    @cached_property
    def _rotations(self) -> set[str]:
        return set()

    @cached_property
    def _without_rates(self) -> set[str]:
        return set()

    @cached_property
    def _key(self) -> list[tuple[str, int, int]]:
        """Names of the kernels, in their order, with times and sizes: a file that was written anew is another one."""
        stats = [(os.path.abspath(kernel), os.stat(kernel)) for kernel in self.kernels]
        return [(name, stat.st_mtime_ns, stat.st_size) for name, stat in stats]

    def _load(self, tool: Any) -> None:
        """Make SPICE's pool that of the kernels, in their order."""
        for index, kernel in enumerate(self.kernels):
            if not Path(kernel).is_file():
                raise ConfigError(f"kernels[{index}]", "is not there", str(kernel),
                                  "put it there; in a scenario file names are relative to that")
        if _POOL.get("kernels") == self._key and _POOL["files"] == _pool(tool):
            return
        _POOL.clear()
        tool.kclear()
        for index, (kernel, _, _) in enumerate(self._key):
            try:
                tool.furnsh(kernel)
            except self.error as error:
                raise ConfigError(f"kernels[{index}]", f"is refused by SPICE: {told_by(error)}",
                                  str(self.kernels[index])) from None
        _POOL.update(kernels=self._key, files=_pool(tool))

    @property
    def tool(self) -> Any:
        """spiceypy, its pool that of the kernels."""
        tool = spiceypy_of("spice")
        # All names cost as much as a position: the number of kernels and the last one show whether the pool is ours.
        if not (_POOL.get("kernels") == self._key and tool.ktotal("ALL") == len(_POOL["files"])
                and _POOL["files"][-1:] == _pool(tool, len(_POOL["files"]) - 1)):
            self._load(tool)
        return tool

    @cached_property
    def error(self) -> type[Exception]:
        """The root of spiceypy's errors."""
        return spiceypy_of("spice").utils.exceptions.SpiceyError


def spiceypy_of(field: str) -> Any:
    """spiceypy, imported when it is needed first; the error where it is missing names a field."""
    try:
        return import_module("spiceypy")
    except ImportError as error:
        raise ConfigError(field, f"needs spiceypy: {error}", hint="pip install 'glrender[spice]'") from None


def _pool(tool: Any, first: int = 0) -> list[str]:
    """Files in SPICE's pool, from one on; meta-kernels and their members."""
    return [tool.kdata(index, "ALL")[0] for index in range(max(first, 0), tool.ktotal("ALL"))]


def _of_matrix(name: str, values: np.ndarray) -> None:
    try:
        from_spice(np.reshape(values, (3, 3)))
    except ConfigError as error:
        error.path = error.path.replace("rotation", name)
        raise


def _date(et_s: float) -> str:
    return f"{Epoch.from_et(et_s).tdb[:19]} TDB"


def told_by(error: Exception) -> str:
    """SPICE's error, in its short and long words."""
    short, long = getattr(error, "short", ""), getattr(error, "long", "")
    return " ".join(f"{short} {long}".split()) or str(error)
