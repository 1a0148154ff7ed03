"""Scenes of the chart: one body or two, from 20 px to more than the frame, from high noon to a crescent."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from glrender import Body, PinholeCamera, Pose, Scene, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Hapke, Lambert

_ROOT = Path(__file__).parents[2]
_PLACES = (_ROOT / "tests" / "data", Path(os.environ.get("GLRENDER_SHARED") or _ROOT.parent / "shared") / "data")
_RELIEF_LEVELS = {"197k": 1, "786k": 2, "3146k": 3}
_FILES = {"didymos": "didymos/didymos_49k.obj", "dimorphos": "didymos/dimorphos_49k.ply",
          "itokawa": "itokawa/itokawa_64q_49152_uv.obj"}
HAPKE = Hapke(single_scattering_albedo=0.42, b=0.35, c=1.0, shoe_amplitude=0.87, shoe_width=0.05, roughness_deg=26.0)
_DIRECTION = np.array([0.2, -0.95, 0.25]) / np.linalg.norm([0.2, -0.95, 0.25])


@dataclass(frozen=True, kw_only=True)
class Case:
    """One scene of the chart.

    Attributes
    ----------
    name : str
    facets : str
        "49k" is Itokawa; larger ones are it with seeded relief.
    frame_px : int
        Side of the image.
    body_px : float
        Twice the body's radius in the image.
    phase_deg : float
    is_pair : bool
        Didymos and Dimorphos instead, 49k facets each.
    is_default : bool
        Hapke's law and the Sun's disc, as scenes have it, which no peer draws.
    """

    name: str
    facets: str
    frame_px: int
    body_px: float
    phase_deg: float
    is_pair: bool = False
    is_default: bool = False


CASES = (
    Case(name="far 20 px, 49k", facets="49k", frame_px=512, body_px=20.0, phase_deg=60.0),
    Case(name="far 20 px, 3.1M", facets="3146k", frame_px=512, body_px=20.0, phase_deg=60.0),
    Case(name="middle 245 px, 49k", facets="49k", frame_px=512, body_px=245.0, phase_deg=60.0),
    Case(name="middle 500 px, 49k", facets="49k", frame_px=1024, body_px=500.0, phase_deg=60.0),
    Case(name="middle 500 px, 786k", facets="786k", frame_px=1024, body_px=500.0, phase_deg=60.0),
    Case(name="middle 500 px, 3.1M", facets="3146k", frame_px=1024, body_px=500.0, phase_deg=60.0),
    Case(name="close, 49k", facets="49k", frame_px=512, body_px=2000.0, phase_deg=60.0),
    Case(name="close, 786k", facets="786k", frame_px=512, body_px=2000.0, phase_deg=60.0),
    Case(name="grazing 120 deg, 49k", facets="49k", frame_px=1024, body_px=500.0, phase_deg=120.0),
    Case(name="grazing 120 deg, 786k", facets="786k", frame_px=1024, body_px=500.0, phase_deg=120.0),
    Case(name="crescent 150 deg, 49k", facets="49k", frame_px=1024, body_px=500.0, phase_deg=150.0),
    Case(name="two bodies, 2 x 49k", facets="49k", frame_px=1024, body_px=500.0, phase_deg=60.0, is_pair=True),
    Case(name="Hapke, Sun's disc, 49k", facets="49k", frame_px=1024, body_px=500.0, phase_deg=60.0, is_default=True),
)
QUICK = ("far 20 px, 49k", "middle 245 px, 49k", "grazing 120 deg, 49k", "two bodies, 2 x 49k")


def data_file(name: str) -> Path:
    """A file of tests/data or, where it is not there, of ../shared/data."""
    return next((place / name for place in _PLACES if (place / name).is_file()), _PLACES[-1] / name)


@cache
def shape(facets: str) -> Shape:
    """The body of the case at a number of facets."""
    if facets != "49k":
        return generate.subdivide_with_relief(shape("49k"), levels=_RELIEF_LEVELS[facets], seed=1)
    return Shape.from_file(data_file(_FILES["itokawa"]), length_unit="km")


def build(case: Case) -> tuple[Scene, State]:
    """Scene and state of a case, at the range of 20 radii or, close up, 3 radii."""
    bodies, places = _pair() if case.is_pair else (
        [Body(name="body", shape=shape(case.facets), brdf=HAPKE if case.is_default else Lambert(normal_albedo=0.3))],
        {"body": np.zeros(3)})
    radius = bodies[0].shape.radius_m
    range_m = (3.0 if case.body_px > 2.0 * case.frame_px else 20.0) * radius
    camera = PinholeCamera(name="navcam", width_px=case.frame_px, height_px=case.frame_px,
                           focal_length_px=case.body_px * range_m / (2.0 * radius))
    q = frames.look_at(range_m * _DIRECTION, np.zeros(3))
    phase, right = np.radians(case.phase_deg), frames.dcm(q)[0]
    # Off the image's axes: no edge of a shadow runs along the rows.
    aside = np.cos(0.3) * right + np.sin(0.3) * frames.dcm(q)[1]
    state = State(r_sun_inertial_m=AU_M * (np.cos(phase) * _DIRECTION + np.sin(phase) * aside),
                  spacecraft=Pose(r_inertial_m=range_m * _DIRECTION, q_from_inertial=q),
                  bodies={name: Pose(r_inertial_m=place) for name, place in places.items()})
    # A point Sun otherwise, as the peers have it.
    return Scene(bodies=bodies, cameras=[camera], sun_disc=case.is_default), state


def _pair() -> tuple[list[Body], dict[str, np.ndarray]]:
    """Didymos, and Dimorphos sunward and to the side, so that its shadow falls on Didymos' limb."""
    law = Lambert(normal_albedo=0.3)
    bodies = [Body.from_file(data_file(_FILES[name]), name=name, length_unit="km", brdf=law)
              for name in ("didymos", "dimorphos")]
    q = frames.look_at(_DIRECTION, np.zeros(3))
    right, down = frames.dcm(q)[:2]
    radius = bodies[0].shape.radius_m
    return bodies, {"didymos": np.zeros(3), "dimorphos": radius * (0.9 * right + 0.25 * down + 0.75 * _DIRECTION)}
