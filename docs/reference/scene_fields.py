"""Fields of scene and scenario files, read from the classes that they become.

`python docs/reference/scene_fields.py` writes the page `scene_files.md` anew; a test holds it equal to the classes.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from glrender import Body, Detail, Lamp, PinholeCamera, Scene, Stars, generate
from glrender.brdf.presets import PRESETS as LAW_PRESETS
from glrender.scenario import disturbances, dynamics, encounter, kepler, paths, random_states, samplers, torques
from glrender.scenario.attitude import Fixed, Pointing, Spin
from glrender.scenario.files.fields import with_scales
from glrender.scenario.spice.instrument import camera_of_kernel
from glrender.scenario.spice.kernels import Spice
from glrender.scenario.spice.sources import SpiceAttitude
from glrender.scene.detail.config import Boulders, Craters, Noise
from glrender.scene.formats.terrain import patch
from glrender.scene.plugins.registry import laws
from glrender.scene.shape.regions import Region
from glrender.sequences.options import FrameOptions
from glrender_camera import AutoExposure, BrownConrady, CameraModel, Detector, MosaicModel, Optics
from glrender_camera.aberrations import Aberrations
from glrender_camera.presets import PRESETS as CAMERA_PRESETS
from glrender_camera.straylight import StrayLight
from numpydoc.docscrape import NumpyDocString

PAGE = Path(__file__).with_name("scene_files.md")
_HEAD = """# Fields of scene and scenario files

This page lists every field that a scene file or a scenario file may have; `glrender fields cameras.model.detector`
prints a part of it. [Scene files](../scene.md) and [scenarios](../scenario.md) say how they are used, and
`glrender init --scenario csv` (or spice, oem, isd, encounter, hover, dataset) writes a whole example.

"""


@dataclass(frozen=True)
class Field:
    """A field of a table: its type with unit and range, its default as TOML has it, and its meaning."""

    type: str
    default: str
    text: str


@dataclass(frozen=True)
class Table:
    """A table of a file.

    Parameters
    ----------
    name : str
        As in the file, with the choice that it depends on.
    made : sequence of callable
        Classes and functions whose parameters are the table's fields.
    left_out : sequence of str
        Parameters that are known otherwise.
    more : mapping of str to (str, str)
        Type and text of fields that no parameter is, or that a file gives in another way.
    optional : sequence of str
        Parameters without a default that a file may leave out.
    """

    name: str
    made: tuple[Callable, ...] = ()
    left_out: tuple[str, ...] = ()
    more: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    optional: tuple[str, ...] = ()

    def fields(self) -> dict[str, Field]:
        """The table's fields, in the order of the parameters."""
        found = {}
        for make in self.made:
            told = _documented(make)
            for name, parameter in inspect.signature(make).parameters.items():
                if name not in self.left_out and name not in found and parameter.kind is not parameter.VAR_KEYWORD:
                    kind, text = self.more.get(name) or told[name]
                    default = "" if name in self.optional else _default(parameter)
                    found[name] = Field(kind.removesuffix(", optional"), default, text)
        return found | {name: Field(kind, "", text) for name, (kind, text) in self.more.items() if name not in found}


def _documented(make: Callable) -> dict[str, tuple[str, str]]:
    """Type and text of each parameter in a docstring, or in those of the classes before it."""
    told: dict[str, tuple[str, str]] = {}
    for each in reversed(inspect.getmro(make)) if isinstance(make, type) else [make]:
        for entry in NumpyDocString(inspect.getdoc(each) or "")["Parameters"]:
            for name in entry.name.split(", "):
                if entry.type or name not in told:
                    told[name] = entry.type, " ".join(line.strip() for line in entry.desc)
    return told


def _default(parameter: inspect.Parameter) -> str:
    value = parameter.default
    if value is inspect.Parameter.empty:
        return "required"
    if isinstance(value, list | tuple | str | bool | int | float) and not dataclasses.is_dataclass(value):
        return "" if value == () else json.dumps(value)
    return ""


def _epoch(stem: str, text: str) -> dict[str, tuple[str, str]]:
    return {name: (kind, text) for name, kind in zip(
        with_scales(stem), ("text, TDB", "text, UTC", "float [s], TDB past J2000"), strict=True)}


_FILE = {"file": ("text", "Name of the file, relative to this one.")}
_ABOUT = {"about": ("text", "A body, or \"sun\"; the first body by default.")}
_WAY = {"interpolation": ("\"spline\" or \"linear\"", "Between the rows; spline by default.")}
_OBJECT = {"object_name": ("text", "Which object of the file, where it has several.")}
_NUMBER = "float, [from, to], or a table with one of uniform, log_uniform, solid_angle, normal"
_MOTION = ("trajectory", "start", "duration_s")

