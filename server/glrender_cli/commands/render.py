"""`glrender render`: one frame of a scene, a scenario or a shape file."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path

from glrender import ConfigError
from glrender.capture.outputs import has_exposure
from glrender.engines.image import checked_products
from glrender.sequences.formats import write_stream
from glrender.sequences.sequence import frame_file
from glrender.sequences.surface_maps import UNITS, refuse_flow

from ..drawing import add_drawing, draw, in_words, summary
from ..picture import WITHOUT_PRODUCTS, add_picture, check_codec, check_picture, check_stream, write_frame
from ..subject import add_subject
from ..waited import waited_s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender render`."""
    add_subject(parser)
    add_drawing(parser)
    add_picture(parser, "frame.png; of compressed frame.CODEC, and a header frame.CODEC.json")
    parser.add_argument("--products", nargs="+", default=[], metavar="NAME",
                        help="in the file besides: range, body_id, incidence, ...")
    parser.add_argument("--json", action="store_true", help="what was drawn, as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Draw a frame, write it, and say in one line what it is."""
    is_stream = arguments.output == "compressed"
    if is_stream:
        check_stream(arguments)
    else:
        arguments.out = arguments.out or Path("frame.png")
        check_picture(arguments, "DN" if has_exposure(arguments.output) else "W/m2")
    checked_products(arguments.products, tuple(UNITS))
    refuse_flow(arguments.products)
    if arguments.products and not is_stream and arguments.out.suffix.lower() in WITHOUT_PRODUCTS:
        raise ConfigError("--products", "need a file that holds them", str(arguments.out), "--out frame.fits")
    drawn = draw(arguments, partial(check_codec, arguments.out)) if is_stream else draw(arguments)
    file = frame_file(drawn.scene, 0, drawn.state, drawn.options, drawn.capture)
    if is_stream:
        arguments.out = arguments.out or Path(f"frame.{file.header['camera']['compression']['codec']}")
        write_stream(arguments.out, file)
    else:
        write_frame(arguments, file)
    said = {"file": str(arguments.out), **summary(drawn), "waited_s": round(waited_s(), 2)}
    sys.stdout.write(json.dumps(said) + "\n" if arguments.json else
                     f"{arguments.out}: {in_words(said)}, {said['waited_s']:.1f} s with start-up\n")
    return 0
