"""Options of a sequence's frames, out of the table [output] of a scenario file and of a caller's arguments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from glrender_camera.camera import checked_exposure
from glrender_camera.validate import integer, known_keys, one_of

from ..base.errors import ConfigError
from ..base.names import OUTPUTS
from ..capture.outputs import checked_output, has_exposure
from ..engines.image import checked_products
from ..scene.scene import Scene
from ..scene.tolerance import checked_max_error
from .formats import STREAM, checked_ending
from .labels import Keypoints
from .surface_maps import UNITS

OUTPUT_KEYS = ("camera", "output", "format", "products", "labels", "seed", "exposure_s", "max_error")
"""Fields of the table [output]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameOptions:
    """Options of every frame of a sequence.

    Parameters
    ----------
    camera : str
        Name.
    output : "irradiance", "dn" or "compressed"
    format : str, optional
        One of `FORMATS`, "fits" by default; of "compressed" "stream" alone.
    seed : int
        But for "irradiance": each frame's noise has a seed of its own, made of this one and of its number by `seed_of`.
    exposure_s : float [s] or "auto", optional
        But for "irradiance"; the camera's by default.
    products : tuple of str
        As of `Renderer.render`, and of `surface_maps`.
    has_labels : bool
        Whether the header has the labels of `frame_labels`.
    keypoints : mapping
        For labels: places (3,) [m] in a body's frame, by the names of the body and the keypoint.
    limb_points : int, 0..1000
        For labels: of each body.
    max_error : float or mapping, optional
        The scene's by default.
    backend : str
        As of `open_renderer`.
    """

    camera: str
    output: str = "irradiance"
    format: str = ""
    seed: int = 0
    exposure_s: float | str | None = None
    products: tuple[str, ...] = ()
    has_labels: bool = False
    keypoints: Keypoints = field(default_factory=dict)
    limb_points: int = 0
    max_error: float | Mapping[str, float] | None = None
    backend: str = "auto"

    def __post_init__(self):
        one_of("output", self.output, OUTPUTS)
        if not self.format:
            object.__setattr__(self, "format", STREAM if self.output == "compressed" else "fits")
        if self.output == "compressed" and self.format != STREAM:
            raise ConfigError("format", "must be stream with output 'compressed'", self.format,
                              "leave it out (--format stream), or ask for 'dn', the numbers that are decoded from it")
        if self.format != STREAM:
            checked_ending(self.format, self.unit)
        elif self.output != "compressed":
            raise ConfigError("format", "goes with output 'compressed' alone", self.format,
                              "leave it out, or ask for that output")
        integer("seed", self.seed, 0, 2**63)
        integer("limb_points", self.limb_points, 0, 1000)
        if self.is_of_detector and "irradiance" in self.products:
            raise ConfigError("products", f"must not have 'irradiance' with output {self.output!r}: it is another "
                              "image", list(self.products),
                              "leave it out, or draw a second sequence of output 'irradiance'")
        object.__setattr__(self, "products", checked_products(self.products, tuple(UNITS)))
        if self.products and self.format in ("png", STREAM):
            raise ConfigError("products", f"must be none with format {self.format}, which holds the image alone",
                              list(self.products), "use fits, npz or exr" if self.format == "png" else
                              "leave them out (--products without a name), or ask for output 'dn'")
        if self.exposure_s is not None:
            checked_exposure("exposure_s", self.exposure_s)
            if not self.is_of_detector:
                raise ConfigError("exposure_s", "goes with output 'dn' or 'compressed' alone", self.exposure_s)
        if self.max_error is not None:
            object.__setattr__(self, "max_error", checked_max_error(self.max_error))

    @property
    def unit(self) -> str:
        """The pixels' unit; of a stream, that of the decoded pixels."""
        return "DN" if self.is_of_detector else "W/m2"

    @property
    def is_of_detector(self) -> bool:
        """Whether frames have an exposure, noise and faults."""
        return has_exposure(self.output)

    def to_dict(self) -> dict[str, Any]:
        """The options as plain data."""
        keypoints = {body: {name: list(map(float, place)) for name, place in places.items()}
                     for body, places in self.keypoints.items()}
        return {**{each.name: getattr(self, each.name) for each in fields(self)},
                "products": list(self.products), "keypoints": keypoints}

    @property
    def text(self) -> str:
        """The options in words."""
        parts = [f"{self.format} of {'compressed ' * (self.format == STREAM)}{self.unit}", f"camera {self.camera}"]
        if self.products:
            parts.append(f"products {', '.join(self.products)}")
        if self.has_labels:
            parts.append("labels")
        if self.is_of_detector:
            exposure = "the camera's" if self.exposure_s is None else self.exposure_s
            parts += [f"seed {self.seed}", f"exposure {exposure}{' s' if isinstance(exposure, float) else ''}"]
        if self.max_error is not None:
            parts.append(f"max_error {self.max_error}")
        return ", ".join(parts)


def options_of(scene: Scene, table: Mapping[str, Any], asked: Mapping[str, Any] | None = None,
               backend: str = "auto") -> FrameOptions:
    """The options of a scene's frames.

    Parameters
    ----------
    scene : Scene
    table : mapping
        [output] of a scenario file, with keys out of `OUTPUT_KEYS`.
    asked : mapping, optional
        Values that override it, with the same keys; None leaves the table's.
    backend : str

    Raises
    ------
    ConfigError
        An unknown field, a value that breaks a rule, a camera that the scene has not.
    """
    known_keys("", table, OUTPUT_KEYS)
    chosen = {**table, **{key: value for key, value in (asked or {}).items() if value is not None}}
    products, labels = chosen.pop("products", []), chosen.pop("labels", False)
    if not isinstance(products, list | tuple):
        raise ConfigError("products", "must be a list of names", products)
    if not isinstance(labels, bool):
        raise ConfigError("labels", "must be true or false", labels)
    camera = scene.camera(chosen.pop("camera", scene.cameras[0].name)).name
    options = FrameOptions(camera=camera, products=tuple(products), has_labels=labels, backend=backend, **chosen)
    checked_output(options.output, scene.camera(options.camera))
    return options


def exposures_of(scene: Scene, options: FrameOptions) -> tuple[float, ...]:
    """Spans [s] about a state from which its frame has light: the exposure, or the limits of "auto".

    Rows that are read later have light from later; irradiance has no exposure.
    """
    camera = scene.camera(options.camera)
    if not options.is_of_detector or camera.model is None:
        return ()
    asked: Any = camera.model.exposure_s if options.exposure_s is None else options.exposure_s
    limits = camera.model.auto_exposure
    read_out_s = abs(camera.model.detector.rolling_shutter_row_s) * camera.height_px
    return tuple(each + read_out_s for each in ((limits.min_s, limits.max_s) if asked == "auto" else (asked,)))
