"""The exports by name: their files' contents, and files that are written once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from glrender_camera.validate import one_of

from ...base.errors import ConfigError
from .ccsds_messages import aem, oem
from .flight import Flight
from .isd_files import isds
from .kernels import ck, codes_of, spk
from .sum_files import sums
from .text_kernels import fk, ik, sclk

STEM = "frames"


def _of_isd(flight: Flight) -> dict[str, bytes]:
    return {f"frame_{index:05d}.isd.json": text.encode() for index, text in enumerate(isds(flight))}


def _of_sum(flight: Flight) -> dict[str, bytes]:
    return {f"frame_{index:05d}.SUM": text.encode() for index, text in enumerate(sums(flight))}


def _of_spk(flight: Flight) -> dict[str, bytes]:
    return {f"{STEM}.bsp": spk(flight), f"{STEM}.tf": fk(codes_of(flight)).encode()}


def _of_ck(flight: Flight) -> dict[str, bytes]:
    codes = codes_of(flight)
    return {f"{STEM}.bc": ck(flight), **{f"{STEM}.{ending}": write(codes).encode()
                                         for ending, write in (("tf", fk), ("ti", ik), ("tsc", sclk))}}


EXPORTS: Mapping[str, Callable[[Flight], dict[str, bytes]]] = {
    "oem": lambda flight: {f"{STEM}.oem": oem(flight).encode()},
    "aem": lambda flight: {f"{STEM}.aem": aem(flight).encode()},
    "spk": _of_spk, "ck": _of_ck, "isd": _of_isd, "sum": _of_sum}
"""Contents of files by their names, for each export."""


def exports_of(flight: Flight, names: Iterable[str]) -> dict[str, bytes]:
    """Contents of the files of some exports, by the files' names.

    Parameters
    ----------
    flight : Flight
    names : iterable of str
        Out of `EXPORTS`.

    Raises
    ------
    ConfigError
        An unknown name, with all that there are; a flight that an export cannot hold; spiceypy missing.
    """
    found: dict[str, bytes] = {}
    for name in names:
        found |= EXPORTS[one_of("--with", name, tuple(EXPORTS))](flight)
    return found


def refuse_others(folder: Path, files: Mapping[str, bytes]) -> None:
    """Refuse to write over a file with other contents.

    Raises
    ------
    ConfigError
        With the file's path.
    """
    for name, content in files.items():
        path = folder / name
        if path.exists() and (not path.is_file() or path.read_bytes() != content):
            raise ConfigError("--with", "must not write over a file with other contents", str(path),
                              "remove it, or choose another folder")
