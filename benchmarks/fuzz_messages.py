"""Messages that a client should not send, for `fuzz.py`: random, or a good one spoilt."""

from __future__ import annotations

import json
import random
import struct
import tomllib
from pathlib import Path

import msgpack

GOLDEN = json.loads((Path(__file__).resolve().parents[1] / "tests" / "data" / "golden.json").read_text("ascii"))
MODEL = """[cameras.model]
exposure_s = 0.01
optics = { aperture_diameter_m = 0.01, psf_sigma_px = 0.5 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.1, bit_depth = 12 }
"""
SCENE = """
max_error = 0.5
[[bodies]]
name = "body"
shape = "body.obj"
length_unit = "m"
brdf = { law = "lambert", normal_albedo = 0.2 }
""" + "".join(f"""[[cameras]]
name = "{name}"
width_px = {size}
height_px = 16
focal_length_px = 60.0
{MODEL}""" for name, size in (("navcam", 24), ("wac", 16)))
STATE = {"t_s": 1.0, "r_sun_inertial_m": [1.5e11, 0.0, -1e11],
         "spacecraft": {"r_inertial_m": [0.0, 0.0, -2000.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]},
         "bodies": {"body": {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [0.6, 0.0, 0.0, 0.8]}}}
ENVELOPE = {"v": 1, "id": 7, "client": "fuzz"}
RANGE = {**ENVELOPE, "op": "range", "state": STATE, "camera": "navcam", "directions_camera": [[0.0, 0.0, 1.0]],
         "noise": {"sigma_m": 0.1, "seed": 1}}
LOAD = {**ENVELOPE, "op": "load_scene", "scene": tomllib.loads(SCENE)}
WRONG = [None, -1, 0, 2**63, 2**64 - 1, float("nan"), float("inf"), -1e308, 1e-308, "", [], {}, "x" * 300, [[[]]], True,
         b"raw", "navcam", "F", "auto", [0, 0, 8, 8], [1.0, 0.0, 0.0, 0.0], ["range"], [{}]]


def nested(depth: int, kind: type = list) -> list | dict:
    """A list in a list in a list, or maps with the key "x"."""
    value = kind()
    for _ in range(depth):
        value = [value] if kind is list else {"x": value}
    return value


# What costs more than its bytes, if it is not bounded: depth (msgpack packs 500, and reads more), and numbers.
COSTLY = [lambda: nested(400), lambda: nested(400, dict), lambda: [0] * 20_000, lambda: [{}] * 20_000,
          lambda: [[]] * 20_000, lambda: {str(k): None for k in range(5000)}, lambda: "y" * 100_000,
          lambda: b"\xff" * 100_000]


class Mutator:
    """Bad messages, by a seed."""

    def __init__(self, seed: int):
        self.rng = random.Random(seed)
        self.bases = [bytes.fromhex(GOLDEN[name][0]) for name in GOLDEN if name.startswith("request_")]
        self.bases += [msgpack.packb({**ENVELOPE, "op": op}) for op in ("status", "watch", "close")]
        self.bases.append(msgpack.packb(RANGE))
        self._load = msgpack.packb(LOAD)

    def message(self) -> list[bytes]:
        """Parts, nearly always one."""
        rng = self.rng
        kind = rng.random()
        if kind < 0.15:
            return [rng.randbytes(rng.randrange(400))]
        # A scene that loads costs a new context: seldom.
        data = self._load if rng.random() < 0.002 else rng.choice(self.bases)
        if kind < 0.5:
            data = self.spoilt(data, rng.randrange(1, 6))
        elif kind < 0.7:
            data = data[:rng.randrange(len(data))] + rng.randbytes(rng.randrange(20))
        elif kind < 0.72:
            data = self.costly(data)
        elif kind < 0.74:
            data = self.doubled(data)
        elif kind < 0.94:
            header = msgpack.unpackb(data)
            self.make_wrong(header)
            data = msgpack.packb(header)
        elif kind < 0.95:
            return [data, *(rng.randbytes(rng.randrange(50)) for _ in range(rng.randrange(1, 4)))]
        return [data]

    def burst(self) -> list[list[bytes]]:
        """Some messages at once; now and then good ones, more than the server lets wait."""
        if self.rng.random() < 0.002:
            return [[msgpack.packb({**ENVELOPE, "op": "render", "id": k, "state": STATE, "camera": "wac"})]
                    for k in range(45)]
        return [self.message() for _ in range(self.rng.choice([1, 3, 10]))]

    def spoilt(self, data: bytes, count: int) -> bytes:
        """A message with `count` bytes changed."""
        changed = bytearray(data)
        for _ in range(count):
            changed[self.rng.randrange(len(changed))] = self.rng.randrange(256)
        return bytes(changed)

    def doubled(self, data: bytes) -> bytes:
        """A packed map with one of its keys twice, each with its own value."""
        header = msgpack.unpackb(data)
        pairs = [*header.items(), (self.rng.choice(list(header)), self.rng.choice(WRONG))]
        self.rng.shuffle(pairs)
        return b"\xde" + struct.pack(">H", len(pairs)) + b"".join(msgpack.packb(k) + msgpack.packb(v) for k, v in pairs)

    def costly(self, data: bytes) -> bytes:
        """A message with a value that is very deep or very long; or nothing but depth, beyond what can be packed."""
        rng = self.rng
        if rng.random() < 0.1:
            depth = rng.choice([600, 990, 1100, 20_000])
            return rng.choice([b"\x91" * depth + b"\x90", b"\x81\xa1x" * depth + b"\x80"])
        header = msgpack.unpackb(data)
        node, key = header, rng.choice([*header, "x"])
        while isinstance(node.get(key), dict) and node[key] and rng.random() < 0.7:
            node, key = node[key], rng.choice(list(node[key]))
        node[key] = rng.choice(COSTLY)()
        packed = msgpack.packb(header)
        if rng.random() < 0.3:  # deeper than msgpack would pack: the field itself replaced
            marker = msgpack.packb("<deep>")
            node[key] = "<deep>"
            depth = rng.choice([600, 900, 990])
            packed = msgpack.packb(header).replace(marker, b"\x91" * depth + b"\x90", 1)
        return packed

    def make_wrong(self, node: dict | list, wrong: list = WRONG) -> None:
        """Change a value somewhere in a message: a value replaced or taken away, or a field too many."""
        rng = self.rng
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = rng.choice(keys) if keys else None
        if key is not None and isinstance(node[key], (dict, list)) and node[key] and rng.random() < 0.7:
            self.make_wrong(node[key], wrong)
        elif isinstance(node, dict) and (key is None or rng.random() < 0.2):
            node[rng.choice(["noise", "scene", "samples", "roi", "frames", "x", ""])] = rng.choice(wrong)
        elif rng.random() < 0.2:
            del node[key]
        else:
            node[key] = rng.choice(wrong)


def frame(parts: list[bytes]) -> bytes:
    """A message on TCP."""
    return b"GLR1" + struct.pack(f"<HH{len(parts)}I", len(parts), 0, *map(len, parts)) + b"".join(parts)
