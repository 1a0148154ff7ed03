"""Runs the peers: a virtual environment of their own, since some of them hold NumPy back, a process for each."""

from __future__ import annotations

import glob
import os
import re
import subprocess
import sys
import tempfile
from ctypes.util import find_library
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .peer_scene import PeerScene
from .worker import PEERS

REPOSITORY = Path(__file__).parent.parent.parent
VENV = REPOSITORY / "out" / "peers_venv"
# Dr.Jit 1.5 aborts with 15, and with 16 on newer processors: no fmaximum.
_LEAST_LLVM = 17
# bpy first: it names the NumPy that the others take too.
PACKAGES = {"cycles": ["bpy"], "embree": ["embreex"], "mitsuba": ["mitsuba"], "open3d": ["open3d"],
            "pyrender": ["pyrender", "numpy<2"], "pyvista": ["pyvista"]}


@dataclass(frozen=True, kw_only=True, eq=False)
class PeerFrames:
    """A peer's frames of one scene, by samples along a pixel's side."""

    images: dict[int, np.ndarray]
    times_ms: dict[int, np.ndarray]
    is_relative: bool


def install() -> dict[str, str]:
    """Make the environment; the reasons of those that cannot be had, by peer."""
    python = VENV / "bin" / "python"
    if not python.is_file():
        subprocess.run([sys.executable, "-m", "venv", str(VENV)], check=True)
    has_llvm = bool(os.environ.get("DRJIT_LIBLLVM_PATH")) or max(_llvm_versions(), default=0) >= _LEAST_LLVM
    if not (has_llvm and find_library("usb-1.0")):
        subprocess.run(["sh", REPOSITORY / "tools" / "install_peers.sh"])
    missing = {}
    for name in PEERS:
        probe = subprocess.run([python, "-c", f"import {PACKAGES[name][0]}"], capture_output=True, text=True)
        if probe.returncode:
            tried = subprocess.run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
                                    *PACKAGES[name]], capture_output=True, text=True)
            probe = subprocess.run([python, "-c", f"import {PACKAGES[name][0]}"], capture_output=True, text=True,
                                   env=_environment(name))
            if tried.returncode or probe.returncode:
                missing[name] = _last_line(tried.stderr if tried.returncode else probe.stderr)
    return missing


def frames_of(name: str, scene: PeerScene, budget_s: float) -> PeerFrames:
    """Render a scene with a peer.

    Raises
    ------
    RuntimeError
        With the last line of what it said.
    """
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "scene.npz", Path(folder) / "out.npz"
        scene.save(source)
        try:
            ran = subprocess.run([VENV / "bin" / "python", "-m", "peers.worker", name, source, out, str(budget_s)],
                                 cwd=REPOSITORY / "benchmarks", env=_environment(name), capture_output=True,
                                 text=True, timeout=300.0 + 10.0 * budget_s)
        except subprocess.TimeoutExpired:
            raise RuntimeError(f"{name}: took more than {300.0 + 10.0 * budget_s:.0f} s") from None
        if ran.returncode or not out.is_file():
            raise RuntimeError(f"{name}: {_last_line(ran.stderr)}")
        with np.load(out) as stored:
            counts = sorted(int(key.removeprefix("image_")) for key in stored.files if key.startswith("image_"))
            return PeerFrames(images={n: stored[f"image_{n}"] for n in counts},
                              times_ms={n: stored[f"times_ms_{n}"] for n in counts},
                              is_relative=bool(stored["is_relative"]))


def _environment(name: str) -> dict[str, str]:
    environment = dict(os.environ)
    if name == "mitsuba" and not environment.get("DRJIT_LIBLLVM_PATH"):
        # Dr.Jit takes the first it finds.
        versions = _llvm_versions()
        if versions:
            environment["DRJIT_LIBLLVM_PATH"] = versions[max(versions)]
    return environment


def _llvm_versions() -> dict[int, str]:
    """Paths of LLVM's library, by version."""
    found = [*glob.glob("/usr/lib/*/libLLVM*.so*"), *glob.glob("/usr/lib/llvm-*/lib/libLLVM*.so*")]
    return {int(m[1]): path for path in found if (m := re.search(r"(?:-|so\.)(\d+)", Path(path).name))}


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "failed without a word"