SCENE: tuple[Table, ...] = (
    Table("the file", (Scene,), more={
        "bodies": ("list of tables", "One at least; below."), "cameras": ("list of tables", "One at least; below."),
        "stars": ("table", "The sky behind the bodies, of frames with a detector; below."),
        "lamps": ("list of tables", "On the spacecraft; below."),
        "emission": ("list of tables", "Light that no surface scatters, as of a [coma](../coma.md)."),
        "max_error": ("float [1], 0..1, or table", "RMS error over the mean lit pixel; or by unit, or `sigmas`.")}),
    Table("bodies", (Body,), ("albedo_map",), {
        "shape": ("text", "A shape file; or `generated`, or `terrain`. Relative to this file."),
        "generated": ("table", "A made-up shape; below."),
        "terrain": ("table", "Ground of a map; below."),
        "length_unit": ("\"m\", \"km\" or float", "Of the shape file; metres per unit when a number. DSKs have one."),
        "surface": ("int", "SPICE's number of the surface, of a DSK with several."),
        "inside": ("bool", "Closed shells stay as the file has them: a camera may be in those that face inward."),
        "sides": ("\"file\", \"front\" or \"both\"", "Of open shells, as panels; \"file\" by default."),
        "brdf": ("table", "The reflectance law; below. Left out where a shape file has materials."),
        "materials": ("table", "Laws, as of brdf, by the names of the file's materials, in place of the file's."),
        "albedo_texture": ("text", "An image whose grey value over its full scale scales the law's albedo."),
        "albedo_texture_gain": ("float [1], > 0", "Factor on the texture; 1 by default."),
        "albedo_projection": ("table", "Of a texture of longitudes and latitudes: kind = \"equirectangular\", "
                              "left_edge_deg (-180 by default)."),
        "detail": ("table", "Made-up ground finer than the facets; below."),
        "regions": ("list of tables", "Finer shapes of parts, in place of what lies beneath; below.")}, ("shape",)),
    Table("bodies.regions", (Region,), more={
        **{name: ("as of bodies", "The region's.") for name in (
            "shape", "generated", "terrain", "length_unit", "surface", "inside", "sides")},
        "brdf": ("table", "Its own law, as of bodies; the body's by default.")}, optional=("shape",)),
    *(Table(f"bodies.generated, kind = \"{kind}\"", (getattr(generate, kind),)) for kind in (
        "icosphere", "contact_binary", "gaussian_random_sphere", "three_lobes")),
    Table("bodies.terrain", (patch,), ("path",), {
        "heights": ("text", "GeoTIFF with one band of heights [m] above its datum."),
        "orthophoto": ("text", "GeoTIFF whose grey value over its full scale scales the law's albedo.")}),
    *(Table(f"bodies.brdf, law = \"{name}\"", (law,)) for name, law in sorted(laws().items())
      if law.__module__.startswith("glrender.")),
    Table("bodies.brdf, preset", more={"preset": (
        "text", f"A published set: {', '.join(sorted(LAW_PRESETS))}.")}),
    Table("bodies.detail", (Detail,), more={name: ("table", f"{text}; below.") for name, text in (
        ("noise", "Fractal roughness"), ("craters", "Bowls with a rim"), ("boulders", "Rounded rocks"))}),
    Table("bodies.detail.noise", (Noise,)),
    Table("bodies.detail.craters", (Craters,)),
    Table("bodies.detail.boulders", (Boulders,)),
    Table("cameras", (PinholeCamera,), more={
        "model": ("table", "Optics, detector and exposure; without it the camera gives irradiance only; below."),
        "distortion": ("table", "Of the lens; below.")}),
    Table("cameras.model", (CameraModel,), more={
        "preset": ("text", f"One of {', '.join(sorted(CAMERA_PRESETS))}; other fields replace the preset's."),
        "optics": ("table", "Below."), "detector": ("table", "Below."),
        "auto_exposure": ("table", "Rules of the automatic exposure; below.")}),
    Table("cameras.model, with a pattern", (MosaicModel,), more={
        "optics": ("table of tables", "The optics behind each letter of the pattern; below."),
        "detector": ("table", "Below."), "auto_exposure": ("table", "Of the mosaic's pixels together; below.")}),
    Table("cameras.model.optics", (Optics,), more={
        "aberrations": ("table", "Of the pupil; needs `f_number`; below."),
        "stray_light": ("table", "Wide wing and veil, over the whole frame; below.")}),
    Table("cameras.model.optics.aberrations", (Aberrations,)),
    Table("cameras.model.optics.stray_light", (StrayLight,)),
    Table("cameras.model.detector", (Detector,)),
    Table("cameras.model.auto_exposure", (AutoExposure,)),
    Table("cameras.distortion", (BrownConrady,)),
    Table("stars", (Stars,)),
    Table("lamps", (Lamp,)))
