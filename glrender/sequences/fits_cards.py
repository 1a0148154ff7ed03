"""Keywords of FITS files: those that an astronomer's programs look for, and the sky coordinates of a frame's pixels."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np

from ..base.rotations import dcm
from ..view.state import later

Cards = dict[str, tuple[Any, str]]
"""Values and comments by keyword."""
# Characters of a card: FITS Standard 4.0, section 4.1.
_CARD = 80
_MJD_0 = datetime(1858, 11, 17)
_DAY_S = 86400.0


def cards_of(header: Mapping[str, Any]) -> Cards:
    """The keywords of a frame's primary image; all of the header is in the extension GLRENDER besides.

    Parameters
    ----------
    header : mapping
        As of `frame_header`.

    Source: FITS Standard 4.0, sections 4.3 (units), 8 (coordinates) and 9 (times); BAYERPAT and ROWORDER as Siril and
    CCDCiel have them.
    """
    camera, state, plan = header["camera"], header["state"], header["plan"]
    cards: Cards = {
        "ORIGIN": (f"glrender {header['glrender']}", "program"),
        "INSTRUME": (_ascii(camera["name"]), "camera"),
        "T_S": (state["t_s"], "[s] time of mid-exposure"), **_dates(header),
        "FRAMENUM": (header["index"], "number in its sequence"),
        "FOCALPX": (camera["focal_length_px"], "[px] focal length"),
        "ROWORDER": ("BOTTOM-UP", "row 1 is the picture's lowest"),
        "ASKED": (",".join(f"{unit}={most:g}" for unit, most in plan["asked"].items()), "tolerances"),
        "MAXERR": (plan["max_error"], "RMS drawn for, of the mean lit pixel"),
        "PREDERR": (plan["predicted_error"], "predicted RMS, likewise")}
    for stem, numbers, axes, comment in (
            ("SUN_", state["r_sun_inertial_m"], "XYZ", "[m] Sun, inertial"),
            ("SC_", state["spacecraft"]["r_inertial_m"], "XYZ", "[m] spacecraft, inertial"),
            ("SC_Q", state["spacecraft"]["q_from_inertial"], "WXYZ", "spacecraft from inertial"),
            ("CAM_", camera["r_camera_spacecraft_m"], "XYZ", "[m] camera, spacecraft"),
            ("CAM_Q", camera["q_camera_from_spacecraft"], "WXYZ", "camera from spacecraft")):
        cards |= {f"{stem}{axis}": (value, comment) for axis, value in zip(axes, numbers, strict=True)}
    if header["exposure_s"] is not None:
        cards |= {"EXPTIME": (header["exposure_s"], "[s] exposure"), "SEED": (header["seed"], "of the noise")}
        cards |= _detector(camera)
    return {name: _fitting(*card) for name, card in cards.items()}


def sky_cards(header: Mapping[str, Any]) -> Cards:
    """The coordinates of an image's pixels: the gnomonic projection about the boresight.

    Right ascension and declination where the axes of `inertial` are ICRF's, else longitude and latitude in `inertial`.
    A distorted image has the focal length and the boresight alone: its projection is none of the standard's.

    Source: Calabretta and Greisen (2002), FITS paper II, sections 2.4 and 5.1.3.
    """
    camera = header["camera"]
    # FITS counts pixels from 1, and rows from below.
    scale_deg = float(np.degrees(1.0 / camera["focal_length_px"]))
    cards: Cards = {
        "CRPIX1": (camera["principal_point_px"][0] + 1.0, "[px] column of the boresight"),
        "CRPIX2": (camera["height_px"] - camera["principal_point_px"][1], "[px] row of the boresight"),
        "CDELT1": (scale_deg, "[deg] of a pixel at the boresight"),
        "CDELT2": (scale_deg, "[deg] of a pixel at the boresight")}
    if camera["distortion"] is not None:
        return cards
    right, down, ahead = dcm(np.array(camera["q_camera_from_spacecraft"])) @ dcm(
        np.array(header["state"]["spacecraft"]["q_from_inertial"]))
    # Towards the pole, where east has no direction, any is as good: that of longitude 0.
    longitude = np.arctan2(ahead[1], ahead[0])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    north = np.cross(ahead, east)
    latitude = np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))
    is_icrf = header["inertial_axes"] == "ICRF"
    cards |= {"CTYPE1": ("RA---TAN" if is_icrf else "INLN-TAN", "gnomonic"),
              "CTYPE2": ("DEC--TAN" if is_icrf else "INLT-TAN", "gnomonic"),
              "CUNIT1": ("deg", ""), "CUNIT2": ("deg", ""),
              "CRVAL1": (float(np.degrees(longitude) % 360.0), "[deg] boresight"),
              "CRVAL2": (float(np.degrees(latitude)), "[deg] boresight"),
              "PC1_1": (float(east @ right), ""), "PC1_2": (float(-east @ down), ""),
              "PC2_1": (float(north @ right), ""), "PC2_2": (float(-north @ down), ""),
              "LONPOLE": (180.0, "[deg] axis 2 is north at the boresight"),
              "LATPOLE": (float(np.degrees(latitude)), "[deg]")}
    return cards | ({"RADESYS": ("ICRS", "axes of ICRF")} if is_icrf else {})


def _dates(header: Mapping[str, Any]) -> Cards:
    """Begin, middle and end of the exposure in TDB."""
    middle, half_s = header["date_tdb"], 0.5 * (header["exposure_s"] or 0.0)
    if middle is None:
        return {}
    cards: Cards = {"TIMESYS": ("TDB", "scale of all dates")}
    for name, offset_s, text in (("OBS", -half_s, "begin"), ("BEG", -half_s, "begin"), ("AVG", 0.0, "middle"),
                                 ("END", half_s, "end")):
        date = later(middle, offset_s)
        days = (datetime.fromisoformat(date) - _MJD_0).total_seconds() / _DAY_S
        cards |= {f"DATE-{name}": (date, f"{text} of the exposure"), f"MJD-{name}": (days, f"[d] {text}")}
    return cards


def _detector(camera: Mapping[str, Any]) -> Cards:
    detector, mosaic = camera["detector"], camera["mosaic"]
    cards: Cards = {
        "GAIN": (1.0 / detector["gain_DN_per_electron"], "[electron/DN]"),
        "OFFSET": (detector["offset_DN"], "[DN] without light"), "BITDEPTH": (detector["bit_depth"], "[bit]"),
        "RDNOISE": (detector["read_noise_electrons"], "[electron] RMS"),
        "FULLWELL": (detector["full_well_electrons"], "[electron]"),
        "SATURATE": (2 ** detector["bit_depth"] - 1, "[DN] largest number")}
    if mosaic is not None:
        # From row 1 on, which is the picture's lowest.
        rows = [mosaic[(camera["height_px"] - 1 - k) % len(mosaic)] for k in range(len(mosaic))]
        cards |= {"BAYERPAT": ("".join(rows), "filters of rows from row 1 on"),
                  "BAYERROW": (len(rows), "rows of the pattern"), "XBAYROFF": (0, "[px]"), "YBAYROFF": (0, "[px]")}
    return cards


def _fitting(value: Any, comment: str) -> tuple[Any, str]:
    """A card's value and its comment, which is left out where a string leaves no room for it."""
    if not isinstance(value, str):
        return value, comment
    # Quotes stand about a string, and twice in it.
    room = _CARD - len("KEYWORD = '' / ") - len(value) - value.count("'")
    return value, comment if len(comment) <= room else ""


def _ascii(name: str) -> str:
    """A name in the characters that FITS has: others as Python escapes them; the header GLRENDER has it as it is."""
    return name.encode("ascii", "backslashreplace").decode()
