"""Warnings in the server's log: each once, however many frames of a closed loop have it."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence

from glrender.base.names import NOTES
from glrender.base.plausible import Advice

log = logging.getLogger(__name__)

AWAY_S = 10.0
"""Time [s] that a warning must be absent from a camera's frames before it is logged anew: a warning that comes and goes
as a spacecraft tumbles makes one line."""
_MAX_CAMERAS = 256


class WarningLog:
    """Writes the warnings of frames and scenes to the log, each until it is known."""

    def __init__(self):
        # Times at which each client's camera last had each warning.
        self._known: OrderedDict[tuple[str, str], dict[tuple[str, str], float]] = OrderedDict()
        self._of_scene: list[Mapping[str, str]] = []

    def scene(self, warnings: Sequence[Mapping[str, str]]) -> None:
        """Log the warnings of a scene that is served from now on; its frames' warnings are all new."""
        self._known.clear()
        for warning in warnings:
            if warning not in self._of_scene:
                log.warning("%s", warning["message"], extra={"code": warning["code"], "path": warning["path"]})
        self._of_scene = list(warnings)

    def frames(self, client: str, warnings: Iterable[tuple[str, Sequence[Advice]]], now_s: float) -> None:
        """Log the warnings of the frames of one request.

        Parameters
        ----------
        client : str
        warnings : iterable of (str, sequence of Advice)
            Each frame's camera and its warnings: none, most often.
        now_s : float [s]
            Of a monotonic clock.
        """
        of_cameras: dict[str, dict[tuple[str, str], Advice]] = {}
        for camera, found in warnings:
            of_cameras.setdefault(camera, {}).update({(advice.code, advice.path): advice for advice in found})
        for camera, found in of_cameras.items():
            known = self._known.pop((client, camera), {})
            for key, advice in found.items():
                if key not in known:
                    level = logging.INFO if advice.code in NOTES else logging.WARNING
                    log.log(level, "%s: %s", camera if camera.isprintable() else repr(camera), advice.message, extra={
                        "client": client, "camera": camera, "code": advice.code, "path": advice.path})
            lately = {key: last_s for key, last_s in known.items() if now_s - last_s < AWAY_S}
            known = {**lately, **dict.fromkeys(found, now_s)}
            if known:
                self._known[client, camera] = known
        while len(self._known) > _MAX_CAMERAS:
            self._known.popitem(last=False)
