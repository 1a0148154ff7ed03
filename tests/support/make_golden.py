"""Write tests/data/golden.json: `python tests/support/make_golden.py`. A change of it is a change of the protocol."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from glrender_server import codec, framing, pixels

STATE = {"t_s": 12.5, "r_sun_inertial_m": [1.5e11, 0.0, 0.0],
         "spacecraft": {"r_inertial_m": [0.0, 0.0, -2000.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]},
         "bodies": {"body": {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [0.6, 0.0, 0.0, 0.8]}}}
ENVELOPE = {"v": 1, "id": 7, "client": "golden"}
REQUESTS = {
    "hello": {**ENVELOPE, "op": "hello"},
    "render": {**ENVELOPE, "op": "render", "state": STATE, "camera": "navcam", "output": "dn", "exposure_s": 0.1,
               "seed": 7, "products": ["range"], "order": "F"},
    "region": {**ENVELOPE, "op": "render", "state": STATE, "camera": "navcam", "output": "irradiance",
               "roi": [2, 1, 5, 3]},
    "frames": {**ENVELOPE, "op": "render", "state": STATE, "order": "F", "frames": [
        {"camera": "navcam", "output": "dn", "exposure_s": 0.1, "seed": 7, "products": ["range"]},
        {"camera": "wac", "output": "irradiance", "roi": [8, 4, 11, 6]}]},
    "shared": {**ENVELOPE, "op": "render", "shared": True, "state": STATE, "camera": "navcam", "output": "dn",
               "exposure_s": 0.1, "seed": 7, "products": ["range"], "order": "F"},
    "compressed": {**ENVELOPE, "op": "render", "state": STATE, "camera": "navcam", "output": "compressed",
                   "exposure_s": 0.1, "seed": 7, "order": "F"},
    "compare": {**ENVELOPE, "op": "render", "state": STATE, "camera": "navcam", "exposure_s": 0.1,
                "derivatives": ["spacecraft"], "unknown": ["gain"], "order": "F",
                "compare": {"pixels": np.arange(6, dtype="<u2").tobytes(), "dtype": "uint16", "shape": [2, 3],
                            "blur_px": 1.5, "robust": True}},
    "refused": {**ENVELOPE, "op": "render", "state": {**STATE, "gamma": 2.2}},
}
IMAGE = np.arange(6, dtype=np.uint16).reshape(2, 3) * 1000
RANGE = np.linspace(1999.0, 2001.0, 6).reshape(2, 3)
REPLY = {**ENVELOPE, "op": "render", "ok": True, "t_s": 12.5, "camera": "navcam", "output": "dn", "unit": "DN",
         "exposure_s": 0.1, "seed": 7}

REGION = np.float32([[0.5, 0.25, 0.125], [1.0, 2.0, 4.0]])
FRAMES_REPLY = {**ENVELOPE, "op": "render", "ok": True, "t_s": 12.5, "frames": [
    {"camera": "navcam", "output": "dn", "unit": "DN", "exposure_s": 0.1, "seed": 7},
    {"camera": "wac", "output": "irradiance", "unit": "W/m2", "roi": [8, 4, 11, 6]}]}
REGION_REPLY = {**ENVELOPE, "op": "render", "ok": True, "t_s": 12.5, "camera": "navcam", "output": "irradiance",
                "unit": "W/m2", "roi": [2, 1, 5, 3]}
WARNED_REPLY = {**REGION_REPLY, "warnings": [
    {"code": "behind_camera", "path": "state.spacecraft.q_from_inertial", "message": "body is behind the camera"},
    {"code": "sun_distance", "path": "state.r_sun_inertial_m", "message": "the Sun is 0.01 au from body"}]}
# IMAGE by JPEG-LS without loss, behind its length and CRC-32.
STREAM = bytes.fromhex(
    "5f000000250c7a68ffd8ffe800205350494646000200000100000002000000030a1006010000012c0000012cffe80008"
    "00000001ffd8fff7000b100002000301011100fff8000d01ffff0012004301140040ffda00080101000000009f3df3c1"
    "dc1f41f400ffd9")
COMPRESSED_REPLY = {**REPLY, "output": "compressed", "unit": "byte", "codec": "jpeg_ls", "shape": [2, 3],
                    "bit_depth": 16}
COMPARED_REPLY = {**ENVELOPE, "op": "render", "ok": True, "t_s": 12.5, "camera": "navcam", "comparison": {
    "names": ["law.normal_albedo", "gain"], "units": ["1", "1"], "matrix": [[4.0, 0.5], [0.5, 2.0]],
    "vector": [-1.5, 0.25], "chi2": 7.25, "n_pixels": 6, "gain": 1.03125, "offset_DN": 0.0}}
PLACE = {"name": "glrender-slot-golden", "number": 300, "offsets": [64, 128], "sizes": [12, 48]}
"""Places of the parts of `reply_shared`: in `slot_shared`, the file's bytes."""


def golden() -> dict[str, list[str]]:
    """Each message as a list of parts in hexadecimal."""
    import msgpack

    messages = {f"request_{name}": [msgpack.packb(header)] for name, header in REQUESTS.items()}
    for order in ("C", "F"):
        messages[f"reply_frame_{order}"] = pixels.pack(REPLY, {"image": (IMAGE, "DN"), "range": (RANGE, "m")}, order)
        messages[f"reply_frames_{order}"] = pixels.pack(
            FRAMES_REPLY, [{"image": (IMAGE, "DN"), "range": (RANGE, "m")}, {"image": (REGION, "W/m2")}], order)
    messages["reply_region"] = pixels.pack(REGION_REPLY, {"image": (REGION, "W/m2")})
    messages["reply_compressed"] = pixels.pack(
        COMPRESSED_REPLY, {"image": (np.frombuffer(STREAM, np.uint8), "byte")}, "F")
    messages["reply_compared"] = pixels.pack(COMPARED_REPLY, {})
    messages["reply_warned"] = pixels.pack(WARNED_REPLY, {"image": (REGION, "W/m2")})
    header, image, distances = messages["reply_frame_F"]
    messages["reply_shared"] = [codec.with_field(header, "shared", PLACE)]
    messages["slot_shared"] = [b"".join(bytes(part).ljust(64, b"\0") for part in (
        PLACE["number"].to_bytes(8, "little"), image, distances))]
    messages["reply_error"] = codec.pack({**ENVELOPE, "op": "render", "ok": False, "error": {
        "code": "config", "path": "state.gamma", "message": "state.gamma: unknown key"}})
    for name in ("request_render", "reply_frame_F", "request_frames", "reply_frames_F",
                 "reply_shared", "reply_warned"):
        messages[f"tcp_{name}"] = [b"".join(framing.framed(messages[name]))]
    return {name: [bytes(part).hex() for part in parts] for name, parts in messages.items()}


if __name__ == "__main__":
    Path(__file__).parents[1].joinpath("data", "golden.json").write_text(
        json.dumps(golden(), indent=1) + "\n", encoding="ascii")
