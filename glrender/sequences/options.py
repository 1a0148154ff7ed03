"""Options of a sequence's frames, out of the table [output] of a scenario file and of what is asked beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from glrender_camera.camera import checked_exposure
from glrender_camera.validate import integer, known_keys, one_of

from ..base.errors import ConfigError
from ..engines.image import checked_products
from ..scene.scene import Scene
from ..scene.tolerance import checked_max_error
from .formats import checked_ending
from .labels import Keypoints

OUTPUT_KEYS = ("camera", "output", "format", "products", "labels", "seed", "exposure_s", "max_error")
"""Fields of the table [output]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameOptions:
    """Options of every frame of a sequence.

    Parameters
    ----------
    camera : str
        Name.
    output : "irradiance" or "dn"
    format : "fits", "npz", "png" or "exr"
    seed : int
        With "dn": each frame's noise has a seed of its own, made of this one and of its number by `seed_of`.
    exposure_s : float [s] or "auto", optional
        With "dn"; the camera's by default.
    products : tuple of str
        As of `Renderer.render`.
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
    format: str = "fits"
    seed: int = 0
    exposure_s: float | str | None = None
    products: tuple[str, ...] = ()
    has_labels: bool = False
    keypoints: Keypoints = field(default_factory=dict)
    limb_points: int = 0
    max_error: float | Mapping[str, float] | None = None
    backend: str = "auto"

    def __post_init__(self):
        one_of("output", self.output, ("irradiance", "dn"))
        checked_ending(self.format, self.unit)
        integer("seed", self.seed, 0, 2**63)
        integer("limb_points", self.limb_points, 0, 1000)
        if self.output == "dn" and "irradiance" in self.products:
            raise ConfigError("products", "must not have 'irradiance' beside output 'dn': it is another image",
                              list(self.products), "leave it out, or draw a second sequence of output 'irradiance'")
        object.__setattr__(self, "products", checked_products(self.products))
        if self.products and self.format == "png":
            raise ConfigError("products", "must be none with format png, which holds the image alone",
                              list(self.products), "use fits, npz or exr")
        if self.exposure_s is not None:
            checked_exposure("exposure_s", self.exposure_s)
            if self.output != "dn":
                raise ConfigError("exposure_s", "goes with output 'dn' alone", self.exposure_s)
        if self.max_error is not None:
            object.__setattr__(self, "max_error", checked_max_error(self.max_error))

    @property
    def unit(self) -> str:
        """The pixels' unit."""
        return "DN" if self.output == "dn" else "W/m2"

    def to_dict(self) -> dict[str, Any]:
        """The options as plain data."""
        keypoints = {body: {name: list(map(float, place)) for name, place in places.items()}
                     for body, places in self.keypoints.items()}
        return {**{each.name: getattr(self, each.name) for each in fields(self)},
                "products": list(self.products), "keypoints": keypoints}

    @property
    def text(self) -> str:
        """The options in words."""
        parts = [f"{self.format} of {self.unit}", f"camera {self.camera}"]
        if self.products:
            parts.append(f"products {', '.join(self.products)}")
        if self.has_labels:
            parts.append("labels")
        if self.output == "dn":
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
        What overrides it, with the same keys; None leaves the table's.
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
    require_model(scene, options)
    return options


def exposures_of(scene: Scene, options: FrameOptions) -> tuple[float, ...]:
    """Spans [s] about a state from which its frame has light: the exposure, or the limits of "auto".

    Rows that are read later have light from later; irradiance has no exposure.
    """
    camera = scene.camera(options.camera)
    if options.output != "dn" or camera.model is None:
        return ()
    asked: Any = camera.model.exposure_s if options.exposure_s is None else options.exposure_s
    limits = camera.model.auto_exposure
    read_out_s = abs(camera.model.detector.rolling_shutter_row_s) * camera.height_px
    return tuple(each + read_out_s for each in ((limits.min_s, limits.max_s) if asked == "auto" else (asked,)))


def require_model(scene: Scene, options: FrameOptions) -> None:
    """Refuse digital numbers of a camera that has no detector."""
    if options.output == "dn" and scene.camera(options.camera).model is None:
        raise ConfigError("output", f"camera {options.camera!r} has no optics and detector", "dn",
                          "give it a `model` in the scene, or ask for 'irradiance'")
