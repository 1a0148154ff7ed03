"""The work of the adapter's processes: a frame, and from its light the picture that Basilisk reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgpack
from glrender_server.operations import Answer, Operations
from glrender_server.pixels import Memory

from .frames import encoded, picture


class Pictures(Operations):
    """Serves `render` requests with a further field `picture`, {white_radf, sun_irradiance_W_m2}; the reply's one part
    is a PGM file. An image of many megapixels takes seconds, in which others must not wait."""

    def _render(self, header: Mapping[str, Any], memory: Memory | None) -> Answer:
        answer = super()._render({name: value for name, value in header.items() if name != "picture"}, None)
        head, pixels = answer.reply
        camera, wanted = self.scene.camera(header["camera"]), header["picture"]
        whole = encoded(picture(camera, wanted["white_radf"], wanted["sun_irradiance_W_m2"], msgpack.unpackb(head),
                                pixels))
        if memory is not None:
            place, = memory([len(whole)])
            place[:] = whole
            whole = place
        return answer._replace(reply=[head, whole])
