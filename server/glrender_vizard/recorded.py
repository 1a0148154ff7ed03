"""Frames of simulations that do not wait for them: recordings of Basilisk's (`_UnityViz.bin`), and its broadcast."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import cv2
import zmq
from glrender import GlrenderError, ProtocolError
from glrender_server import codec
from glrender_server.operations import Operations

from . import frames, wire
from .bodies import BodyMap
from .dispatcher import MAX_MESSAGE_BYTES, Simulation

log = logging.getLogger(__name__)

_MAX_LENGTH_BYTES = 5
_POLL_MS = 200
# Updates of the broadcast that may wait; Basilisk does not, and what finds no room is lost.
_HIGH_WATER = 100


class FrameFiles:
    """Draws the images that are due at each update of one simulation, and writes them as PNG.

    Parameters
    ----------
    folder : path
        Made if it is missing. Files are called ``camera<ID>_<nanoseconds>.png``.
    body_map : BodyMap
    backend : str
        As of `glrender.open_renderer`.
    """

    def __init__(self, folder: Path, body_map: BodyMap, backend: str = "auto"):
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._map, self._backend = folder, body_map, backend
        self._simulation = Simulation(1)
        self._scene: frames.SceneKey | None = None
        self._operations: Operations | None = None

    def take(self, data: bytes) -> list[Path]:
        """The files of an update's images; one that cannot be made leaves a line in the log.

        Raises
        ------
        ProtocolError
            No `VizMessage`.
        """
        update = self._simulation.take(data)
        written = []
        for camera in update.cameras:
            if not camera.is_due(update.t_ns):
                continue
            path = self._folder / f"camera{camera.id}_{update.t_ns:019d}.png"
            try:
                image = self._image(frames.ordered(update, self._simulation.models or (), camera.id, self._map))
            except GlrenderError as error:
                log.warning("%s is not drawn: %s", path.name, error)
                continue
            if not cv2.imwrite(str(path), image):
                raise OSError(f"{path} cannot be written")
            written.append(path)
        return written

    @property
    def frame(self) -> int:
        """The number of the last update."""
        return -1 if self._simulation.update is None else self._simulation.update.frame

    def _image(self, order: frames.FrameOrder):
        for note in order.notes:
            if note not in self._simulation.told:
                self._simulation.told.add(note)
                log.warning("%s", note)
        if self._scene != order.scene:
            scene = frames.make_scene(order.scene, self._map)
            self.close()
            self._scene, self._operations = order.scene, Operations(scene, self._backend)
        parts, code, *_ = self._operations.answer(order.fields)
        header = codec.unpack_request(parts[:1])
        if code:
            raise ProtocolError("", header["error"]["message"])
        return frames.picture(order.pinhole, order.white_radf, order.sun_irradiance_W_m2, header, parts[1])

    def close(self) -> None:
        """Release the renderer."""
        if self._operations is not None:
            self._operations.close()
        self._scene = self._operations = None


def messages(path: Path) -> Iterator[bytes]:
    """The `VizMessage`s of a recording: each behind its length.

    Raises
    ------
    OSError
    ProtocolError
        It ends inside a message, or a length is none.
    """
    with path.open("rb") as file:
        place = 0
        while head := file.read(1):
            while head[-1] > 0x7F and len(head) < _MAX_LENGTH_BYTES and (more := file.read(1)):
                head += more
            try:
                length, _ = wire.varint(head, 0, len(head))
            except ProtocolError:
                raise ProtocolError(path.name, f"byte {place}: no length of a message stands there") from None
            if length > MAX_MESSAGE_BYTES:
                raise ProtocolError(path.name, f"byte {place}: a message has at most {MAX_MESSAGE_BYTES} bytes", length)
            data = file.read(length)
            if len(data) < length:
                raise ProtocolError(path.name, f"byte {place}: the last message is cut off", len(data))
            yield data
            place += len(head) + length


def replay(path: Path, made: FrameFiles) -> int:
    """Draw a recording; the number of its frames.

    Raises
    ------
    OSError, ProtocolError
    """
    return sum(len(made.take(data)) for data in messages(path))


def tap(endpoint: str, made: FrameFiles, is_stopped) -> int:
    """Draw what Basilisk broadcasts, until it is stopped; the number of frames.

    A frame takes longer than a step of a simulation that does not wait: steps are then left out, and the log says so.
    """
    n_written, last = 0, None
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.setsockopt(zmq.RCVHWM, _HIGH_WATER)
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE_BYTES)
        socket.linger = 0
        socket.connect(endpoint)
        socket.subscribe(b"SIM_UPDATE")
        while not is_stopped():
            if not socket.poll(_POLL_MS):
                continue
            parts = socket.recv_multipart()
            try:
                n_written += len(made.take(parts[-1]))
            except ProtocolError as error:
                log.warning("an update of the broadcast cannot be read: %s", error)
                continue
            frame = made.frame
            if last is not None and frame > last + 1:
                log.warning("%d updates of the broadcast came while others were drawn: left out", frame - last - 1)
            last = frame
    return n_written
