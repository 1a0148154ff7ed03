"""Plug-ins are found, never imported by name: entry-point groups, each name with one owner. See docs/plugins.md.

A plug-in is loaded when its name is asked for: one that is broken breaks nothing but itself.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from ... import brdf
from ...base.errors import PluginError
from ...brdf import GlslText, Law

API = 1
"""Version of the interfaces in docs/plugins.md: what a plug-in's class must say as `glrender_api`."""
BRDF_GROUP, BACKEND_GROUP, EMISSION_GROUP = "glrender.brdf", "glrender.backend", "glrender.emission"
SHAPE_GROUP = "glrender.shape"
OPENGL_BACKENDS = ("auto", "egl", "osmesa")


class Plugins(Mapping[str, type]):
    """The classes of one entry-point group by name, each loaded when it is asked for.

    Parameters
    ----------
    group : str
    check : callable
        Called with a name and its class; what breaks a rule is said in words.
    own : mapping of str to type
        glrender's own, which no plug-in replaces.
    reserved : sequence of str
        Further names that no plug-in may have.
    """

    def __init__(self, group: str, check: Callable[[str, Any], str | None], own: Mapping[str, type] | None = None,
                 reserved: Iterable[str] = ()):
        self.group, self._check, self._own, self._reserved = group, check, dict(own or {}), frozenset(reserved)
        self._entries: dict[str, list[EntryPoint]] = {}
        for entry in entry_points(group=group):
            owners = self._entries.setdefault(entry.name, [])
            # A package that two folders of the path hold is found twice.
            if not any(_owner(entry) == _owner(other) and entry.value == other.value for other in owners):
                owners.append(entry)
        self._loaded: dict[str, type] = {}

    def __iter__(self) -> Iterator[str]:
        return iter([*self._own, *(name for name in self._entries if name not in self._own
                                   and name not in self._reserved)])

    def __len__(self) -> int:
        return len(list(iter(self)))

    def __contains__(self, name: object) -> bool:
        return name in list(iter(self))

    def __getitem__(self, name: str) -> type:
        """The class of a name.

        Raises
        ------
        PluginError
            It cannot be used; the message names the package whose fault it is.
        KeyError
            No such name.
        """
        if name in self._own:
            return self._own[name]
        if name not in self:
            raise KeyError(name)
        if name not in self._loaded:
            self._loaded[name] = self._load(name)
        return self._loaded[name]

    def problems(self) -> list[PluginError]:
        """Errors of the plug-ins that cannot be used; each plug-in is loaded."""
        found = []
        for name, entries in self._entries.items():
            if name in self._own or name in self._reserved:
                found += [PluginError(f"{self.group}.{name}", "is a name of glrender itself", entry.value,
                                      f"{_owner(entry)} is not used") for entry in entries]
                continue
            try:
                self[name]
            except PluginError as error:
                found.append(error)
        return found

    def _load(self, name: str) -> type:
        path, entries = f"{self.group}.{name}", self._entries[name]
        if len(entries) > 1:
            raise PluginError(path, f"has two owners: {' and '.join(_owner(entry) for entry in entries)}",
                              hint="uninstall one")
        entry, owner = entries[0], _owner(entries[0])
        try:
            found = entry.load()
        except ModuleNotFoundError as error:
            raise PluginError(path, f"of {owner} needs {error.name!r}, which is not installed", entry.value,
                              f"install {error.name}, or uninstall {owner}") from error
        except (Exception, SystemExit) as error:
            raise PluginError(path, f"of {owner} cannot be loaded: {type(error).__name__}: {error}",
                              entry.value) from error
        # glrender's own backends come by the same door and are of this version.
        if _distribution(entry) != "glrender":
            asked = vars(found).get("glrender_api") if isinstance(found, type) else None
            if asked != API:
                said = "does not say which" if asked is None else f"is for version {asked}"
                raise PluginError(path, f"of {owner} must be a class for version {API} of glrender's plug-in "
                                        f"interface, and {said}", entry.value,
                                  f"its class body says `glrender_api = {API}`; another release may fit")
        wrong = self._check(name, found)
        if wrong:
            raise PluginError(path, f"of {owner} {wrong}", entry.value)
        return found


@cache
def laws() -> Plugins:
    """Reflectance laws by name: glrender's own, and those of the group `glrender.brdf`."""
    own = {law.glsl: law for name in brdf.__all__
           if isinstance(law := getattr(brdf, name), type) and issubclass(law, Law) and law is not Law}
    return Plugins(BRDF_GROUP, _check_law, own)


@cache
def backends() -> Plugins:
    """Backends other than OpenGL, by name: classes with the interface of `Backend`."""
    needed = ("settings", "options", "render", "info", "close", "__enter__", "__exit__")
    return Plugins(BACKEND_GROUP, _has(*needed), reserved=OPENGL_BACKENDS)


@cache
def emissions() -> Plugins:
    """Light that no surface scatters, by name: the group `glrender.emission`."""
    return Plugins(EMISSION_GROUP, _has("from_table", "open"))


@cache
def shape_readers() -> Plugins:
    """Readers of shape files by their ending without its dot: the group `glrender.shape`."""
    return Plugins(SHAPE_GROUP, _has("read", "length_unit"))


def problems() -> list[PluginError]:
    """Errors of the installed plug-ins, of all groups; each plug-in is loaded."""
    return [problem for plugins in (laws(), backends(), emissions(), shape_readers())
            for problem in plugins.problems()]


def _check_law(name: str, law: Any) -> str | None:
    if not (isinstance(law, type) and issubclass(law, Law)):
        return "must be a subclass of glrender.brdf.Law"
    missing = [member for member in ("glsl", "uniform_fields") if not hasattr(law, member)]
    if missing or inspect.isabstract(law):
        return f"must define {', '.join([*missing, *sorted(law.__abstractmethods__)])}"
    if not isinstance(law.glsl, GlslText):
        return "must bring its twin: `glsl = GlslText(name, text)`"
    if law.glsl != name:
        return f"must have the entry point's name as that of its twin, and it is {str(law.glsl)!r}"
    return None


def _has(*names: str) -> Callable[[str, Any], str | None]:
    def check(_: str, found: Any) -> str | None:
        missing = [name for name in names if not hasattr(found, name)]
        return f"must have {', '.join(missing)}" if missing else None

    return check


def _distribution(entry: EntryPoint) -> str:
    return "" if entry.dist is None else entry.dist.name


def _owner(entry: EntryPoint) -> str:
    return entry.module if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
