"""A spacecraft of four materials as a binary glTF, and its scenario: make_spacecraft.py FOLDER [--facets 50000]

White paint, gold foil, bare metal and the cells of two panels, which have paint on their backs. Written by the
specification of glTF 2.0 alone, as a program for three-dimensional drawing exports it: a node for each mesh.
"""

from __future__ import annotations

import argparse
import json
import shutil
import struct
from pathlib import Path

import numpy as np

MATERIALS = [
    {"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.8, 0.8, 1], "metallicFactor": 0,
                                               "roughnessFactor": 0.8}},
    {"name": "gold", "pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.77, 0.34, 1], "metallicFactor": 1,
                                              "roughnessFactor": 0.4}},
    {"name": "metal", "doubleSided": True, "pbrMetallicRoughness": {
        "baseColorFactor": [0.9, 0.9, 0.9, 1], "metallicFactor": 1, "roughnessFactor": 0.5}},
    {"name": "cells", "pbrMetallicRoughness": {"baseColorFactor": [0.03, 0.03, 0.06, 1], "metallicFactor": 0,
                                               "roughnessFactor": 0.3}}]
PAINT, GOLD, METAL, CELLS = range(4)


def grid(place, n_u, n_v):
    """Vertices and facets of a surface over n_u x n_v cells of the unit square: `place` maps (u, v) to (x, y, z)."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, n_u + 1), np.linspace(0.0, 1.0, n_v + 1))
    first = (np.arange(n_v)[:, None] * (n_u + 1) + np.arange(n_u)).ravel()
    facets = np.concatenate([np.stack([first, first + 1, first + n_u + 2], 1),
                             np.stack([first, first + n_u + 2, first + n_u + 1], 1)])
    return np.stack(np.broadcast_arrays(*place(u.ravel(), v.ravel())), axis=1), facets


def side(axis, sign, size, n):
    """One side of a box about the origin, with its sizes along x, y and z."""
    a, b = (axis + 1) % 3, (axis + 2) % 3

    def place(u, v):
        made = [0.0, 0.0, 0.0]
        made[axis] = np.full(len(u), 0.5 * sign * size[axis])
        made[a], made[b] = sign * (u - 0.5) * size[a], (v - 0.5) * size[b]
        return made

    return grid(place, n, n)


def pieces(n):
    """The meshes: vertices, facets, material, and the node's transform."""
    bus = (1.6, 1.6, 2.2)
    for axis in range(3):
        for sign in (-1, 1):
            yield *side(axis, sign, bus, n), GOLD if axis == 0 else PAINT, {}
    # With a hole for its feed.
    dish = lambda u, v: ((0.05 + 0.65 * u) * np.cos(2 * np.pi * v), (0.05 + 0.65 * u) * np.sin(2 * np.pi * v),  # noqa: E731
                         0.7 * (0.05 + 0.65 * u) ** 2)
    yield *grid(dish, n, 4 * n), METAL, {"translation": [0.0, 0.0, 1.3]}
    nozzle = lambda u, v: ((0.12 + 0.2 * u) * np.cos(2 * np.pi * v), -(0.12 + 0.2 * u) * np.sin(2 * np.pi * v),  # noqa: E731
                           -0.5 * u)
    yield *grid(nozzle, n, 2 * n), METAL, {"translation": [0.0, 0.0, -1.1]}
    for sign in (-1, 1):
        # Panels are 4 m x 1.8 m, turned by 25 deg about the boom, y.
        node = {"translation": [0.0, 3.2 * sign, 0.0], "rotation": [0.0, float(np.sin(np.radians(12.5))), 0.0,
                                                                    float(np.cos(np.radians(12.5)))]}
        flat = lambda u, v: (1.8 * (u - 0.5), 4.0 * (v - 0.5), 0.0)  # noqa: E731
        vertices, facets = grid(flat, n, 2 * n)
        yield vertices, facets, CELLS, node
        yield vertices, facets[:, ::-1], PAINT, node


def main(folder: Path, n_facets: int) -> None:
    # 6 + 4 + 2 + 8 squares of n x n cells, each of two facets.
    n = max(round((n_facets / 40) ** 0.5), 2)
    blob, views, accessors, meshes, nodes = b"", [], [], [], []
    for vertices, facets, material, node in pieces(n):
        for array, kind, component in ((vertices.astype("<f4"), "VEC3", 5126),
                                       (facets.astype("<u4").ravel(), "SCALAR", 5125)):
            views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": array.nbytes})
            accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array),
                              "type": kind})
            blob += array.tobytes()
        accessors[-2] |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
        meshes.append({"primitives": [{"attributes": {"POSITION": len(accessors) - 2}, "indices": len(accessors) - 1,
                                       "material": material}]})
        nodes.append({"mesh": len(meshes) - 1, **node})
    about = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes,
             "meshes": meshes, "materials": MATERIALS, "accessors": accessors, "bufferViews": views,
             "buffers": [{"byteLength": len(blob)}]}
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(__file__).with_name("flyby.toml"), folder)
    (folder / "sat.glb").write_bytes(
        struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)) + struct.pack("<I4s", len(text), b"JSON") + text
        + struct.pack("<I4s", len(blob), b"BIN\0") + blob)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--facets", type=int, default=50_000)
    arguments = parser.parse_args()
    main(arguments.folder, arguments.facets)
