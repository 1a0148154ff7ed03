"""Finds improbable or impossible values in the fields of cameras and laws, most often for their unit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from glrender_camera import CameraModel, Detector, PinholeCamera

from ..base.errors import ConfigError
from ..base.plausible import Advice, doubt, improbable, way_out
from .body import Body
from .solar_irradiance import box_irradiance_1au_W_m2, solar_spectrum

GAIN_RATIO = 5.0
"""Ratio, either way, of a full well to what the bits hold [DN] from which on the gain is doubted: of the detectors of
Cassini, LORRI, AMICA, ONC and OSIRIS in their usual states it is below 3."""
WIDEST_CORNER_DEG = 75.0
"""Likely angle [deg] of an undistorted image's farthest corner off the boresight, at most: the widest rectilinear
lenses for 43 mm of detector, of 9 mm, reach 67.5; a hazard camera's 136 x 102 deg, taken as a pinhole's, 70.1."""
IRRADIANCE_OFF = 0.2
"""Share by which a solar irradiance may differ from E490's in the band: other spectra differ by some per cent, the
edges of a filter move it by ten."""


def camera_doubts(index: int, camera: PinholeCamera, solar_irradiance_1au_W_m2: float | None) -> tuple[Advice, ...]:
    """Warnings of a scene's camera, and of the irradiance that is given for it.

    Parameters
    ----------
    index : int
        Of the camera in the scene.
    camera : PinholeCamera
    solar_irradiance_1au_W_m2 : float [W/m2], optional
        The scene's own.
    """
    path, given_W_m2 = f"cameras[{index}]", solar_irradiance_1au_W_m2
    found = improbable("camera", camera, path)
    corner_deg = math.degrees(math.acos(camera.least_cosine))
    if camera.distortion is None and corner_deg > WIDEST_CORNER_DEG:
        found.append(doubt(
            f"{path}.focal_length_px", f"puts the farthest corner {corner_deg:.3g} deg off the boresight, where it is "
            f"likely at most {WIDEST_CORNER_DEG:g} deg", camera.focal_length_px, "it is the focal length over the "
            "pixel pitch: 100 mm and 10 um make 10000; principal_point_px is from the first pixel's centre"))
    for band_path, band in _bands(path, camera):
        found += improbable("optics", band.optics, f"{band_path}")
        if given_W_m2 is not None:
            found += _irradiance(camera.name, band.optics.band_nm, given_W_m2)
    if camera.model is not None:
        found += _gain(f"{path}.model.detector", camera.model.detector)
    elif given_W_m2 is not None and given_W_m2 > (1.0 + IRRADIANCE_OFF) * box_irradiance_1au_W_m2(_spectrum_nm()):
        found += _irradiance(camera.name, _spectrum_nm(), given_W_m2)
    return tuple(found)


def law_doubts(index: int, body: Body) -> tuple[Advice, ...]:
    """Warnings of the laws of a scene's body, which has an index there."""
    path = f"bodies[{index}]"
    laws = {f"{path}.materials.{name}": law for name, law in (body.materials or {}).items()}
    if body.brdf is not None:
        laws = {f"{path}.brdf": body.brdf}
    return tuple(advice for at, law in laws.items() for advice in improbable("law", law, at))


def refuse_bands_without_sun(index: int, camera: PinholeCamera) -> None:
    """Refuse a camera whose band reaches beyond the solar spectrum, where the scene gives no irradiance.

    Raises
    ------
    ConfigError
    """
    low, high = _spectrum_nm()
    for path, band in _bands(f"cameras[{index}]", camera):
        if not low <= band.optics.band_nm[0] < band.optics.band_nm[1] <= high:
            raise ConfigError(f"{path}.band_nm", f"must be within {low:g}..{high:g} nm, where the Sun's spectrum is "
                              "known (ASTM E490)", list(band.optics.band_nm), way_out(
                                  "optics", "band_nm", band.optics.band_nm)
                              + "; beyond it give the scene's solar_irradiance_1au_W_m2")


def _bands(path: str, camera: PinholeCamera) -> Iterator[tuple[str, CameraModel]]:
    """Each band's model, and the path of its optics."""
    for letter, band in ({} if camera.model is None else camera.model.bands).items():
        yield f"{path}.model.optics{'.' * bool(letter)}{letter}", band


def _gain(path: str, detector: Detector) -> list[Advice]:
    """A warning where a full well is far from what the bits hold, under the field that would mend it."""
    gain, full_well, bits = detector.gain_DN_per_electron, detector.full_well_electrons, detector.bit_depth

    def fits(gain: float, full_well: float) -> bool:
        return 1.0 / GAIN_RATIO <= gain * full_well / 2.0**bits <= GAIN_RATIO

    if fits(gain, full_well):
        return []
    rule = f"times {{}} is likely within a factor of {GAIN_RATIO:g} of 2^bit_depth, {2**bits} DN, and is " \
           f"{gain * full_well:.4g} DN"
    if fits(gain, 1e3 * full_well) and not fits(1.0 / gain, full_well):
        return [doubt(f"{path}.full_well_electrons", rule.format(f"gain_DN_per_electron, {gain:.6g},"), full_well,
                      f"in ke-? then write {1e3 * full_well:.6g}")]
    meant = [f"in e-/DN? then write its inverse, {1.0 / gain:.6g}"] if fits(1.0 / gain, full_well) else []
    if 1 <= (other := round(math.log2(gain * full_well))) <= 16:
        meant.append(f"or of a bit_depth of {other}?" if meant else f"of a bit_depth of {other}?")
    return [doubt(f"{path}.gain_DN_per_electron", rule.format(f"full_well_electrons, {full_well:.6g},"), gain,
                  ", ".join(meant) or "check full_well_electrons (e-), bit_depth, and whether the gain is in e-/DN")]


def _irradiance(name: str, band_nm: Sequence[float], given_W_m2: float) -> list[Advice]:
    """A warning where an irradiance is not that of the Sun in a band; a band outside the spectrum has none."""
    low, high = _spectrum_nm()
    if not (low <= band_nm[0] and band_nm[1] <= high):
        return []
    sun_W_m2 = box_irradiance_1au_W_m2((band_nm[0], band_nm[1]))
    if abs(given_W_m2 / sun_W_m2 - 1.0) <= IRRADIANCE_OFF:
        return []
    rule = f"is likely within {100.0 * IRRADIANCE_OFF:g} % of the Sun's {sun_W_m2:.4g} W/m2 from {band_nm[0]:g} to " \
           f"{band_nm[1]:g} nm (ASTM E490), the band of camera {name!r}"
    return [doubt("solar_irradiance_1au_W_m2", rule, given_W_m2,
                  "of all wavelengths it is 1361; leave it out, and each camera has that of its band")]


def _spectrum_nm() -> tuple[float, float]:
    low, high = solar_spectrum()[0][[0, -1]].tolist()
    return low, high
