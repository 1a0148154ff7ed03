"""Trajectories of a scenario file: [trajectory], [encounter], [bodies.orbit], [spice]."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.validate import known_keys, one_of, text

from ...base.errors import ConfigError, error_path
from ..encounter import Encounter
from ..epochs import needed
from ..instruments.images import PlacesAtImages, read_images
from ..kepler import Kepler
from ..paths import AtRest, Hovering, Trajectory, circular_orbit
from ..scenario import SPACECRAFT, SUN
from ..spice.kernels import Spice
from ..spice.sources import SpiceTrajectory
from .ccsds import trajectory_of_oem
from .fields import Known, a_table, made, taken_epoch
from .horizons import trajectory_of_horizons
from .state_files import trajectory_of_csv, trajectory_of_parquet


def read_trajectory(known: Known, value: object, target: str) -> Trajectory:
    """The trajectory of a table with its `kind`; of a target, "spacecraft" or a body."""
    table = a_table(value)
    kind = one_of("kind", table.pop("kind", None), _KINDS)
    return _KINDS[kind](known, table, target)


def read_motion_of_body(known: Known, name: str, entry: Mapping[str, Any]) -> None:
    """Add the trajectory of a body, of its `orbit` or `trajectory`, to the known trajectories."""
    if "orbit" in entry and "trajectory" in entry:
        raise ConfigError("orbit", "is given as well as trajectory", hint="give one")
    if "orbit" in entry:
        with error_path("orbit"):
            known.trajectories[name] = _kepler(known, a_table(entry["orbit"]), name)
    elif "trajectory" in entry:
        with error_path("trajectory"):
            known.trajectories[name] = read_trajectory(known, entry["trajectory"], name)


def read_images_of(known: Known, value: object) -> None:
    """Add the images of a trajectory of ISDs to the known images; the first one is the start."""
    table = a_table(value)
    if table.get("kind") != "isd":
        return
    known_keys("", table, ("kind", "about", "files"), required=("files",))
    if known.start is not None:
        raise ConfigError("files", "have the epochs, so [time] must not", known.start.tdb)
    if not isinstance(table["files"], list) or not table["files"]:
        raise ConfigError("files", "must be a list of ISD files that is not empty", table["files"])
    known.images = read_images([known.folder / text(f"files[{index}]", name)
                                for index, name in enumerate(table["files"])])
    known.start = known.images[0].epoch


def read_sun(known: Known, own: Mapping[str, Any]) -> None:
    """Add the Sun where [sun], ISDs or SPICE put it, unless orbits are about it."""
    if "sun" in own:
        with error_path("sun"):
            if any(path.about == SUN for path in known.trajectories.values()):
                raise ConfigError("", "is given as well as an orbit about the Sun", hint="give one")
            known.trajectories[SUN] = _at_rest(known, a_table(own["sun"]), SUN)
    elif not any(path.about == SUN for path in known.trajectories.values()):
        if known.images:
            known.trajectories[SUN] = PlacesAtImages(images=known.images, is_sun=True,
                                                     about=known.about(own["trajectory"]))
            return
        if known.spice is None:
            raise ConfigError("bodies[0].orbit", "missing: nothing gives the Sun's place",
                              hint="give an orbit about the Sun, [spice], or [sun] with r_m")
        known.trajectories[SUN] = SpiceTrajectory(spice=known.spice, target=SUN, about=known.names[0])


def read_encounter(known: Known, value: object) -> Encounter:
    """The trajectory of [encounter], without the fields of its sampler; it gives the scenario its start."""
    table, date = taken_epoch(value, "date")
    if date is None:
        raise ConfigError("date_tdb", "missing", hint="or date_utc, or date_et_s")
    if known.start is not None:
        raise ConfigError("date_tdb", "gives the start, so [time] must not", known.start.tdb)
    if len(known.names) == 1:
        table.setdefault("body", known.names[0])
    with error_path("body"):
        path = known.about_sun(one_of("", table.get("body"), known.names))
    encounter = made(Encounter, table, date=date, body_trajectory=path)
    known.start = encounter.start
    return encounter


def read_spice(value: object, folder: Path) -> Spice:
    """The kernels of [spice]."""
    table = a_table(value)
    kernels = table.get("kernels")
    if not isinstance(kernels, list) or not kernels:
        raise ConfigError("kernels", "must be a list of files that is not empty", kernels)
    table["kernels"] = [folder / text(f"kernels[{index}]", kernel) for index, kernel in enumerate(kernels)]
    return made(Spice, table)


def _kepler(known: Known, table: dict[str, Any], target: str) -> Kepler:
    if "periapsis_distance_m" in table:
        table, periapsis = taken_epoch(table, "periapsis")
        if periapsis is None:
            raise ConfigError("periapsis_tdb", "missing", hint="or periapsis_utc, or periapsis_et_s")
        table.setdefault("about", SUN)
        known.about(table)
        return made(Kepler.from_periapsis, table, periapsis=periapsis)
    table, epoch = taken_epoch(table, "epoch")
    if epoch is None:
        raise ConfigError("epoch_tdb", "missing", hint="or epoch_utc, or epoch_et_s")
    table.setdefault("about", SUN)
    known.about(table)
    return made(Kepler if "r_m" in table else Kepler.from_elements, table, epoch=epoch)


def _at_rest(known: Known, table: dict[str, Any], target: str) -> AtRest:
    table["about"] = known.about(table)
    return made(AtRest, table)


def _hovering(known: Known, table: dict[str, Any], target: str) -> Hovering:
    table["about"] = known.about(table)
    return made(Hovering, table, body_trajectory=known.about_sun(table["about"]))


def _circular(known: Known, table: dict[str, Any], target: str) -> Kepler:
    table, epoch = taken_epoch(table, "epoch")
    table["about"], epoch = known.about(table), epoch or needed(known.start)
    to_sun = None
    if table.get("plane") == "terminator":
        to_sun = -known.about_sun(table["about"]).at(epoch, np.zeros(1))[0][0]
    return made(circular_orbit, table, epoch=epoch, sun_direction=to_sun)


def _csv(known: Known, table: dict[str, Any], target: str) -> Trajectory:
    known_keys("", table, ("file", "about"), required=("file",))
    return trajectory_of_csv(known.file(table), known.about(table))


def _parquet(known: Known, table: dict[str, Any], target: str) -> Trajectory:
    known_keys("", table, ("file", "about"), required=("file",))
    return trajectory_of_parquet(known.file(table), known.about(table))


def _oem(known: Known, table: dict[str, Any], target: str) -> Trajectory:
    return _of_message(trajectory_of_oem, known, table, target)


def _horizons(known: Known, table: dict[str, Any], target: str) -> Trajectory:
    return _of_message(trajectory_of_horizons, known, table, target)


def _of_message(read: Callable[..., Trajectory], known: Known, table: dict[str, Any], target: str) -> Trajectory:
    """The trajectory of a file that says itself what moves about what."""
    known_keys("", table, ("file", "about", "object_name", "center_name"), required=("file",))
    about: str | list[str] = known.about(table)
    if "about" not in table and "center_name" not in table:
        about = [name for name in (*known.names, SUN) if name != target]
    # A body's file is about it; the spacecraft's is about no body.
    name = None if target == SPACECRAFT else target
    return read(known.file(table), about, table.get("object_name", name), center_name=table.get("center_name"),
                bodies=(*known.names, SUN))


def _spice(known: Known, table: dict[str, Any], target: str) -> Trajectory:
    # Other bodies than the first are where the spacecraft sees them, unless asked for about another.
    about = known.names[0] if target == SPACECRAFT else SPACECRAFT
    table["about"] = one_of("about", table.get("about", about), [SUN, SPACECRAFT, *known.names])
    return made(SpiceTrajectory, table, spice=known.kernels(), target=target)


def _isd(known: Known, table: dict[str, Any], target: str) -> PlacesAtImages:
    if target != SPACECRAFT:
        raise ConfigError("kind", "must be of the spacecraft", "isd")
    return PlacesAtImages(images=known.images, is_sun=False, about=known.about(table))


_KINDS: dict[str, Callable[[Known, dict[str, Any], str], Trajectory]] = {
    "kepler": _kepler, "at_rest": _at_rest, "hovering": _hovering, "circular": _circular, "csv": _csv,
    "parquet": _parquet, "oem": _oem, "horizons": _horizons, "spice": _spice, "isd": _isd}
