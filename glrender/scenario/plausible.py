"""Finds improbable or impossible values in the fields of trajectories and attitudes, most often for their unit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.constants import GM_SUN_M3_S2, SUN_RADIUS_M
from ..base.errors import ConfigError
from ..base.plausible import Advice, doubt, improbable, kind_of_body
from ..scene.body import Body
from ..view.plausible import overlap_doubt, overlaps, sun_way_out
from ..view.state import State

SUN, SPACECRAFT = "sun", "spacecraft"
DENSITIES_KG_M3 = (50.0, 3e4)
"""Likely densities of bodies [kg/m3]: comets and small moons have some 300 to 500, iron has 7900; with the error that a
rough shape's volume may have."""
GRAVITATION_M3_KG_S2 = 6.6743e-11
"""Constant of gravitation [m3/(kg s2)]; CODATA 2018."""
# Fields that give a distance from the centre of what a trajectory is about.
_PLACES = ("distance_m", "radius_m", "r_m", "r_hill_m", "semi_major_axis_m", "periapsis_distance_m")
# Those that are sizes of orbits: an impact or a hop is an orbit that leads into the body.
_SIZES = ("semi_major_axis_m", "periapsis_distance_m")


@dataclass(frozen=True, kw_only=True)
class Written:
    """A trajectory or an attitude where it is written.

    Parameters
    ----------
    path : str
        Path of the table in its file, or of the object in its scenario.
    thing : mapping or object
        The table, or the object, whose fields are looked at.
    of : str
        "spacecraft", "sun" or the body whose it is.
    about : str, optional
        Name of the object that a trajectory is about.
    """

    path: str
    thing: Any
    of: str
    about: str | None = None

    def get(self, field: str) -> Any:
        """The value of a field; None where there is none."""
        return self.thing.get(field) if isinstance(self.thing, Mapping) else getattr(self.thing, field, None)


def written_objects(trajectories: Mapping[str, Any], attitudes: Mapping[str, Any]) -> list[Written]:
    """Trajectories and attitudes as a scenario's objects have them."""
    places = [Written(path=f"trajectories.{name}", thing=path, of=name, about=path.about)
              for name, path in trajectories.items()]
    # A disturbed attitude has another one within it.
    return places + [Written(path=f"attitudes.{name}", thing=getattr(attitude, "attitude", attitude), of=name)
                     for name, attitude in attitudes.items()]


def written_tables(own: Mapping[str, Any], entries: Sequence[Mapping[str, Any]]) -> list[Written]:
    """Trajectories and attitudes as a scenario file has them, after it was read.

    Parameters
    ----------
    own : mapping
        The file's tables that no scene has, as [encounter] and [attitude].
    entries : sequence of mapping
        Its `bodies`.
    """
    found = []

    def place(path: str, table: Mapping[str, Any], of: str) -> None:
        # As the readers have it: elements are about the Sun, what else is given about the first body.
        about = SUN if path.endswith("orbit") or table.get("kind") == "kepler" else entries[0]["name"]
        found.append(Written(path=path, thing=table, of=of, about=table.get("body", table.get("about", about))))

    for key, of in (("encounter", SPACECRAFT), ("trajectory", SPACECRAFT), ("sun", SUN)):
        if key in own:
            place(key, own[key], of)
    for index, entry in enumerate(entries):
        for key in ("orbit", "trajectory"):
            if key in entry:
                place(f"bodies[{index}].{key}", entry[key], entry["name"])
        found += [Written(path=f"bodies[{index}].{key}", thing=entry[key], of=entry["name"])
                  for key in ("spin", "attitude") if key in entry]
    return found + ([Written(path="attitude", thing=own["attitude"], of=SPACECRAFT)] if "attitude" in own else [])


def refuse_impossible(written: Iterable[Written], bodies: Iterable[Body]) -> None:
    """Refuse a Sun within its own radius, and a spacecraft within the body that its trajectory is about.

    Raises
    ------
    ConfigError
        With the field as it is written, the rule, the value and the way out.
    """
    named = {body.name: body for body in bodies}
    for each in written:
        for field, value, size_m in _places(each):
            if SUN in (each.about, each.of):
                # An orbit is refused where it is made, with its own field.
                if each.of == SUN and not size_m > SUN_RADIUS_M:
                    raise ConfigError(f"{each.path}.{field}", f"must be more than the Sun's radius, {SUN_RADIUS_M:g} m",
                                      value, sun_way_out(value))
            elif each.of == SPACECRAFT and field not in _SIZES and (least_m := _least_m(each, named, size_m)):
                raise ConfigError(f"{each.path}.{field}", _rule(each, least_m), value,
                                  _meant(each, named, value, size_m))


def scenario_doubts(written: Iterable[Written], bodies: Iterable[Body]) -> list[Advice]:
    """Warnings of the fields of trajectories and attitudes whose values are improbable."""
    named, found = {body.name: body for body in bodies}, []
    for each in written:
        found += improbable(_kind(each, named), each.thing, each.path)
        if each.about is None:
            continue
        if each.about == SUN:
            found += _fall(each)
        found += _density(each, named)
        for field, value, size_m in _places(each):
            # A ring is about the middle of its planet.
            is_asked = (each.of in named and named[each.of].hull.solid_radius_m
                        or each.of == SPACECRAFT and field in _SIZES)
            if is_asked and (least_m := _least_m(each, named, size_m)):
                found.append(doubt(f"{each.path}.{field}", _rule(each, least_m, "is likely"), value,
                                   _meant(each, named, value, size_m), "overlap"))
    return found


