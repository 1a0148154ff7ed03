"""The scene: bodies, cameras, the Sun and the error tolerance, validated once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from glrender_camera import CameraModel, MosaicModel, PinholeCamera
from glrender_camera.validate import did_you_mean, known_keys, within

from ..base.constants import TOTAL_SOLAR_IRRADIANCE_W_M2
from ..base.errors import ConfigError, SceneError, error_path
from ..base.plausible import Advice
from . import scene_file as scene_tables
from .body import Body
from .lamp import Lamp
from .plausible import camera_doubts, law_doubts, refuse_bands_without_sun
from .shape.convex_hull import Hull
from .solar_irradiance import box_irradiance_1au_W_m2
from .stars import Stars
from .tolerance import checked_max_error

__all__ = ["Body", "Scene", "band_irradiances", "load_scene"]

SCENE_KEYS = ("bodies", "cameras", "stars", "solar_irradiance_1au_W_m2", "max_error", "sun_disc",
              "emission", "lamps")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A scene holds the bodies, cameras and settings that do not change from frame to frame.

    Parameters
    ----------
    bodies : sequence of Body
    cameras : sequence of PinholeCamera
    solar_irradiance_1au_W_m2 : float [W/m2], 1e-6..1e9, optional
        In the cameras' band, at 1 au. By default each camera has its own: that of its optics' `band_nm`
        (ASTM E490-00a), or the total solar irradiance, 1360.8 W/m2, of a camera without a model.
    max_error : float [1], 0..1, or mapping
        Error tolerance: RMS irradiance error over the mean of the lit pixels; or of each unit that it names, out of
        `tolerance.UNITS`.
    sun_disc : bool
        Whether the Sun has a disc, and shadows penumbras where they show; a point otherwise.
    stars : Stars, optional
        The sky behind the bodies, of frames with a detector.
    emission : sequence
        Light that no surface scatters, as `emission_frame.Emission`: none unless asked for.
    lamps : sequence of Lamp
        On the spacecraft.
    """

    bodies: Sequence[Body]
    cameras: Sequence[PinholeCamera]
    solar_irradiance_1au_W_m2: float | None = None
    max_error: float | Mapping[str, float] = field(default=0.02)
    sun_disc: bool = True
    stars: Stars | None = None
    emission: Sequence[Any] = ()
    lamps: Sequence[Lamp] = ()

    def __post_init__(self):
        for label, kind in (("bodies", Body), ("cameras", PinholeCamera), ("lamps", Lamp)):
            members = getattr(self, label)
            if not isinstance(members, Iterable):
                raise ConfigError(label, f"must be a sequence of {kind.__name__}", members)
            members = tuple(members)
            if not members and kind is not Lamp:
                raise ConfigError(label, "must have at least one member")
            names = set()
            for index, member in enumerate(members):
                if not isinstance(member, kind):
                    raise ConfigError(f"{label}[{index}]", f"must be a {kind.__name__}", member)
                if member.name in names:
                    raise ConfigError(f"{label}[{index}].name", "must be unique", member.name)
                names.add(member.name)
            object.__setattr__(self, label, members)
        if self.stars is not None and not isinstance(self.stars, Stars):
            raise ConfigError("stars", "must be Stars", self.stars)
        if self.solar_irradiance_1au_W_m2 is not None:
            if any(isinstance(camera.model, MosaicModel) for camera in self.cameras):
                raise ConfigError("solar_irradiance_1au_W_m2", "must be left out where a camera has a mosaic, whose "
                                  "bands have each their own", self.solar_irradiance_1au_W_m2)
            object.__setattr__(self, "solar_irradiance_1au_W_m2",
                               within("solar_irradiance_1au_W_m2", self.solar_irradiance_1au_W_m2, 1e-6, 1e9))
        else:
            for index, camera in enumerate(self.cameras):
                refuse_bands_without_sun(index, camera)
        object.__setattr__(self, "max_error", checked_max_error(self.max_error))
        if not isinstance(self.sun_disc, bool):
            raise ConfigError("sun_disc", "must be true or false", self.sun_disc)
        object.__setattr__(self, "emission", tuple(self.emission))
        for index, emission in enumerate(self.emission):
            if emission.body not in {body.name for body in self.bodies if body.materials is None}:
                raise ConfigError(f"emission[{index}].body", "must be a body of the scene, of one law", emission.body)

    def __repr__(self) -> str:
        cameras = ", ".join(f"{camera.name} {camera.width_px} x {camera.height_px} px" for camera in self.cameras)
        return f"<Scene of {', '.join(map(repr, self.bodies))}; cameras {cameras}; max_error {self.max_error}>"

    @cached_property
    def hulls(self) -> dict[str, Hull]:
        """Convex hulls of the bodies, by name, in the scene's order."""
        return {body.name: body.hull for body in self.bodies}

    @cached_property
    def doubts(self) -> dict[str, tuple[Advice, ...]]:
        """Warnings by camera of its and all laws' fields that are improbable, most often for their unit."""
        laws = tuple(advice for index, body in enumerate(self.bodies) for advice in law_doubts(index, body))
        return {camera.name: camera_doubts(index, camera, self.solar_irradiance_1au_W_m2) + laws
                for index, camera in enumerate(self.cameras)}

    def solar_irradiance_of(self, camera: PinholeCamera) -> float:
        """Solar irradiance in a camera's band at 1 au [W/m2]; of a mosaic in that of its pattern's first letter.

        A camera that only draws for one of the scene's, whose name it has, is in that one's band.
        """
        if self.solar_irradiance_1au_W_m2 is not None:
            return self.solar_irradiance_1au_W_m2
        model = next((own.model for own in self.cameras if own.name == camera.name), camera.model)
        return TOTAL_SOLAR_IRRADIANCE_W_M2 if model is None else next(iter(band_irradiances(model).values()))

    def camera(self, name: str | None) -> PinholeCamera:
        """The camera of a name; None is the only one."""
        if name is None and len(self.cameras) == 1:
            return self.cameras[0]
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise SceneError("camera", "unknown camera", name,
                         did_you_mean(name, names := [camera.name for camera in self.cameras])
                         or f"the scene has {', '.join(names)}")

    def drawn_camera(self, camera: str | PinholeCamera | None, draws_lenses: bool = False) -> PinholeCamera:
        """The camera that a renderer draws for: one of the scene's by name, or one that draws for it.

        Raises
        ------
        ConfigError
            A camera that distorts, and a renderer that draws no image of it directly.
        """
        pinhole = camera if isinstance(camera, PinholeCamera) else self.camera(camera)
        if pinhole.distortion is not None and not draws_lenses:
            raise ConfigError("camera", f"camera {pinhole.name!r} distorts, and this renderer draws no image of it",
                              hint="glrender.take_frame and draw_still do, from what lens_of(camera).source sees")
        return pinhole

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], *, shape_dir: str | Path | None = None, path: str = "scene",
                  restricted: bool = False) -> Scene:
        """A scene from plain data: a TOML file's, or the wire's.

        Parameters
        ----------
        table : mapping
            Keys as in `docs/scene.md`.
        shape_dir : path, optional
            Where relative shape and texture names are looked up.
        restricted : bool
            Only bare file names inside `shape_dir`: for what comes over the wire.

        Raises
        ------
        ConfigError
            With the path of the field.
        """
        known_keys(path, table, SCENE_KEYS, required=("bodies", "cameras"))
        files = scene_tables.Files(Path(shape_dir) if shape_dir is not None else None, restricted)

        def each(key: str, read: Callable[..., Any], *more: Any) -> list[Any]:
            return [read(entry, f"{path}.{key}[{i}]", *more)
                    for i, entry in enumerate(scene_tables.tables(f"{path}.{key}", table[key]))]

        bodies, cameras = each("bodies", scene_tables.body, files), each("cameras", scene_tables.camera)
        rest = {key: table[key] for key in ("solar_irradiance_1au_W_m2", "max_error", "sun_disc") if key in table}
        if "stars" in table:
            rest["stars"] = scene_tables.stars(table["stars"], f"{path}.stars")
        if "emission" in table:
            rest["emission"] = each("emission", scene_tables.emission, files, {body.name: body for body in bodies})
        if "lamps" in table:
            rest["lamps"] = each("lamps", scene_tables.lamp)
        with error_path(path):
            return cls(bodies=bodies, cameras=cameras, **rest)


def load_scene(path: str | Path) -> Scene:
    """A scene from a TOML file; names of shapes and textures are relative to it.

    Raises
    ------
    ConfigError
        The file is missing, is not TOML, or a field breaks a rule.
    """
    path = Path(path)
    return Scene.from_dict(scene_tables.read_toml(path), shape_dir=path.parent, path=path.name)


def band_irradiances(model: CameraModel | MosaicModel) -> dict[str, float]:
    """Solar irradiance at 1 au [W/m2] of each band (ASTM E490-00a), the pattern's first letter first."""
    letters = dict.fromkeys("".join(model.pattern)) if isinstance(model, MosaicModel) else model.bands
    return {letter: box_irradiance_1au_W_m2(model.bands[letter].optics.band_nm) for letter in letters}
