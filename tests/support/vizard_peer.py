"""Basilisk's half of Vizard's protocol without Basilisk, an adapter to speak it with, and a writer of messages.

The writer shares no line with the adapter's reader: field numbers are those of Basilisk's vizMessage.proto.
"""

from __future__ import annotations

import math
import struct
import subprocess
import sys
from contextlib import contextmanager

import cv2
import numpy as np
import zmq
from serving import wait_for_line

AU_M = 149_597_870_700.0
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def varint(number):
    number, out = number & (1 << 64) - 1, bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes(out) + bytes([number])


def record(number, data):
    return varint(number << 3 | 2) + varint(len(data)) + data


def text(number, value):
    return record(number, value.encode())


def whole(number, value):
    return varint(number << 3) + varint(value) if value else b""


def double(number, value):
    return varint(number << 3 | 1) + struct.pack("<d", value) if value else b""


def doubles(number, values):
    return record(number, struct.pack(f"<{len(values)}d", *values))


def body(name, r_m, radius_m, dcm=IDENTITY, ratio=1.0):
    return record(2, text(1, name) + doubles(2, r_m) + doubles(3, [0.0] * 3) + doubles(4, np.ravel(dcm))
                  + double(5, 1.0) + double(6, 1e-3 * radius_m) + double(7, ratio))


def craft(name, r_m, sigma_BN=(0.0, 0.0, 0.0)):
    return record(3, text(1, name) + doubles(2, r_m) + doubles(4, sigma_BN))


# Vizard's camera axes of an OpNav camera whose axes are the spacecraft's.
LEVEL = (1 / 3, 1 / 3, -1 / 3)


def camera(number=1, side_px=64, fov_deg=20.0, parent="craft", height_px=None, mode=0, r_m=(0.0, 0.0, 0.0)):
    return record(4, whole(1, number) + text(2, parent) + double(3, fov_deg)
                  + record(4, varint(side_px) + varint(height_px or side_px)) + doubles(7, r_m) + doubles(8, LEVEL)
                  + whole(9, 10**9) + text(10, "black") + whole(16, mode))


def model(path, *names, offset=(0.0,) * 3, rotation=(0.0,) * 3, scale=(1.0,) * 3):
    return record(12, text(1, path) + b"".join(text(2, name) for name in names) + doubles(3, offset)
                  + doubles(4, rotation) + doubles(5, scale))


def message(*parts, t_ns=0, frame=0, models=()):
    settings = b"" if models is None else record(7, double(1, 0.5) + b"".join(models))
    return record(1, whole(1, frame) + double(2, float(t_ns))) + b"".join(parts) + settings


def scene(xy=(0.0, 0.0), t_ns=10**9, side_px=64, radius_m=100.0, range_m=2000.0, fov_deg=20.0, name="moonlet", **more):
    """A sphere before a camera that looks along z, `xy` [px] off the boresight, the Sun behind the camera."""
    pixel = 2.0 * math.tan(math.radians(0.5 * fov_deg)) / max(side_px, 1)
    r_m = (xy[0] * pixel * range_m, xy[1] * pixel * range_m, range_m)
    return message(body("sun", (0.0, 0.0, -AU_M), 6.95e8), body(name, r_m, radius_m), craft("craft", (0.0, 0.0, 0.0)),
                   camera(side_px=side_px, fov_deg=fov_deg), t_ns=t_ns, **more)


class Peer:
    """A REQ socket, as vizInterface has it; what does not come within a while is an error."""

    def __init__(self, endpoint, seconds=60.0, kind=zmq.REQ):
        self._context = zmq.Context()
        self.socket = self._context.socket(kind)
        self.socket.linger = 0
        self.socket.rcvtimeo = self.socket.sndtimeo = int(1e3 * seconds)
        self.socket.connect(endpoint)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.socket.close()
        self._context.term()

    def ask(self, *parts):
        self.socket.send_multipart(parts)
        return self.socket.recv_multipart()

    def update(self, data):
        return self.ask(b"SIM_UPDATE", b"", b"", data)

    def image_bytes(self, number=1):
        length, data = self.ask(b"REQUEST_IMAGE_%d" % number)
        assert struct.unpack(">i", length) == (len(data),)
        return data

    def image(self, number=1):
        data = self.image_bytes(number)
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None

    def frame(self, data, number=1):
        """The image at an update."""
        assert self.update(data) == [b"OK"]
        return self.image(number)


def centroid_px(image):
    """(x, y) of an image's light."""
    weights = image.astype(np.float64)
    y, x = np.indices(image.shape)
    return np.array([(weights * x).sum(), (weights * y).sum()]) / weights.sum()


@contextmanager
def adapter(folder, *arguments, map_text=None, endpoint="tcp://127.0.0.1:*"):
    """Yields (endpoint, process) of an adapter; its log is `vizard.log` in the folder."""
    if map_text is not None:
        (folder / "map.toml").write_text(map_text)
        arguments = (str(folder / "map.toml"), *arguments)
    with open(folder / "vizard.log", "ab") as log:
        process = subprocess.Popen([sys.executable, "-m", "glrender_vizard", "--zmq", endpoint, *arguments],
                                   stdout=subprocess.PIPE, stderr=log)
        try:
            process.ready_line = wait_for_line(process, "glrender-vizard ready on", 60.0)
            yield process.ready_line.split()[3], process
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
