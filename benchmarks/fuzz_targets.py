"""Targets to which `fuzz_guided.py` hands bytes, and the sound inputs that it begins with."""

from __future__ import annotations

import io
import json
import random
import struct
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from fuzz_messages import COSTLY, GOLDEN, SCENE, WRONG, Mutator, frame
from glrender import GlrenderError, Scene, Shape, generate
from glrender.emission.grid_files import Grid, write_grid
from glrender.emission.tables import _facet_table
from glrender.scene.shape.textures import read_texture
from glrender_server.codec import unpack_request
from glrender_server.framing import Decoder

__all__ = ["GlrenderError", "made"]

Target = Callable[[bytes], None]
MESHES = (".obj", ".ply", ".stl", ".tab", ".plt", ".icq", ".glb", ".off")
# Larger bodies are allowed, and slow: what is looked for here needs none.
MOST_SUBDIVISIONS = 2


def made(name: str, folder: Path) -> tuple[Target, list[bytes]]:
    """A target and its first inputs; it may write files to a folder."""
    return {"codec": _codec, "framing": _framing, "scene": _scene, "shape": _shape, "texture": _texture}[name](folder)


def _requests() -> list[bytes]:
    mutator = Mutator(1)
    return [*(bytes.fromhex(GOLDEN[name][0]) for name in GOLDEN if name.startswith("request_")),
            *(mutator.costly(mutator.bases[1]) for _ in range(20)), *(mutator.doubled(base) for base in mutator.bases)]


def _codec(folder: Path) -> tuple[Target, list[bytes]]:
    return lambda data: _is_header(unpack_request([data])), _requests()


def _is_header(header: Any) -> None:
    if type(header) is not dict or not all(type(key) is str for key in header):
        raise AssertionError("a header must be a map with text keys")


def _framing(folder: Path) -> tuple[Target, list[bytes]]:
    """The first byte says in how many pieces the others come."""
    def target(data: bytes) -> None:
        size = (1, 7, 100, 1 << 20)[data[0] % 4] if data else 1
        decoder, taken, at = Decoder(), 0, 1
        while at < len(data):
            decoder.feed(data[at:at + size])
            at += size
            for parts in decoder.messages():
                taken += 8 + 4 * len(parts) + sum(map(len, parts))
        if taken > len(data):
            raise AssertionError("more came out than went in")

    whole = [frame([data]) for data in _requests()[:8]]
    return target, [b"\3" + b"".join(whole), *(bytes([k]) + data for k, data in enumerate(whole)),
                    b"\1" + frame([b"a", b"", b"bc"] * 5)]


class _Choices(random.Random):
    """Chance out of an input's bytes, so that coverage guides it; zeros when they are used up."""

    def __new__(cls, data: bytes):
        return super().__new__(cls)

    def __init__(self, data: bytes):
        self._data, self._at = data, 0

    def getrandbits(self, k: int) -> int:
        size = (k + 7) // 8
        part = self._data[self._at:self._at + size].ljust(size, b"\0")
        self._at += size
        return int.from_bytes(part, "little") & ((1 << k) - 1)

    def _randbelow(self, n: int) -> int:
        return self.getrandbits(max(n - 1, 1).bit_length()) % n

    def random(self) -> float:
        return self.getrandbits(16) / 65536.0


