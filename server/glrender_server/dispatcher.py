"""Request parts in, reply parts out: all that the server does, and nothing of sockets.

Every request gets one reply. What the caller did wrong is answered with `code`, `path` and
`message`; anything else is a bug: logged with its traceback, answered `internal`, and survived.
"""

from __future__ import annotations

import hashlib
import logging
import time
from collections import Counter, OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import glrender
from glrender import ConfigError, GlrenderError, ProtocolError, Scene, State, open_renderer
from glrender.image import PRODUCTS, peak_bytes
from glrender_camera.validate import integer, known_keys, one_of, positive

from . import codec

log = logging.getLogger(__name__)

OPERATIONS = ("hello", "render", "load_scene", "status", "close")
OUTPUTS = ("irradiance", "dn")
MAX_IMAGE_PIXELS = 2**26
"""Largest image of a scene that came over the wire, 67 megapixels."""
MAX_FRAME_BYTES = 4 * 1024**3
"""Most memory that one request's image and products may take while they are made."""
_ENVELOPE = ("v", "op", "id", "client")
_RENDER_KEYS = ("state", "camera", "output", "exposure_s", "seed", "max_error", "samples", "products", "order")
_UNITS = {"irradiance": "W/m2", "dn": "DN", "range": "m", "r_body": "m", "body_id": "1", "facet_id": "1",
          "incidence": "rad", "emission": "rad", "phase": "rad", "sunlit": "1"}
# Replies kept for retries: the last of each client, together at most this large.
_MAX_KEPT_BYTES = 256 * 1024**2


