"""Warnings of a detector's frame: saturation, an exposure at its limit, light that it does not show. Pure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from glrender_camera import CameraModel, Frame, MosaicModel, PinholeCamera
from glrender_camera.exposure import MAX_EXPOSURE_S, MIN_EXPOSURE_S

from ..base.plausible import Advice
from ..engines.advice import some_rows
from ..scene.scene import Scene, band_irradiances

SATURATED_SHARE, SATURATED_LIT_SHARE = 0.5, 0.05
"""Share of a frame's pixels, and of its lit ones, from which on a warning names saturation: an automatic exposure
leaves one in a hundred of the lit ones."""
MIN_LIT_PX = 100
"""Least number of lit pixels for a warning of their share: fewer are a point source, which saturates its few pixels."""
LIMIT_RATIO = 1.5
"""Least ratio of the exposure that is wanted to the limit that it stopped at, either way, for a warning."""
LEAST_DN = 0.5
"""Signal of the brightest pixel [DN] below which rounding leaves nothing."""


def frame_advice(scene: Scene, camera: PinholeCamera, asked: float | str, frame: Frame, light: np.ndarray,
                 roi: tuple[int, int, int, int], *, has_stars: bool = False,
                 has_sun: bool = False) -> tuple[Advice, ...]:
    """Warnings of a detector's frame: saturation, an exposure at its limit, light that it does not show.

    Parameters
    ----------
    scene : Scene
    camera : PinholeCamera
        With a model.
    asked : float [s] or "auto"
    frame : Frame
    light, roi
        As of `image_advice`: the image that was exposed, before the optics.
    has_stars, has_sun : bool
        Whether stars, or the Sun, are in the frame: bodies before stars are overexposed on purpose.
    """
    x0, y0, x1, y1 = roi
    part = light[y0:y1, x0:x1]
    found = _saturation(scene, camera, frame, part, roi, has_stars, has_sun)
    found += _exposure_limit(camera.model, asked, frame, has_sun)
    if part.size and not found and not has_stars and (
            _signal_DN(scene, camera, frame, some_rows(part).max()) < LEAST_DN):
        peak = float(part.max())
        signal = _signal_DN(scene, camera, frame, peak)
        if 0.0 < signal < LEAST_DN:
            found.append(Advice("underexposed", "exposure_s", (
                f"the brightest pixel has {signal:.2g} DN in {frame.exposure_s:.3g} s, so that the frame has nothing "
                f"of the bodies; {_fitting_exposure_s(scene, camera, peak, 0.7):.2g} s would put it at 70 % of the "
                'range, as "auto" does')))
    return tuple(found)


def frame_notes(asked: float | str, frame: Frame) -> tuple[Advice, ...]:
    """Notes of a detector's frame: the exposure that "auto" chose."""
    if asked != "auto":
        return ()
    return (Advice("exposure", "exposure_s", f"automatic exposure of {frame.exposure_s:.4g} s"),)


def bad_pixel_advice(camera: PinholeCamera) -> tuple[Advice, ...]:
    """A warning of single pixels of a camera of one band that no predicted frame has."""
    detector = camera.model.detector
    kinds = {"hot pixels": detector.hot_pixel_fraction * detector.hot_pixel_electrons_per_s,
             "dead pixels": detector.dead_pixel_fraction, "cosmic rays": detector.cosmic_ray_hits_per_px_s}
    if not (found := [name for name, amount in kinds.items() if amount > 0.0]):
        return ()
    return (Advice("bad_pixels", "is_robust", (
        f"the camera has {' and '.join(found)}, which the predicted frame has not: they pull the fit, and chi2 rises "
        "with the exposure; ask for a robust comparison, or mask them")),)


def lost_pixel_advice(is_lit: np.ndarray, counts: np.ndarray) -> tuple[Advice, ...]:
    """A warning of a comparison in which hardly any of the lit pixels (h, w) count."""
    n_lit, n_left = np.count_nonzero(is_lit), np.count_nonzero(is_lit & counts)
    if not n_lit or n_left > SATURATED_SHARE * n_lit:
        return ()
    known = "few pixels decide, and from some pixels off a wrong gain" if n_left else "so that nothing is known"
    return (Advice("lost_pixels", "compare", f"{n_lit - n_left} of {n_lit} lit pixels are full or masked and do not "
                                             f"count: {known}; compare a frame of a shorter exposure, or mask less"),)