RICH = tomllib.loads("""
max_error = 0.1
solar_irradiance_1au_W_m2 = 1360.0
sun_disc = true
[[bodies]]
name = "a"
generated = { kind = "contact_binary", radius_m = 100.0, seed = 1, subdivisions = 1, n_craters = 2, n_boulders = 2 }
brdf = { preset = "eros_550nm" }
smooth_normals = true
[bodies.detail]
seed = 3
noise = { amplitude_m = 0.1, longest_m = 10.0, shortest_m = 2.0 }
craters = { coverage = 0.2, largest_m = 10.0, smallest_m = 5.0 }
boulders = { coverage = 0.1, largest_m = 5.0, smallest_m = 2.0 }
[[bodies]]
name = "b"
generated = { kind = "gaussian_random_sphere", radius_m = 10.0, sigma = 0.1, correlation_deg = 40.0, subdivisions = 1 }
brdf = { law = "lommel_seeliger", single_scattering_albedo = 0.3 }
[[bodies]]
name = "c"
shape = "body.obj"
length_unit = "km"
brdf = { law = "lambert", normal_albedo = 0.2 }
albedo_texture = "map.png"
albedo_texture_gain = 2.0
[[emission]]
kind = "coma"
body = "a"
has_shadow = false
dust = { geometric_albedo = 0.05, phase_function = "marcus", extinction_efficiency = 0.0 }
[[emission.sources]]
model = "haser"
afrho_m = 2.0
reach_m = 1e6
[[emission.sources]]
model = "jets"
jets = [{ afrho_m = 1.0, latitude_deg = 10.0, longitude_deg = 20.0, half_width_deg = 10.0, collimation = 1.0 }]
activity = { exponent = 1.0, night = 0.1, lag_deg = 5.0 }
[[emission.sources]]
model = "facets"
afrho_m = 1.0
table = "table.npy"
spread = 1.0
[[emission.sources]]
model = "facets"
cross_section_rate_m2_s = 1.0
speed_m_s = 1.0
noise = { seed = 1, roughness = 0.5, contrast = 0.5 }
[[emission.sources]]
model = "grid"
file = "grid.npz"
cross_section_per_m = 1e-9
refine = 1
[[emission.sources]]
model = "tail"
afrho_m = 1.0
perihelion_au = 1.2
eccentricity = 0.6
true_anomaly_deg = 10.0
pole_inertial = [0.0, 0.0, 1.0]
oldest_s = 1e6
length_m = 1e6
particles = 1000
cells = 16
[[cameras]]
name = "plain"
width_px = 16
height_px = 8
focal_length_px = 60.0
principal_point_px = [7.5, 3.5]
q_camera_from_spacecraft = [1.0, 0.0, 0.0, 0.0]
r_camera_spacecraft_m = [0.0, 0.0, 0.0]
distortion = { k1 = -0.12, p1 = 3e-4 }
[[cameras]]
name = "preset"
width_px = 16
height_px = 8
focal_length_px = 60.0
model = { preset = "generic_navigation_camera", exposure_s = "auto" }
[stars]
magnitude_limit = 5.0
year = 2031.5
aberration = false
""")


def _scene(folder: Path) -> tuple[Target, list[bytes]]:
    """The first byte: a packed table, or a sound one that the others say how to make wrong."""
    (folder / "body.obj").write_text("v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nvt 0 0\nvt 1 0\nvt 0 1\n"
                                     "f 1/1 3/2 2/3\nf 1/1 2/2 4/3\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n")
    (folder / "map.png").write_bytes(_pictures()[0])
    np.save(folder / "table.npy", np.ones(80))
    write_grid(folder / "grid.npz", Grid(density=np.ones((3, 3, 3)), low_m=-np.ones(3), high_m=np.ones(3)))
    bases = [msgpack.packb(RICH), msgpack.packb(tomllib.loads(SCENE))]

    def target(data: bytes) -> None:
        kind = data[0] % 4 if data else 0
        if kind == 0:
            try:
                table = msgpack.unpackb(data[1:])
            except Exception:  # the codec's affair
                return
        else:
            table, rng = msgpack.unpackb(bases[kind == 1]), _Choices(data[1:])
            mutator = Mutator(0)
            mutator.rng = rng
            for _ in range(1 + rng._randbelow(3)):
                mutator.make_wrong(table, [*WRONG, COSTLY[rng._randbelow(len(COSTLY))]()])
        Scene.from_dict(_small(table), shape_dir=folder, restricted=True)

    rng = random.Random(1)
    return target, [*(b"\0" + base for base in bases), *(bytes([1 + k % 3]) + rng.randbytes(40) for k in range(60))]


def _small(node: Any) -> Any:
    """A scene without bodies whose many facets are slow to make."""
    bodies = node.get("bodies") if isinstance(node, dict) else None
    for entry in bodies if isinstance(bodies, list) else ():
        body = entry.get("generated") if isinstance(entry, dict) else None
        if isinstance(body, dict) and isinstance(body.get("subdivisions", 6), int | float):
            body["subdivisions"] = min(body.get("subdivisions", 6), MOST_SUBDIVISIONS)
    return node


def _shape(folder: Path) -> tuple[Target, list[bytes]]:
    """The first byte is the file's ending."""
    def target(data: bytes) -> None:
        path = folder / f"body{MESHES[data[0] % len(MESHES)] if data else '.obj'}"
        path.write_bytes(data[1:])
        Shape.from_file(path, length_unit="m", max_facets=100_000)

    return target, [bytes([k]) + data for k, data in _meshes(folder)]