class Dispatcher:
    """Serves one scene with one renderer, in the thread that made it.

    Parameters
    ----------
    scene : Scene
    backend : str
        As of `glrender.open_renderer`.
    shape_dir : path, optional
        Where `load_scene` may look for shapes; without it only generated bodies load.
    """

    def __init__(self, scene: Scene, backend: str = "auto", shape_dir: Path | None = None):
        self._backend, self._shape_dir = backend, shape_dir
        self._scene, self._renderer = scene, open_renderer(scene, backend)
        self._started = time.monotonic()
        self._requests: Counter[str] = Counter()
        self._errors: Counter[str] = Counter()
        self._kept: OrderedDict[str, tuple[bytes, list]] = OrderedDict()
        self._last_timings_ms: dict[str, float] = {}

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    @property
    def info(self) -> dict[str, Any]:
        """The OpenGL behind it."""
        return self._renderer.info

    def handle(self, parts: Sequence[bytes]) -> list[Any]:
        """One reply to one request; raises nothing.

        Parameters
        ----------
        parts : sequence of bytes

        Returns
        -------
        list of bytes-like
        """
        header: dict[str, Any] = {}
        try:
            header = codec.unpack_request(parts)
            client, digest = _checked_envelope(header), hashlib.sha256(parts[0]).digest()
            kept = self._kept.get(client)
            if kept is not None and kept[0] == digest:
                return kept[1]
            self._requests[header["op"]] += 1
            reply = getattr(self, f"_{header['op']}")(header)
            if header["op"] in ("render", "load_scene"):
                self._keep(client, digest, reply)
            return reply
        except GlrenderError as error:
            return self._refuse(header, error.code, getattr(error, "path", ""), str(error))
        except Exception:
            log.exception("request %s failed", header.get("op"))
            return self._refuse(header, "internal", "", "the server failed on this request; its log has the traceback")

    def busy(self, parts: Sequence[bytes], queue_length: int) -> list[Any]:
        """The reply to a request that came when the queue was full."""
        try:
            header = codec.unpack_request(parts)
        except ProtocolError:
            header = {}
        return self._refuse(header, "busy", "", f"{queue_length} requests are waiting; try again")

    def closing(self, parts: Sequence[bytes]) -> list[Any]:
        """The reply to a request that came after the server was told to stop."""
        try:
            header = codec.unpack_request(parts)
        except ProtocolError:
            header = {}
        return self._refuse(header, "closing", "", "the server is shutting down")

    def _refuse(self, header: Mapping[str, Any], code: str, path: str, message: str) -> list[Any]:
        self._errors[code] += 1
        return codec.pack({**_echo(header), "ok": False, "error": {"code": code, "path": path, "message": message}})

    def _keep(self, client: str, digest: bytes, reply: list[Any]) -> None:
        self._kept[client] = (digest, reply)
        self._kept.move_to_end(client)
        size = lambda: sum(len(part) for _, parts in self._kept.values() for part in parts)  # noqa: E731
        while len(self._kept) > 1 and (len(self._kept) > 64 or size() > _MAX_KEPT_BYTES):
            self._kept.popitem(last=False)

    # Operations.

    def _hello(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, _ENVELOPE)
        return codec.pack({
            **_echo(header), "ok": True, "protocol": [codec.VERSION], "server": f"glrender {glrender.__version__}",
            "operations": list(OPERATIONS), "outputs": list(OUTPUTS), "products": list(PRODUCTS), **self._described(),
            "limits": {"max_header_bytes": codec.MAX_HEADER_BYTES, "max_image_pixels": MAX_IMAGE_PIXELS,
                       "max_frame_bytes": MAX_FRAME_BYTES}})

    def _described(self) -> dict[str, Any]:
        return {
            "cameras": [{"name": c.name, "width_px": c.width_px, "height_px": c.height_px,
                         "focal_length_px": c.focal_length_px, "principal_point_px": list(c.principal_point_px),
                         "has_model": c.model is not None} for c in self._scene.cameras],
            "bodies": [{"name": b.name, "n_facets": len(b.shape.facets), "radius_m": b.shape.radius_m,
                        "law": b.brdf.glsl} for b in self._scene.bodies],
            "max_error": self._scene.max_error, **self._renderer.info}

    def _status(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, _ENVELOPE)
        return codec.pack({
            **_echo(header), "ok": True, "uptime_s": time.monotonic() - self._started,
            "requests": dict(self._requests), "errors": dict(self._errors), "clients": len(self._kept),
            "last_timings_ms": self._last_timings_ms, **self._described()})

    def _close(self, header: Mapping[str, Any]) -> list[Any]:
        """The client says goodbye: nothing is kept for it any more. The server runs on."""
        known_keys("", header, _ENVELOPE)
        self._kept.pop(header["client"], None)
        return codec.pack({**_echo(header), "ok": True})

    def _load_scene(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, (*_ENVELOPE, "scene"), required=("scene",))
        scene = Scene.from_dict(header["scene"], shape_dir=self._shape_dir, restricted=True)
        for index, camera in enumerate(scene.cameras):
            if camera.width_px * camera.height_px > MAX_IMAGE_PIXELS:
                raise ConfigError(f"scene.cameras[{index}]", f"must have at most {MAX_IMAGE_PIXELS} pixels",
                                  camera.width_px * camera.height_px)
        # The old scene serves on if the new one fails.
        renderer = open_renderer(scene, self._backend)
        self._renderer.close()
        self._scene, self._renderer = scene, renderer
        return codec.pack({**_echo(header), "ok": True, **self._described()})

    def _render(self, header: Mapping[str, Any]) -> list[Any]:
        known_keys("", header, (*_ENVELOPE, *_RENDER_KEYS), required=("state",))
        began = time.perf_counter()
        state = State.from_dict(header["state"])
        camera = self._scene.camera(header.get("camera"))
        output = one_of("output", header.get("output", "irradiance"), OUTPUTS)
        order = one_of("order", header.get("order", "C"), ("C", "F"))
        products = header.get("products", [])
        if not isinstance(products, list):
            raise ProtocolError("products", "must be a list of names", products)
        needed = peak_bytes(camera.width_px * camera.height_px, products)
        if needed > MAX_FRAME_BYTES:
            raise ConfigError("products", f"must take at most {MAX_FRAME_BYTES} bytes of memory while they are made",
                              needed, "ask for fewer at a time")
        exposure_s, seed = header.get("exposure_s"), header.get("seed", 0)
        if output == "dn":
            if camera.model is None:
                raise ConfigError("output", f"camera {camera.name!r} has no optics and detector", output,
                                  "give it a `model` in the scene, or ask for 'irradiance'")
            if exposure_s not in (None, "auto"):
                exposure_s = positive("exposure_s", exposure_s)
            seed = integer("seed", seed, 0, 2**64 - 1)
        elif "exposure_s" in header or "seed" in header:
            raise ProtocolError("exposure_s" if "exposure_s" in header else "seed",
                                "belongs to output 'dn'", output)
        options = {"after_psf": True} if output == "dn" and self._backend in ("auto", "egl", "osmesa") else {}
        image = self._renderer.render(state, camera.name, max_error=header.get("max_error"),
                                      samples=header.get("samples"), products=products, **options)
        timings = dict(image.timings_ms)
        fields: dict[str, Any] = {"unit": _UNITS[output]}
        pixels = image.irradiance_W_m2
        if output == "dn":
            exposed = time.perf_counter()
            frame = camera.expose(pixels, seed, exposure_s=exposure_s, roi=image.roi)
            timings["camera"] = 1e3 * (time.perf_counter() - exposed)
            pixels = frame.dn
            fields |= {"exposure_s": frame.exposure_s, "seed": seed, "stages": frame.stages,
                       "n_saturated_px": int(frame.saturated.sum())}
        arrays = {"image": (pixels, _UNITS[output])}
        arrays |= {name: (array, _UNITS[name]) for name, array in image.products.items()}
        timings["total"] = 1e3 * (time.perf_counter() - began)
        self._last_timings_ms = timings
        return codec.pack({**_echo(header), "ok": True, "t_s": state.t_s, "camera": camera.name, "output": output,
                           "plan": image.plan.to_dict(), "timings_ms": timings, **fields}, arrays, order)


def _checked_envelope(header: Mapping[str, Any]) -> str:
    """The client's name, after the four fields that every request has."""
    for key in _ENVELOPE:
        if key not in header:
            raise ProtocolError(key, "missing")
    if isinstance(header["v"], bool) or header["v"] != codec.VERSION:
        raise ProtocolError("v", f"this server speaks version {codec.VERSION}", header["v"])
    integer("id", header["id"], 0, 2**64 - 1)
    if not isinstance(header["client"], str) or not 0 < len(header["client"]) <= 128:
        raise ProtocolError("client", "must be a name of 1 to 128 characters", header["client"])
    one_of("op", header["op"], OPERATIONS)
    return header["client"]


def _echo(header: Mapping[str, Any]) -> dict[str, Any]:
    """What every reply repeats of its request."""
    number = header.get("id")
    op, client = header.get("op"), header.get("client")
    return {"v": codec.VERSION, "op": op if isinstance(op, str) else "",
            "id": number if isinstance(number, int) and 0 <= number < 2**64 else 0,
            "client": client if isinstance(client, str) else ""}