"""Tables of a scene file."""

SCENARIO: tuple[Table, ...] = (
    Table("a body of a scenario", more={
        "orbit": ("table", "An orbit about the Sun or a body; below."),
        "trajectory": ("table", "In place of `orbit`; as that of the spacecraft, below."),
        "spin": ("table", "About its pole; below."),
        "attitude": ("table", "In place of `spin`; as that of the spacecraft, below."),
        "keypoints": ("table or text", "Names and places [x, y, z] [m] on the body; or a CSV file's name.")}),
    Table("bodies.orbit, of elements", (kepler.Kepler.from_elements,), ("epoch",), {
        **_epoch("epoch", "Of the elements."), "about": ("text", "\"sun\", or the name of a body."),
        "gravitational_parameter_m3_s2": ("float [m3/s2], > 0", "Of what it is about; the Sun's by default.")}),
    Table("bodies.orbit, of its periapsis", (kepler.Kepler.from_periapsis,), ("periapsis",), {
        **_epoch("periapsis", "When it is at its periapsis."), "about": ("text", "\"sun\", or the name of a body."),
        "gravitational_parameter_m3_s2": ("float [m3/s2], > 0", "Of what it is about; the Sun's by default.")}),
    Table("bodies.orbit, of a state", (kepler.Kepler,), ("epoch",), _epoch("epoch", "Of the state.")),
    Table("bodies.spin", (Spin.about_pole,), ("epoch",), _epoch("epoch", "The scenario's start by default.")),
    Table("encounter", (encounter.Encounter,), ("body_trajectory", "date"), {
        **_epoch("date", "Of the closest approach, in the middle of the duration."),
        "body": ("text", "Name of the body."),
        "frames": ("int, 1..1e7", "As of `time`."), "sampler": ("text", "As of `time`."),
        "slow_motion": ("float [1], > 0..30", "As of `time`.")}),
    Table("trajectory, kind = \"kepler\"", (kepler.Kepler.from_elements,), ("epoch",), {
        **_epoch("epoch", "Of the elements."), "about": ("text", "\"sun\", or the name of a body."),
        "gravitational_parameter_m3_s2": ("float [m3/s2], > 0", "Of what it is about; the Sun's by default.")}),
    Table("trajectory, kind = \"at_rest\"", (paths.AtRest,), more=_ABOUT),
    Table("trajectory, kind = \"hovering\"", (paths.Hovering,), ("body_trajectory",), _ABOUT),
    Table("trajectory, kind = \"circular\"", (paths.circular_orbit,), ("sun_direction", "epoch"), {
        **_ABOUT, **_epoch("epoch", "When the spacecraft is at its northernmost; the start by default.")}),
    Table("trajectory, kind = \"csv\"", more={**_FILE, **_ABOUT}),
    Table("trajectory, kind = \"parquet\"", more={**_FILE, **_ABOUT}),
    *(Table(f"trajectory, kind = \"{kind}\"", more={
        **_FILE, "about": ("text", f"\"sun\", or the name of a body; by default the one of the file's {centre}."),
        **_OBJECT, "center_name": ("text", "What the file calls `about`, if it has another name there.")})
      for kind, centre in (("oem", "CENTER_NAME"), ("horizons", "\"Center body name\""))),
    Table("trajectory, kind = \"spice\"", more={"about": ("text", "A body, \"sun\", or of a body \"spacecraft\".")}),
    Table("trajectory, kind = \"isd\"", more={
        **_ABOUT, "files": ("list of text", "ISDs, one an image.")}),
    *(Table(f"attitude, mode = \"{mode}\"", (Pointing,), ("q_camera_from_spacecraft",), {
        "target": ("text", "A body, or \"sun\"; by default the body that the trajectory is about."),
        **({"up": ("as of target", "\"orbit_normal\" by default.")} if mode == "nadir" else {})})
      for mode in ("target", "nadir")),
    Table("attitude, mode = \"fixed\"", (Fixed,)),
    Table("attitude, mode = \"spin\"", (Spin,), ("epoch",), _epoch("epoch", "The scenario's start by default.")),
    Table("attitude, mode = \"csv\"", more={**_FILE, **_WAY}),
    Table("attitude, mode = \"parquet\"", more={**_FILE, **_WAY}),
    Table("attitude, mode = \"aem\"", more={
        **_FILE, **_OBJECT, "frame": ("text", "The file's frame that is meant, if it is no SC_BODY.")}),
    Table("attitude, mode = \"spice\"", (SpiceAttitude,), ("spice",)),
    Table("attitude, mode = \"rigid_body\"", (dynamics.RigidBody,), ("torques", "impulses"), {
        "gravity_gradient_m3_s2": ("float [m3/s2], > 0", "Gravitational parameter of what the trajectory is about."),
        "gas_drag": ("table", "Below."), "dust_impacts": ("table", "Below."),
        "thrusters": ("list of tables", "Below."), "wheels": ("table", "Below.")}),
    Table("attitude.gas_drag", (torques.GasDrag,), ("trajectory", "start"), {
        "plates": ("list of tables", "In place of the area, those that face the flow count; below."),
        "density_kg_m3": ("float [kg/m3], > 0", "At `reference_distance_m`."),
        "outflow_speed_m_s": ("float [m/s], > 0", "Radial.")}),
    Table("attitude.gas_drag.plates", (torques.Plate,)),
    Table("attitude.dust_impacts", (torques.DustImpacts,), ("trajectory", "start"), {
        "outflow_speed_m_s": ("float [m/s], > 0", "Radial."),
        "duration_s": ("float [s], > 0", "From the start, in which grains come; that of the scenario by default.")}),
    Table("attitude.thrusters", (torques.Thruster,)),
    Table("attitude.wheels", (torques.Wheels,)),
    Table("attitude, in all modes of the spacecraft", more={
        "camera": ("text", "The camera that is pointed; the first by default."),
        "offset_deg": ("(3,) float [deg]", "Turns of the camera about its X, Y and Z, a rotation vector."),
        "jitter": ("table", "Small turns of a given spectrum; below.")}),
    Table("attitude.jitter", (disturbances.Jitter,)),
    Table("time", (samplers.FixedRate, samplers.Exponential, samplers.Times), more={
        **_epoch("start", "Of the scenario; not beside [encounter]."),
        **{name: (f"list of {kind}", text) for name, (kind, text) in _epoch(
            "epochs", "The frames' epochs, in place of a duration.").items()},
        "frames": ("int, 1..1e7", "Spread over the duration by the sampler."),
        "sampler": ("\"linear\", \"exponential\" or \"equal_turns\"", "How they are spread; linear by default.")},
        optional=("duration_s", "rate_hz", "times_s")),
    Table("sun", (paths.AtRest,), more=_ABOUT),
    Table("spice", (Spice,)),
    Table("random", (random_states.RandomStates,), ("setting",), {
        "camera": ("text", "Of the scene; the first by default."), "body": ("text", "The first by default."),
        "range_m": (_NUMBER, "From the body's origin to the spacecraft [m]."),
        "phase_angle_deg": (_NUMBER, "Sun, body, spacecraft; 0 to 120 by default."),
        "off_pointing_deg": (_NUMBER, "Angle between boresight and body, in any direction; 0 by default."),
        "roll_deg": (_NUMBER, "About the boresight; any by default."),
        "sun_distance_au": (_NUMBER, "Of the body; 1 by default."),
        "time_s": (_NUMBER, "Of bodies that move; one turn of a body that spins by default.")}),
    Table("output", (FrameOptions,), ("has_labels", "keypoints", "limb_points", "backend"), {
        "camera": ("text", "The first by default."),
        "labels": ("true or false", "Whether frames have labels; false by default.")}),
    Table("cameras, of an instrument kernel", (camera_of_kernel,), ("spice",), {
        "principal_point_px": ("(2,) float [px]", "In place of the kernel's.")}),
    Table("cameras, of an ISD", more={
        "isd": ("text", "The JSON file."), "lens": ("table", "`model` and `coefficients` in place of the file's."),
        "name": ("text", "That of the image by default."), "model": ("table", "As of a scene's camera.")}))
"""Tables that a scenario file may have besides."""


def page() -> str:
    """The whole page."""
    return _HEAD + markdown().rstrip("\n") + "\n"


def markdown() -> str:
    """The page's tables, in Markdown."""
    out: list[str] = []
    for title, tables in (("Scene files", SCENE), ("Scenario files", SCENARIO)):
        out += [f"## {title}", ""]
        for each in tables:
            out += [f"### {each.name}", "", "| field | type | default | meaning |", "|---|---|---|---|"]
            out += [f"| `{name}` | {_cell(entry.type)} | {_code(entry.default)} | "
                    f"{_cell(entry.text)} |" for name, entry in each.fields().items()]
            if not each.fields():
                out.pop()
                out[-1] = "It has no fields."
            out += [""]
    return "\n".join(out)


def _code(default: str) -> str:
    return f"`{default}`" if default not in ("", "required") else default


def _cell(text: Any) -> str:
    return str(text).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
