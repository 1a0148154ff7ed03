"""Outputs of a frame, and what each needs of its camera."""

from __future__ import annotations

from glrender_camera import PinholeCamera
from glrender_camera.validate import one_of

from ..base.errors import ConfigError
from ..base.names import OUTPUTS


def checked_output(output: object, camera: PinholeCamera) -> str:
    """An output that a camera has.

    Raises
    ------
    ConfigError
        No such output, digital numbers of a camera without a detector, a stream of one without compression.
    """
    name = one_of("output", output, OUTPUTS)
    if name != "irradiance" and camera.model is None:
        raise ConfigError("output", f"camera {camera.name!r} has no optics and detector", output,
                          "give it a `model` in the scene, or ask for 'irradiance'")
    if name == "compressed" and camera.model.compression is None:
        raise ConfigError("output", f"camera {camera.name!r} has no compression", output,
                          'give its model `compression = { codec = "jpeg_ls" }`, or ask for \'dn\'')
    return name


def has_exposure(output: str) -> bool:
    """Whether an output is of a detector's frame, with its exposure, noise and faults."""
    return output != "irradiance"