def _meshes(folder: Path) -> list[tuple[int, bytes]]:
    solid = generate.icosphere(radius_m=10.0, subdivisions=0)
    solid.to_file(folder / "seed.obj")
    plain = (folder / "seed.obj").read_bytes()
    points, facets = solid.vertices_m, solid.facets
    rows = "\n".join(" ".join(map(str, point)) for point in points.tolist())
    head = "element vertex 12\nproperty float x\nproperty float y\nproperty float z\nelement face 20\n" \
           "property list uchar int vertex_indices\nend_header\n"
    corners = "\n".join(f"3 {a} {b} {c}" for a, b, c in facets.tolist())
    binary = points.astype("<f4").tobytes() + b"".join(b"\3" + row.astype("<i4").tobytes() for row in facets)
    loops = "".join("facet normal 0 0 1\nouter loop\n" + "".join(
        f"vertex {x} {y} {z}\n" for x, y, z in points[row].tolist()) + "endloop\nendfacet\n" for row in facets)
    stl = bytes(80) + struct.pack("<I", 20) + b"".join(bytes(12) + points[row].astype("<f4").tobytes() + bytes(2)
                                                       for row in facets)
    plates = f"12\n{rows}\n20\n" + "\n".join(f"{a + 1} {b + 1} {c + 1}" for a, b, c in facets.tolist())
    numbered = "12 20\n" + "\n".join(f"{k} {row}" for k, row in enumerate(rows.splitlines(), 1)) + "\n" + "\n".join(
        f"{k} {a + 1} {b + 1} {c + 1}" for k, (a, b, c) in enumerate(facets.tolist(), 1))
    grid = np.array([-1.0, 0.0, 1.0])
    cube = [np.roll(np.array([u, v, w]), axis) for axis in range(3) for w in (-1.0, 1.0) for u in grid for v in grid]
    icq = "2\n" + "\n".join(" ".join(map(str, point / np.linalg.norm(point))) for point in cube)
    quads = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 1\nf 1/1 2/1 3/2 4/2\nf -5//1 -1 -4\nf 1 5 4\n"
    strips = (b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
              b"element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
              b"0 0 0\n1 0 0\n0 1 0\n0 0 1\n6 0 1 2 3 -1 0\n")
    off = f"OFF\n12 20 0\n{rows}\n{corners}\n"
    texts = {0: [plain, quads], 1: [f"ply\nformat ascii 1.0\n{head}{rows}\n{corners}\n".encode(), strips,
                                    f"ply\nformat binary_little_endian 1.0\n{head}".encode() + binary],
             2: [b"solid a\n" + loops.encode() + b"endsolid a\n", stl], 3: [plates.encode()], 4: [numbered.encode()],
             5: [icq.encode()], 6: [_glb(points, facets)], 7: [off.encode()]}
    return [(kind, text) for kind, some in texts.items() for text in some]


def _glb(points: np.ndarray, facets: np.ndarray) -> bytes:
    blob = points.astype("<f4").tobytes() + facets.astype("<u2").tobytes()
    split = points.size * 4
    text = json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"children": [1]}, {"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": len(points)},
                      {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": facets.size}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": split},
                        {"buffer": 0, "byteOffset": split, "byteLength": len(blob) - split}],
        "buffers": [{"byteLength": len(blob)}]}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def _texture(folder: Path) -> tuple[Target, list[bytes]]:
    """The first byte: a picture, or a table of numbers, or one in text."""
    def target(data: bytes) -> None:
        kind = data[0] % 3 if data else 0
        path = folder / ("map.png", "table.npy", "table.txt")[kind]
        path.write_bytes(data[1:])
        (read_texture if kind == 0 else _facet_table)(path)

    table = io.BytesIO()
    np.save(table, np.arange(20.0))
    return target, [*(b"\0" + data for data in _pictures()), b"\1" + table.getvalue(), b"\2" + b"1.5\n2\n3e4\n"]


def _pictures() -> list[bytes]:
    from PIL import Image

    made, rng = [], np.random.default_rng(1)
    grey = Image.fromarray(rng.integers(0, 256, (12, 20), np.uint8))
    for mode, format_ in (("L", "PNG"), ("RGB", "PNG"), ("P", "PNG"), ("I;16", "PNG"), ("L", "TIFF"), ("L", "JPEG"),
                          ("L", "BMP"), ("L", "PPM"), ("RGB", "WEBP"), ("1", "PNG")):
        file = io.BytesIO()
        picture = Image.fromarray(np.asarray(grey).astype(np.uint16) * 257) if mode == "I;16" else grey.convert(mode)
        picture.save(file, format_)
        made.append(file.getvalue())
    return made