@contextmanager
def doubted(doubts: Iterable[Advice]) -> Iterator[None]:
    """Add doubts about fields to the way out of an error that follows from them."""
    try:
        yield
    except ConfigError as error:
        error.hint = "; ".join([*([error.hint] if error.hint else []), *map(str, doubts)])
        raise


def overlap_doubts(states: Sequence[State], bodies: Sequence[Body], written: Iterable[Written],
                   told: Iterable[Advice]) -> list[Advice]:
    """Warnings of bodies that are within each other in some states, unless a field has been warned of."""
    hulls, nearest_m, count = {body.name: body.hull for body in bodies}, {}, Counter()
    for state in states if len(hulls) > 1 else ():
        for first, second, distance_m in overlaps(state, hulls):
            count[first, second] += 1
            nearest_m[first, second] = min(distance_m, nearest_m.get((first, second), np.inf))
    paths = {each.of: each.path for each in written if each.about is not None}
    known = {advice.path.rpartition(".")[0] for advice in told if advice.code == "overlap"}
    return [overlap_doubt(paths.get(second, f"bodies.{second}"), first, second, nearest_m[first, second],
                          f" in {number} of {len(states)} frames")
            for (first, second), number in count.items() if not {paths.get(first), paths.get(second)} & known]


def _kind(each: Written, named: Mapping[str, Body]) -> str:
    """The kind of rules that a trajectory or an attitude has."""
    if each.about is not None:
        return "orbit about the Sun" if SUN in (each.about, each.of) else "encounter"
    if each.of == SPACECRAFT:
        return SPACECRAFT
    return kind_of_body(named[each.of].hull.radius_m) if each.of in named else "body"


def _places(each: Written) -> Iterator[tuple[str, Any, float]]:
    """Fields, values and distances [m] of a trajectory from the centre of what it is about."""
    for field in _PLACES if each.about is not None else ():
        value = each.get(field)
        if value is not None:
            value = np.asarray(value, float).tolist()
            # A hyperbola's axis may be shorter than its periapsis.
            if field != "semi_major_axis_m" or value > 0.0:
                yield field, value, float(np.linalg.norm(value))


def _least_m(each: Written, named: Mapping[str, Body], size_m: float) -> float:
    """Radius [m] about its origin that a body is solid to, if a distance is below it; else 0."""
    if each.about not in named or size_m > (hull := named[each.about].hull).radius_m:
        return 0.0
    least_m = hull.solid_radius_m - float(np.linalg.norm(hull.centre_m))
    return least_m if size_m < least_m else 0.0


def _rule(each: Written, least_m: float, verb: str = "must be") -> str:
    return f"{verb} more than {least_m:.6g} m from the centre of {each.about!r}, which is solid to there"


def _meant(each: Written, named: Mapping[str, Body], value: Any, size_m: float) -> str:
    """The way out of a place within a body."""
    reach_m = named[each.about or ""].hull.radius_m
    if 1e3 * size_m > reach_m:
        return f"in km? then write {(1e3 * np.asarray(value)).tolist()}"
    return f"the body reaches {reach_m:.6g} m: is its length unit right?"


def _fall(each: Written) -> list[Advice]:
    """A warning of an orbit whose position and velocity lead into the Sun."""
    r_m, v_m_s = each.get("r_m"), each.get("v_m_s")
    if r_m is None or v_m_s is None:
        return []
    r, v = np.asarray(r_m, float), np.asarray(v_m_s, float)
    momentum = np.cross(r, v)
    eccentricity = float(np.linalg.norm(np.cross(v, momentum) / GM_SUN_M3_S2 - r / np.linalg.norm(r)))
    perihelion_m = float(momentum @ momentum) / GM_SUN_M3_S2 / (1.0 + eccentricity)
    if perihelion_m > SUN_RADIUS_M:
        return []
    return [doubt(f"{each.path}.v_m_s", f"likely keeps the perihelion beyond the Sun's radius, {SUN_RADIUS_M:g} m, and "
                  f"leads within {perihelion_m:.4g} m of its centre", v.tolist(),
                  f"in km/s? then write {(1e3 * v).tolist()}")]


def _density(each: Written, named: Mapping[str, Body]) -> list[Advice]:
    """A warning of a gravitational parameter that gives a body of the scene no likely density."""
    gm_m3_s2 = each.get("gravitational_parameter_m3_s2")
    if not gm_m3_s2 or each.about not in named or not (volume_m3 := named[each.about].shape.report.volume_m3) > 0.0:
        return []
    density, (low, high) = gm_m3_s2 / GRAVITATION_M3_KG_S2 / volume_m3, DENSITIES_KG_M3
    if low <= density <= high:
        return []
    meant = [f"in {unit}? then write {gm_m3_s2 * factor:.6g}" for unit, factor in (
        ("km3/s2", 1e9), ("kg", GRAVITATION_M3_KG_S2)) if low <= density * factor <= high]
    rule = f"likely gives {each.about!r}, of {volume_m3:.4g} m3, a density of {low:g} to {high:g} kg/m3, and gives " \
           f"it {density:.4g}"
    return [doubt(f"{each.path}.gravitational_parameter_m3_s2", rule, gm_m3_s2,
                  ", ".join(meant) or "check its unit, m3/s2, and the body's length unit")]