def _saturation(scene: Scene, camera: PinholeCamera, frame: Frame, part: np.ndarray, roi: tuple[int, int, int, int],
                has_stars: bool, has_sun: bool) -> list[Advice]:
    x0, y0, x1, y1 = roi
    saturated, region, text = frame.saturated, frame.saturated[y0:y1, x0:x1], ""
    some, near = some_rows(saturated), some_rows(region)
    # The limits for some rows are half of those for all, so that the whole image decides.
    if np.count_nonzero(some) <= 0.5 * SATURATED_SHARE * some.size and (
            not np.count_nonzero(near) or np.count_nonzero(near & (lit := some_rows(part) > 0.0))
            <= 0.5 * SATURATED_LIT_SHARE * np.count_nonzero(lit)):
        return []
    count, n_pixels = np.count_nonzero(saturated), saturated.size
    if count > SATURATED_SHARE * n_pixels:
        text = f"all {n_pixels} pixels" if count == n_pixels else f"{count} of {n_pixels} pixels"
    elif count and not has_stars:
        lit = part > 0.0
        n_lit, count = np.count_nonzero(lit), np.count_nonzero(region & lit)
        if n_lit >= MIN_LIT_PX and count > SATURATED_LIT_SHARE * n_lit:
            text = f"{'all' if count == n_lit else f'{count / n_lit:.0%} of'} {n_lit} lit pixels"
    if not text:
        return []
    fitting_s = _fitting_exposure_s(scene, camera, float(part.max(initial=0.0)), 1.0)
    way_out = f"the brightest would fit below {fitting_s:.2g} s"
    if has_sun:
        way_out = "the Sun is in view"
    elif not fitting_s < frame.exposure_s:
        way_out = "by light from outside the image, dark current or cosmic rays, not by the bodies in view"
    return [Advice("saturated", "exposure_s", f"{text} are saturated at an exposure_s of {frame.exposure_s:.3g}; "
                                              f"{way_out}")]


def _exposure_limit(model: CameraModel | MosaicModel, asked: float | str, frame: Frame, has_sun: bool) -> list[Advice]:
    rules, exposure_s = model.auto_exposure, frame.exposure_s
    if "auto" not in (asked, model.exposure_s) or rules.min_s < exposure_s < rules.max_s or rules.min_s == rules.max_s:
        return []
    # A loop that sends the exposure back which the rules gave is at their limit too; one with its own is not.
    if asked != "auto" and exposure_s not in (rules.min_s, rules.max_s):
        return []
    detector, is_long = model.detector, exposure_s >= rules.max_s
    free = replace(rules, min_s=MIN_EXPOSURE_S, max_s=MAX_EXPOSURE_S, max_step=1e6)
    wanted_s = free.after(frame, detector)
    if (wanted_s / rules.max_s if is_long else rules.min_s / wanted_s) < LIMIT_RATIO:
        return []
    full_scale = min(detector.full_well_electrons * detector.gain_DN_per_electron,
                     detector.max_DN - detector.offset_DN)
    level = (float(frame.dn.max()) - detector.offset_DN) / full_scale
    return [Advice("exposure_limit", f"auto_exposure.{'max_s' if is_long else 'min_s'}", (
        f"automatic exposure stays at its limit of {exposure_s:.3g} s: the brightest pixel is at "
        f"{100.0 * min(max(level, 0.0), 1.0):.3g} % of the range; "
        f"{'the Sun is in view' if has_sun else 'check the light in view'}, or set "
        f"auto_exposure.{'max_s' if is_long else 'min_s'}"))]


def _bands(scene: Scene, camera: PinholeCamera) -> list[tuple[CameraModel, float]]:
    """Each band's model, and the irradiance in it [1] over that of the image."""
    model = camera.model
    if not isinstance(model, MosaicModel):
        return [(model, 1.0)]
    drawn = scene.solar_irradiance_of(camera)
    return [(model.bands[letter], own / drawn) for letter, own in band_irradiances(model).items()]


def _signal_DN(scene: Scene, camera: PinholeCamera, frame: Frame, light_W_m2: float) -> float:
    """Number of a pixel with so much light, in the band that has most light, were it unbounded."""
    electrons_s = max(share * band.optics.aperture_area_m2 * band.electrons_per_joule
                      for band, share in _bands(scene, camera))
    return electrons_s * float(light_W_m2) * frame.exposure_s * camera.model.detector.gain_DN_per_electron


def _fitting_exposure_s(scene: Scene, camera: PinholeCamera, light_W_m2: float, target: float) -> float:
    """Exposure [s] that puts a pixel with so much light at a share of the range; before the optics spread it."""
    pixel, detector = np.full((1, 1), light_W_m2, np.float32), camera.model.detector
    rules = replace(camera.model.auto_exposure, percentile=100.0, target=target, min_s=MIN_EXPOSURE_S,
                    max_s=MAX_EXPOSURE_S)
    return min(rules.of_irradiance(share * pixel, band.optics.aperture_area_m2 * band.electrons_per_joule, detector)
               for band, share in _bands(scene, camera))
