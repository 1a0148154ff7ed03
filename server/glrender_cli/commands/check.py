"""`glrender check`: describes a shape, a scene or a scenario, and warns of oddities before a loop is flown."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from glrender import Body, ConfigError, GlrenderError, PinholeCamera
from glrender.base.errors import error_path
from glrender.capture.outputs import has_exposure
from glrender.engines.advice import scene_advice
from glrender.scenario import RandomStates, Scenario
from glrender.scenario.files.keypoint_fields import off_surface
from glrender.sequences.options import options_of
from glrender.view.view import view_bodies
from glrender_camera.validate import integer

from ..drawing import Drawn, add_drawing, draw, in_words, summary
from ..picture import add_picture, check_picture, check_place, write_picture
from ..rehearsal import rehearse
from ..subject import add_subject, read_subject
from ..waited import waited_s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender check`."""
    add_subject(parser)
    parser.add_argument("given", nargs="?", type=Path, metavar="STATE", help="the same as --state STATE")
    add_drawing(parser)
    add_picture(parser, "")
    parser.add_argument("--try", dest="n_tried", type=int, default=12, metavar="N",
                        help="of a scenario: frames that are drawn across its ranges, and not kept (12); 0: none")
    parser.add_argument("--plot", type=Path, metavar="FILE.png",
                        help="of a scenario: draw its range, phase, Sun, field of view and path there")


def run(arguments: argparse.Namespace) -> int:
    """Describe bodies and cameras; then a scenario's sequence, or else one frame, which is drawn."""
    if arguments.given is not None:
        if arguments.state is not None:
            raise ConfigError("--state", "is given twice", str(arguments.state), "leave one out")
        arguments.state = arguments.given
    if arguments.out is not None:
        check_picture(arguments, "DN" if has_exposure(arguments.output) else "W/m2")
    if arguments.plot is not None:
        check_place("--plot", arguments.plot)
    subject = read_subject(arguments.subject, arguments.unit)
    for line in (*map(_of_body, subject.scene.bodies), *map(_of_camera, subject.scene.cameras)):
        sys.stdout.write(line + "\n")
    is_one_frame = (arguments.state, arguments.at, arguments.phase_deg, arguments.out) != (None,) * 4
    is_sequence = subject.scenario is not None and not is_one_frame
    if arguments.plot is not None and not is_sequence:
        raise ConfigError("--plot", "is of a scenario's sequence, not of one frame", str(arguments.plot),
                          "give a scenario file alone")
    if arguments.plot is not None and isinstance(subject.scenario, RandomStates):
        raise ConfigError("--plot", "is of a trajectory; random states have none", str(arguments.plot), "leave it out")
    if is_sequence:
        _check_sequence(subject.scenario)
        if arguments.n_tried:
            sys.stdout.flush()
            rehearse(subject.scenario, integer("--try", arguments.n_tried, 0, 1000), arguments.backend)
        if arguments.plot is not None:
            _plot(subject.scenario, arguments)
        return 0
    sys.stdout.flush()
    drawn = draw(arguments)
    for line in _of_view(drawn):
        sys.stdout.write(line + "\n")
    sys.stdout.write(f"frame: {in_words(summary(drawn))}, {waited_s():.1f} s with start-up\n")
    if arguments.out is not None:
        write_picture(arguments.out, drawn.capture.irradiance_W_m2, arguments.stretch, arguments.white)
        sys.stdout.write(f"picture: {arguments.out}\n")
    return 0


def _plot(scenario: Scenario, arguments: argparse.Namespace) -> None:
    try:
        from ..scenario_plots import scenario_plot
    except ImportError as error:
        raise GlrenderError("`check --plot` draws by matplotlib: pip install 'glrender[demo]'") from error
    camera = scenario.scene.camera(arguments.camera or scenario.scene.cameras[0].name)
    try:
        scenario_plot(arguments.plot, arguments.subject.name, scenario.scene, scenario.states(), camera)
    except ValueError as error:
        raise ConfigError("--plot", f"cannot be written: {error}", str(arguments.plot)) from None
    sys.stdout.write(f"plot: {arguments.plot}\n")


def _check_sequence(scenario: Scenario | RandomStates) -> None:
    with error_path("output"):
        output = options_of(scenario.scene, scenario.output).text
    belief = (scenario.setting if isinstance(scenario, RandomStates) else scenario).belief
    with error_path("belief"):
        belief.scene(scenario.scene)
    sys.stdout.writelines(f"belief of {line}\n" for line in belief.told(scenario.scene))
    for warning in (*scene_advice(scenario.scene), *scenario.check(), *off_surface(scenario.scene, scenario.keypoints)):
        sys.stderr.write(f"glrender: warning: {warning}\n")
    if isinstance(scenario, RandomStates):
        sys.stdout.writelines(f"random: {name} {value}\n" for name, value in scenario.told().items())
        return
    t_s = scenario.t_s
    sys.stdout.write(f"sequence: {len(t_s)} states over {t_s[-1] - t_s[0]:g} s"
                     f"{'' if scenario.start is None else f' from {scenario.start.tdb} TDB'}\n"
                     f"output: {output}\n")


def _of_body(body: Body) -> str:
    report = body.shape.report
    size = " x ".join(f"{extent:.4g}" for extent in sorted(report.extent_m, reverse=True))
    mended = [f"{count} {what}" for count, what in (
        (report.n_welded, "vertices welded"), (report.n_unused, "unused vertices left out"),
        (report.n_degenerate + report.n_duplicate, "facets without area or twice left out"),
        (report.n_flipped, "facets turned outward")) if count]
    mended += [f"a region of {seam.n_facets} facets whose rim is {seam.gap_rms_m:.3g} m RMS, at most "
               f"{seam.gap_max_m:.3g} m, off the shape" for seam in report.seams]
    closed = "closed" if report.is_watertight else \
        f"{report.n_open_edges} open and {report.n_non_manifold_edges} shared edges"
    return (f"body {body.name}: {report.n_facets} facets, {closed}, {size} m, {report.volume_m3:.4g} m3, "
            f"{', '.join((*dict.fromkeys(type(law).__name__ for law in body.laws), *mended))}")


def _of_camera(camera: PinholeCamera) -> str:
    field = " x ".join(f"{np.degrees(2.0 * np.arctan(0.5 * side / camera.focal_length_px)):.3g}"
                       for side in (camera.width_px, camera.height_px))
    compression = None if camera.model is None else camera.model.compression
    return (f"camera {camera.name}: {camera.width_px} x {camera.height_px} px, {field} deg, "
            f"{1e6 / camera.focal_length_px:.4g} urad a pixel, {'no ' if camera.model is None else ''}detector"
            + ("" if compression is None else f", {compression.codec}"))


def _of_view(drawn: Drawn) -> list[str]:
    lines = []
    for view in view_bodies(drawn.state, drawn.camera, drawn.scene.hulls):
        seen = f"{view.size_px:.0f} px across" if view.is_visible else "not in the field"
        lines.append(f"seen: {view.name} from {view.range_m:.4g} m, phase {np.degrees(view.phase_rad):.1f} deg, {seen}")
    return lines
