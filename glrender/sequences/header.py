"""The header of a frame: all that a reader must know without the scenario, the same in every format and data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from glrender_camera import MosaicModel, PinholeCamera

from ..base.errors import ConfigError
from ..capture.capture import Capture
from ..scene.scene import Scene
from ..view.state import State
from .options import FrameOptions
from .surface_maps import UNITS

VERSION = version("glrender")


def same_version(asked: str) -> None:
    """Refuse to draw elsewhere by another version of glrender than the one that asks."""
    if asked != VERSION:
        raise ConfigError("--dask", f"a worker has glrender {VERSION}, not {asked}", hint="install the same")


FIELDS: Mapping[str, str] = {
    "glrender": "version of the program",
    "index": "number of the frame in its sequence, from 0",
    "date_tdb": "calendar date of mid-exposure in TDB; null where the states have none",
    "inertial_axes": "ICRF where the state has a date or the scene has stars; else unknown",
    "state": "t_s [s] of mid-exposure, positions [m] and attitudes [w, x, y, z] of Sun, spacecraft and bodies",
    "bodies": "names in the order of body_id and mask",
    "unit": "of the pixels: W/m2 (of each pixel's solid angle) or DN",
    "units": "of all products; 1 of numbers and shares",
    "exposure_s": "exposure [s]; null of irradiance",
    "seed": "of the noise, of this frame alone: take_frame with it gives these digital numbers; null of irradiance",
    "faults": "kind and place of each fault that the frame has",
    "camera.name": "name",
    "camera.width_px": "columns",
    "camera.height_px": "rows",
    "camera.focal_length_px": "focal length [px]",
    "camera.principal_point_px": "x, y of the boresight; (0, 0) is the centre of the top-left pixel",
    "camera.distortion": "coefficients k1 to k6, p1, p2 of OpenCV's model; null without",
    "camera.r_camera_spacecraft_m": "place on the spacecraft [m]",
    "camera.q_camera_from_spacecraft": "mounting [w, x, y, z]",
    "camera.detector": "gain_DN_per_electron, offset_DN, bit_depth, full_well_electrons, read_noise_electrons and the "
                       "other fields of the detector, curves as pairs (quantum_efficiency [nm, 1], "
                       "nonlinearity_DN [ideal DN, actual DN], null where linear); null without",
    "camera.compression": "codec of the frames that are sent, of which the pixels are decoded, and the key by which it "
                          "loses what it loses; null without",
    "camera.mosaic": "rows of letters, repeated from the top-left pixel on; null without",
    "camera.band_nm": "wavelengths [nm] of the band, or of each letter's; null of a camera without optics",
    "camera.aperture_diameter_m": "diameter of the aperture [m], or of each letter's; null without",
    "plan": "tolerances that were asked for (asked), errors (predicted), max_error and predicted_error as RMS",
    "warnings": "sentences, and their codes in warning_codes",
}
"""The fields of every header, with their meaning; a dot leads into a table. `labels` is one more where asked for."""


def frame_header(scene: Scene, index: int, state: State, options: FrameOptions, capture: Capture) -> dict[str, Any]:
    """The header of a frame of `captured`, as plain data with the fields of `FIELDS`.

    Parameters
    ----------
    scene : Scene
    index : int
    state : State
    options : FrameOptions
    capture : Capture
    """
    frame = capture.frame
    is_icrf = state.date_tdb is not None or scene.stars is not None
    return {
        "glrender": VERSION, "index": index, "date_tdb": state.date_tdb,
        "inertial_axes": "ICRF" if is_icrf else "unknown", "state": state.to_dict(),
        "bodies": [body.name for body in scene.bodies], "unit": options.unit,
        "units": dict(UNITS),
        "exposure_s": None if frame is None else frame.exposure_s, "seed": None if frame is None else frame.seed,
        "faults": [] if frame is None else list(frame.faults), "camera": camera_table(scene.camera(options.camera)),
        "plan": {"max_error": capture.plan.max_error, "predicted_error": capture.plan.predicted_error,
                 "asked": dict(capture.plan.asked), "predicted": capture.plan.predicted},
        "warnings": [str(advice) for advice in capture.warnings],
        "warning_codes": [advice.code for advice in capture.warnings]}


def camera_table(camera: PinholeCamera) -> dict[str, Any]:
    """The camera's part of a header, as plain data."""
    model, lens = camera.model, camera.distortion
    of_bands = {} if model is None else {letter: band.optics for letter, band in model.bands.items()}
    return {
        "name": camera.name, "width_px": camera.width_px, "height_px": camera.height_px,
        "focal_length_px": camera.focal_length_px, "principal_point_px": list(camera.principal_point_px),
        "distortion": None if lens is None else asdict(lens),
        "r_camera_spacecraft_m": camera.r_camera_spacecraft_m.tolist(),
        "q_camera_from_spacecraft": camera.q_camera_from_spacecraft.tolist(),
        "detector": None if model is None else {name: _plain(value) for name, value in asdict(model.detector).items()},
        "compression": None if model is None or model.compression is None else model.compression.to_dict(),
        "mosaic": list(model.pattern) if isinstance(model, MosaicModel) else None,
        "band_nm": _of_letters({letter: list(optics.band_nm) for letter, optics in of_bands.items()}),
        "aperture_diameter_m": _of_letters({letter: optics.aperture_diameter_m
                                            for letter, optics in of_bands.items()})}


def decoding_of(camera: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `glrender_camera.compression.decode` but for the stream, by a camera's part of a header."""
    return {"codec": camera["compression"]["codec"], "shape": [camera["height_px"], camera["width_px"]],
            "bit_depth": camera["detector"]["bit_depth"]}


def offset_DN(camera: PinholeCamera) -> float | None:
    """The digital number [DN] of a pixel without light or dark signal; None of a camera without a detector."""
    return None if camera.model is None else camera.model.detector.offset_DN


def _plain(value: Any) -> Any:
    """A number, or the pairs of a curve as lists."""
    return [list(pair) for pair in value] if isinstance(value, tuple) else value


def _of_letters(values: Mapping[str, Any]) -> Any:
    """The value of a camera's only band, a table of a mosaic's letters, or None."""
    return (values[""] if "" in values else dict(values)) if values else None
