"""Operations that need a renderer: one scene, one renderer, one request after the other."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from glrender import (
    Capture,
    ConfigError,
    DeviceError,
    GlrenderError,
    PinholeCamera,
    ProtocolError,
    Scene,
    SceneError,
    State,
    compare_frame,
    draw_still,
    open_renderer,
    take_frame,
)
from glrender.base.errors import error_path
from glrender.base.names import OUTPUTS, PRODUCTS
from glrender.capture.outputs import has_exposure
from glrender.capture.static_exposure import prepare
from glrender.engines.advice import Advice, scene_advice
from glrender.engines.rays.laser_ranges import RangeNoise, laser_ranges
from glrender.scene.plugins.registry import backends
from glrender_camera import MosaicModel
from glrender_camera.validate import known_keys, one_of

from . import codec, pixels
from .asked_scene import scene_asked
from .compared import Compared
from .envelope import ENVELOPE, echo, refusal
from .frame import FRAME_KEYS, FrameRequest, frames_asked
from .scene_digest import scene_digest

log = logging.getLogger(__name__)

_TOLD_OF_DETECTORS = ("gain_DN_per_electron", "offset_DN", "bit_depth", "full_well_electrons",
                      "read_noise_electrons")
_RANGE_KEYS = ("state", "camera", "directions_camera", "noise")
_UNITS = {**OUTPUTS, **PRODUCTS}


class Answer(NamedTuple):
    """The answer to a request."""

    reply: list[Any]
    """The message's parts."""
    code: str = ""
    """The error code; empty if it went well."""
    timings_ms: dict[str, float] = {}
    warnings: Sequence[tuple[str, tuple[Advice, ...]]] = ()
    """Of each frame its camera's name, and what it warns of and notes."""


