"""One frame that a command draws, with its warnings and description."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender import ConfigError, Scene, State, open_renderer
from glrender.base.names import OUTPUTS
from glrender.capture.capture import Capture
from glrender.capture.outputs import checked_output, has_exposure
from glrender.engines.advice import Advice, scene_advice
from glrender.scenario import RandomStates
from glrender.sequences.sequence import FrameOptions, captured
from glrender_camera import PinholeCamera

from .subject import Subject, is_number, read_subject, state_of
from .tolerance import read_max_error


def add_drawing(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say how a frame is drawn."""
    parser.add_argument("--max-error", metavar="SHARE",
                        help="error tolerance, 0.02 for 2 %%, or by unit: centroid_px=0.05,flux=0.001; the scene's")
    parser.add_argument("--samples", type=int, metavar="N", help="along a pixel's side, by OpenGL; default: planned")
    parser.add_argument("--output", default="irradiance", choices=OUTPUTS,
                        help="irradiance, the digital numbers of the camera's detector, or the stream that it sends")
    parser.add_argument("--exposure-s", metavar="S", help="of dn and compressed: seconds, or auto; the camera's")
    parser.add_argument("--seed", type=int, default=0, help="of the noise of dn and compressed (0)")
    parser.add_argument("--backend", default="auto", help="auto, egl, osmesa, or a plug-in such as raytrace or cycles")


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A frame that was drawn, and what it is of."""

    scene: Scene
    camera: PinholeCamera
    state: State
    options: FrameOptions
    capture: Capture
    doubts: tuple[Advice, ...] = ()

    @property
    def warnings(self) -> list[str]:
        """Oddities of the scenario, of the scene and of the frame, each once."""
        # A field of the scenario is named by its own path, not by the state's that follows from it.
        codes = {advice.code for advice in self.doubts}
        of_frame = [advice for advice in self.capture.warnings
                    if advice.code not in codes or not advice.path.startswith("state.")]
        return [*dict.fromkeys(str(advice) for advice in (*self.doubts, *scene_advice(self.scene), *of_frame))]


def draw(arguments: argparse.Namespace, check: Callable[[PinholeCamera], None] = lambda camera: None) -> Drawn:
    """Draw the frame that the arguments of `add_subject` and `add_drawing` ask for; its warnings go to stderr.

    `check` may refuse the camera before anything is drawn.

    Raises
    ------
    GlrenderError
    """
    exposure_s = arguments.exposure_s
    if exposure_s not in (None, "auto"):
        if not is_number(exposure_s):
            raise ConfigError("--exposure-s", "must be a number of seconds, or auto", exposure_s)
        exposure_s = float(exposure_s)
    if exposure_s is not None and not has_exposure(arguments.output):
        raise ConfigError("--exposure-s", "is of digital numbers alone", arguments.exposure_s, "add --output dn")
    subject = read_subject(arguments.subject, arguments.unit)
    scene = subject.scene
    camera = scene.camera(arguments.camera) if arguments.camera else scene.cameras[0]
    checked_output(arguments.output, camera)
    check(camera)
    state = state_of(subject, arguments, camera)
    options = FrameOptions(camera=camera.name, output=arguments.output, seed=arguments.seed, exposure_s=exposure_s,
                           products=tuple(getattr(arguments, "products", ())),
                           max_error=read_max_error(arguments.max_error))
    with open_renderer(scene, arguments.backend) as renderer:
        capture = captured(renderer, 0, state, options, samples=arguments.samples, seed=arguments.seed)
    drawn = Drawn(scene=scene, camera=camera, state=state, options=options, capture=capture,
                  doubts=_doubts(subject))
    for warning in drawn.warnings:
        sys.stderr.write(f"glrender: warning: {warning}\n")
    for note in capture.notes:
        sys.stderr.write(f"glrender: note: {note}\n")
    for stage, text in capture.stages.items():
        logging.getLogger(__name__).info("%s: %s", stage, text)
    return drawn


def _doubts(subject: Subject) -> tuple[Advice, ...]:
    """Warnings of the fields of a subject's scenario."""
    scenario = subject.scenario
    if scenario is None:
        return ()
    return (scenario.setting if isinstance(scenario, RandomStates) else scenario).doubts


def summary(drawn: Drawn) -> dict[str, Any]:
    """Plain data of a frame: size, unit, least and greatest pixel, exposure, share at full well, errors, warnings."""
    capture, frame = drawn.capture, drawn.capture.frame
    pixels = capture.irradiance_W_m2 if frame is None else frame.dn
    said = {"width_px": drawn.camera.width_px, "height_px": drawn.camera.height_px, "unit": drawn.options.unit,
            "min": pixels.min().item(), "max": pixels.max().item()}
    if frame is not None:
        said |= {"exposure_s": float(frame.exposure_s), "saturated_share": float(np.mean(frame.saturated))}
        if frame.stream is not None:
            said |= {"compression": frame.stages["compression"], "compressed_bytes": frame.compressed_bytes,
                     "bits_per_pixel": frame.bits_per_pixel}
    return said | {"predicted_error": float(capture.plan.predicted_error), "max_error": float(capture.plan.max_error),
                   "asked": dict(capture.plan.asked), "predicted": capture.plan.predicted,
                   "warnings": drawn.warnings}


def in_words(said: dict[str, Any]) -> str:
    """One line of a `summary`."""
    parts = [f"{said['width_px']} x {said['height_px']}", f"{said['min']:.3g} to {said['max']:.3g} {said['unit']}"]
    if "exposure_s" in said:
        parts += [f"exposure {said['exposure_s']:.3g} s", f"{100.0 * said['saturated_share']:.2g} % saturated"]
    if "compression" in said:
        parts.append(said["compression"])
    parts += [f"predicted {'error' if unit == 'rms' else unit} {said['predicted'][unit]:.2g} of {most:.3g} allowed"
              for unit, most in said["asked"].items()]
    return ", ".join(parts)