class Operations:
    """Serves one scene with one renderer, in the thread that made it.

    Parameters
    ----------
    scene : Scene
    backend : str
        As of `glrender.open_renderer`.
    shape_dir : path, optional
        Where `load_scene` may look for shapes; without it only generated bodies load.
    digest : str, optional
        The scene's (`scene_digest`), of one that a renderer has had before.
    on_scene : callable, optional
        Called with a scene that was asked for and its digest, before a renderer has it.
    on_progress : callable, optional
        Called while a slow frame is drawn, with the share done of the request's frames.
    """

    def __init__(self, scene: Scene, backend: str = "auto", shape_dir: Path | None = None, digest: str | None = None,
                 on_scene: Callable[[Scene, str], None] = lambda scene, digest: None,
                 on_progress: Callable[[float], None] = lambda share: None):
        self._backend, self._shape_dir = backend, shape_dir
        self.digest = scene_digest(scene) if digest is None else digest
        prepare(scene)
        self.scene, self._renderer = scene, open_renderer(scene, backend)
        self._others: dict[str, Any] = {}
        self._of_scene = scene_advice(scene)
        self._by_name = {"render": self._render, "range": self._range, "load_scene": self._load_scene}
        self._on_scene, self._on_progress = on_scene, on_progress

    def close(self) -> None:
        """Release the renderers."""
        for renderer in (self._renderer, *self._others.values()):
            renderer.close()
        self._others.clear()

    @property
    def described(self) -> dict[str, Any]:
        """The scene and the OpenGL behind it, as `hello` describes them."""
        return {
            "scene": self.digest, "cameras": [{"name": c.name, "width_px": c.width_px, "height_px": c.height_px,
                         "focal_length_px": c.focal_length_px, "principal_point_px": list(c.principal_point_px),
                         "has_model": c.model is not None,
                         "q_camera_from_spacecraft": list(map(float, c.q_camera_from_spacecraft)),
                         "r_camera_spacecraft_m": list(map(float, c.r_camera_spacecraft_m)),
                         "detector": None if c.model is None else {
                             name: getattr(c.model.detector, name) for name in _TOLD_OF_DETECTORS},
                         "distortion": None if c.distortion is None else asdict(c.distortion),
                         "compression": None if c.model is None or c.model.compression is None
                         else c.model.compression.to_dict(),
                         "mosaic": list(c.model.pattern) if isinstance(c.model, MosaicModel) else None}
                        for c in self.scene.cameras],
            "bodies": [{"name": b.name, "n_facets": len(b.shape.facets), "radius_m": b.shape.radius_m,
                        "law": ", ".join(dict.fromkeys(law.glsl for law in b.laws)),
                        "warnings": list(b.shape.report.warnings)} for b in self.scene.bodies],
            "max_error": self.scene.max_error, "warnings": [*map(asdict, self._of_scene)],
            "stars": None if self.scene.stars is None else asdict(self.scene.stars), **self._renderer.info}

    def answer_message(self, message: bytes, memory: pixels.Memory | None = None) -> Answer:
        """As `answer`, of a request's bytes: its lists and maps are decoded here, at its sender's cost."""
        try:
            header = codec.unpack_request([message])
        except GlrenderError as error:
            return Answer(refusal(codec.unpack_envelope([message]), error.code, "", str(error)), error.code)
        return self.answer(header, memory)

    def replace(self, scene: Scene, digest: str) -> None:
        """Serve another scene; the old one serves on if the new one fails."""
        prepare(scene)
        renderer = open_renderer(scene, self._backend)
        before = self._renderer, *self._others.values()
        self.scene, self.digest, self._renderer, self._others = scene, digest, renderer, {}
        self._of_scene = scene_advice(scene)
        for each in before:
            each.close()

    def answer(self, header: Mapping[str, Any], memory: pixels.Memory | None = None) -> Answer:
        """The answer to one request; raises nothing.

        The arrays are written to `memory`, if it is given.
        A caller's error is answered with `code`, `path` and `message`; anything else is a bug:
        logged with its traceback, answered `internal`, and survived.
        """
        try:
            return self._by_name[header["op"]](header, memory)
        except GlrenderError as error:
            return Answer(refusal(header, error.code, getattr(error, "path", ""), str(error)), error.code)
        except MemoryError:
            log.exception("request %s needs more memory than there is", header.get("op"))
            return Answer(refusal(header, "device", "", "the server has not the memory for this request; ask for less, "
                                                        "or start it with more --worker-memory"), "device")
        except Exception:
            log.exception("request %s failed", header.get("op"))
            return Answer(refusal(header, "internal", "", "the server failed on this request; its log has the "
                                                          "traceback"), "internal")

    def _load_scene(self, header: Mapping[str, Any], memory: pixels.Memory | None) -> Answer:
        scene = scene_asked(header, self._shape_dir)
        digest = scene_digest(scene)
        self._on_scene(scene, digest)
        self.replace(scene, digest)
        return Answer(codec.pack({**echo(header), "ok": True, **self.described}))

    def _render(self, header: Mapping[str, Any], memory: pixels.Memory | None) -> Answer:
        known_keys("", header, (*ENVELOPE, "scene", "state", "order", "backend", "shared", "background", "frames",
                                *FRAME_KEYS), required=("state",))
        began = time.perf_counter()
        self._check_scene(header)
        state = State.from_dict(header["state"])
        order = one_of("order", header.get("order", "C"), ("C", "F"))
        for key in ("shared", "background"):
            if not isinstance(header.get(key, False), bool):
                raise ConfigError(key, "must be true or false", header[key])
        if header.get("background") and "backend" in header:
            raise ConfigError("background", "goes with no backend", hint="nobody waits for minutes behind it")
        backend = one_of("backend", header["backend"], tuple(backends())) if "backend" in header else None
        backend = None if backend == self._backend else backend
        asked, made, arrays, warnings = frames_asked(header, self.scene), [], [], []
        place: dict[str, Any] = {}
        if memory is not None and len(asked) == 1 and order == "C" and asked[0].is_sent_as_drawn:
            parts = memory([4 * asked[0].camera.width_px * asked[0].camera.height_px])
            place, memory = {"out": _image_in(parts[0], asked[0].camera)}, lambda sizes: parts
        for index, frame in enumerate(asked):
            progress = partial(self._progress, index, len(asked))
            with frame.named_errors():
                fields, of_frame, advice = self._frame(state, frame, backend, {"on_progress": progress, **place})
            made.append(fields)
            arrays.append(of_frame)
            warnings.append((frame.camera.name, advice))
        if "frames" in header:
            fields = {"frames": made, "timings_ms": _summed(frame["timings_ms"] for frame in made)}
        else:
            arrays, fields = arrays[0], made[0]
        # The frames' temporary memory is freed by now: that is part of their time.
        fields["timings_ms"]["total"] = 1e3 * (time.perf_counter() - began)
        fields = {**echo(header), "ok": True, "scene": self.digest, "t_s": state.t_s, **fields}
        return Answer(pixels.pack(fields, arrays, order, memory), timings_ms=fields["timings_ms"], warnings=warnings)

    def _frame(self, state: State, asked: FrameRequest, backend: str | None,
               drawing: Mapping[str, Any]
               ) -> tuple[dict[str, Any], dict[str, tuple[np.ndarray, str]], tuple[Advice, ...]]:
        """The reply's fields of one frame, its arrays with their units, and its warnings and notes."""
        if asked.compared is not None:
            return self._compared(state, asked, asked.compared, backend, drawing)
        camera, fields, began = asked.camera, {}, time.perf_counter()
        options = {"products": asked.products, "max_error": asked.max_error, "samples": asked.samples, **drawing}
        if asked.deadline_s is not None:
            options["deadline_s"] = asked.deadline_s
        if has_exposure(asked.output):
            options |= {"seed": asked.seed, "exposure_s": asked.exposure_s, "faults": asked.faults}
            capture = self._drawn(backend, take_frame, state, camera.name, **options)
            frame, image = capture.frame, capture.frame.dn
            fields = {"exposure_s": frame.exposure_s, "seed": asked.seed,
                      "n_saturated_px": int(np.count_nonzero(asked.cut(frame.saturated)))}
            if asked.output == "compressed":
                image = np.frombuffer(frame.stream, np.uint8)
                fields |= {"codec": camera.model.compression.codec, "shape": list(frame.dn.shape),
                           "bit_depth": camera.model.detector.bit_depth}
            if asked.faults or camera.model.faults:
                fields["faults"] = list(frame.faults)
            if "auto" in (asked.exposure_s, camera.model.exposure_s):
                # The memory of an onboard loop is the client's: sent back, the same request gives the same bytes.
                fields["next_exposure_s"] = camera.model.auto_exposure.after(frame, camera.model.detector)
        else:
            capture = self._drawn(backend, draw_still, state, camera.name, roi=asked.roi, **options)
            image = capture.irradiance_W_m2
        if asked.deadline_s is not None:
            fields["is_late"] = time.perf_counter() - began > asked.deadline_s
        arrays = {"image": (asked.cut(image), _UNITS[asked.output])}
        arrays |= {name: (asked.cut(array), _UNITS[name]) for name, array in capture.products.items()}
        own = [advice for advice in capture.warnings if advice not in self._of_scene]
        return {"camera": camera.name, "output": asked.output, "plan": capture.plan.to_dict(),
                "timings_ms": dict(capture.timings_ms), "stages": capture.stages, "unit": _UNITS[asked.output],
                "warnings": [*map(asdict, (*own, *self._of_scene))], "notes": [*map(asdict, capture.notes)],
                **fields, **({"roi": asked.roi} if asked.roi else {})}, arrays, (*own, *capture.notes)

    def _compared(self, state: State, asked: FrameRequest, compared: Compared, backend: str | None,
                  drawing: Mapping[str, Any]
                  ) -> tuple[dict[str, Any], dict[str, tuple[np.ndarray, str]], tuple[Advice, ...]]:
        """The same of a frame that is compared, without an array."""
        options = {"max_error": asked.max_error, "samples": asked.samples, "roi": asked.roi,
                   "exposure_s": asked.exposure_s, **compared.options, **drawing}
        began, late = time.perf_counter(), {}
        if asked.deadline_s is not None:
            options["deadline_s"] = asked.deadline_s
        found = self._drawn(backend, compare_frame, state, asked.camera.name, **options)
        if asked.deadline_s is not None:
            late = {"is_late": time.perf_counter() - began > asked.deadline_s}
        own = tuple(advice for advice in found.warnings if advice not in self._of_scene)
        return {"camera": asked.camera.name, "output": "dn", "unit": _UNITS["dn"], "comparison": found.to_dict(),
                "exposure_s": found.exposure_s, "predicted": found.plan.to_dict()["predicted"],
                "jacobian_error": dict(found.plan.jacobian_error), "timings_ms": dict(found.timings_ms),
                "warnings": [*map(asdict, (*own, *self._of_scene))], "notes": [], **late}, {}, own

    def _range(self, header: Mapping[str, Any], memory: pixels.Memory | None) -> Answer:
        known_keys("", header, (*ENVELOPE, "scene", *_RANGE_KEYS), required=("state", "directions_camera"))
        began = time.perf_counter()
        self._check_scene(header)
        state, camera = State.from_dict(header["state"]), self.scene.camera(header.get("camera"))
        noise = None
        if "noise" in header:
            table = known_keys("noise", header["noise"], ("sigma_m", "resolution_m", "max_range_m", "seed"))
            with error_path("noise"):
                noise = RangeNoise(**table)
        found = laser_ranges(self.scene, state, header["directions_camera"], camera.name, noise)
        arrays = {"range": (found.range_m, "m"), "body_id": (found.body_id, "1"), "facet_id": (found.facet_id, "1"),
                  "beam_incidence": (found.beam_incidence, "rad")}
        timings_ms = {"total": 1e3 * (time.perf_counter() - began)}
        fields = {**echo(header), "ok": True, "scene": self.digest, "t_s": state.t_s, "camera": camera.name,
                  "timings_ms": timings_ms}
        return Answer(pixels.pack(fields, arrays, memory=memory), timings_ms=timings_ms)

    def _check_scene(self, header: Mapping[str, Any]) -> None:
        """Refuse a request that means another scene."""
        wanted = header.get("scene", self.digest)
        if not isinstance(wanted, str):
            raise ProtocolError("scene", "must be the digest of a scene, as `load_scene` and `hello` give it", wanted)
        if wanted != self.digest:
            raise SceneError("scene", f"another scene is served, {self.digest}", wanted,
                             "load yours again, or leave the field out to be shown whatever is served")

    def _progress(self, n_before: int, n_frames: int, share: float) -> None:
        share = (n_before + share) / n_frames
        log.debug("slow frames: %.0f %%", 100.0 * share)
        self._on_progress(share)

    def _drawn(self, backend: str | None, draw: Callable[..., Capture], state: State, camera: str,
               **options) -> Capture:
        """The capture that `draw` makes; a context that was lost is made anew, once."""
        try:
            return draw(self._renderer_of(backend), state, camera, **options)
        except DeviceError as error:
            log.warning("%s failed, the renderer is made anew: %s", backend or "OpenGL", error)
            if backend is not None:
                self._others.pop(backend).close()
            else:
                self._renderer.close()
                self._renderer = open_renderer(self.scene, self._backend)
            return draw(self._renderer_of(backend), state, camera, **options)

    def _renderer_of(self, backend: str | None) -> Any:
        """The server's renderer, or that of a backend which a request names: it is opened by the first and kept."""
        if backend is None:
            return self._renderer
        if backend not in self._others:
            try:
                self._others[backend] = open_renderer(self.scene, backend)
            except DeviceError as error:
                raise ConfigError("backend", f"does not work here: {error}", backend) from error
        return self._others[backend]


def _image_in(part: memoryview, camera: PinholeCamera) -> np.ndarray:
    """The irradiance of a camera in memory that is lent."""
    return np.frombuffer(part, np.float32).reshape(camera.height_px, camera.width_px)


def _summed(timings_ms: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """The time of each stage over all frames."""
    total: dict[str, float] = {}
    for of_frame in timings_ms:
        for stage, milliseconds in of_frame.items():
            total[stage] = total.get(stage, 0.0) + milliseconds
    return total
