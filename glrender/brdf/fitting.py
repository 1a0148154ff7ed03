"""A cheaper law in the place of a dearer one, and the error that it makes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from ..base.errors import ConfigError
from .akimov import Akimov
from .curve import Table
from .integrals import Disc
from .lambert import Lambert
from .law import Law
from .lommel_seeliger import LommelSeeliger
from .lunar_lambert import LunarLambert

_N_NODES = 48


@dataclass(frozen=True, kw_only=True, eq=False)
class Replacement:
    """A law that stands for another over some phase angles.

    Attributes
    ----------
    law : Law
        The cheaper one.
    phase_deg : (N,) float64 [deg]
    rms : (N,) float64 [1]
        RMS error of the radiance over the lit disc of a sphere, over its mean.
    flux : (N,) float64 [1]
        Relative error of the sphere's flux.
    centre_of_brightness : (N,) float64 [radii]
        Its shift towards the Sun.
    """

    law: Law
    phase_deg: np.ndarray
    rms: np.ndarray
    flux: np.ndarray
    centre_of_brightness: np.ndarray


def compare(law: Law, truth: Law, phase_deg: object, *, is_scaled: bool = False) -> Replacement:
    """The error that `law` makes in the place of `truth`, on a sphere.

    Parameters
    ----------
    law, truth : Law
    phase_deg : (N,) float [deg], 0 <= phase < 180
    is_scaled : bool
        Whether the law is first scaled to the truth's flux at each phase, as a camera's exposure does.

    Raises
    ------
    ConfigError
        A phase outside 0..180 deg, or at which the truth is dark.
    """
    phase_deg = _checked(phase_deg)
    rows = []
    with warnings.catch_warnings():
        # Evaluated beyond a law's range on purpose: its error there is the result.
        warnings.filterwarnings("ignore", message=".*beyond the phase")
        for phase in np.radians(phase_deg):
            disc = Disc.at(phase, _N_NODES)
            wanted, got = disc.radf(truth), disc.radf(law)
            flux, got_flux = disc.weight @ wanted, disc.weight @ got
            if not flux > 0.0:
                raise ConfigError("truth", f"must return light at a phase of {np.degrees(phase):g} deg", truth)
            if is_scaled and got_flux > 0.0:
                got, got_flux = got * flux / got_flux, flux
            mean = flux / disc.weight.sum()
            rms = np.sqrt(disc.weight @ (got - wanted) ** 2 / disc.weight.sum()) / mean
            centre = (disc.weight * got) @ disc.x / got_flux if got_flux > 0.0 else np.nan
            rows.append((rms, got_flux / flux - 1.0, centre - (disc.weight * wanted) @ disc.x / flux))
    rms, flux, centre = np.array(rows).T
    return Replacement(law=law, phase_deg=phase_deg, rms=rms, flux=flux, centre_of_brightness=centre)


def fit(truth: Law, kind: type[Law], phase_deg: object) -> Replacement:
    """Fit a cheaper kind of law to a dearer law over phase angles.

    The flux of a sphere is met at every phase given by a law with a phase function, on average by Lambert;
    Lunar-Lambert meets the centre of brightness too, above 1 degree.

    Parameters
    ----------
    truth : Law
    kind : Lambert, LommelSeeliger, Akimov or LunarLambert
    phase_deg : (2..128,) float [deg], 0 <= phase < 180, increasing
        Straight lines in L and in the logarithm of the flux between them: every 5 to 10 degrees will do.
        Put more where an opposition surge is narrow.

    Returns
    -------
    Replacement
        Its errors are those at `phase_deg`; `compare` gives them elsewhere.

    Raises
    ------
    ConfigError
        Another kind, too few phases, or a truth that is dark at a phase.

    Warns
    -----
    UserWarning
        A Lambert albedo above 1 is held at 1: its flux falls short.
    """
    phase_deg = _checked(phase_deg)
    wanted = _flux(truth, phase_deg)
    if not (wanted > 0.0).all():
        raise ConfigError("truth", f"must return light at a phase of {phase_deg[np.argmin(wanted)]:g} deg", truth)
    if kind is Lambert:
        law = _fit_lambert(wanted, phase_deg)
    elif kind is LunarLambert:
        law = _fit_lunar_lambert(truth, phase_deg)
    elif kind in (LommelSeeliger, Akimov):
        unit = kind(**{_ALBEDO[kind]: 1.0})
        law = _with_curve(kind, phase_deg, wanted / _flux(unit, phase_deg))
    else:
        raise ConfigError("kind", "must be Lambert, LommelSeeliger, Akimov or LunarLambert", kind)
    return compare(law, truth, phase_deg)


_ALBEDO = {LommelSeeliger: "single_scattering_albedo", Akimov: "normal_albedo", LunarLambert: "normal_albedo"}


def _checked(phase_deg: object) -> np.ndarray:
    array = np.atleast_1d(np.asarray(phase_deg, dtype=np.float64))
    if array.ndim != 1 or not ((array >= 0.0) & (array < 180.0)).all():
        raise ConfigError("phase_deg", "must be >= 0 and < 180", phase_deg)
    return array


def _flux(law: Law, phase_deg: np.ndarray) -> np.ndarray:
    discs = (Disc.at(phase, _N_NODES) for phase in np.radians(phase_deg))
    return np.array([disc.weight @ disc.radf(law) for disc in discs])


def _fit_lambert(wanted: np.ndarray, phase_deg: np.ndarray) -> Lambert:
    albedo = float(np.mean(wanted / _flux(Lambert(normal_albedo=1.0), phase_deg)))
    if albedo > 1.0:
        warnings.warn(f"the fitted normal_albedo of {albedo:.4g} is held at 1", stacklevel=3)
    return Lambert(normal_albedo=min(albedo, 1.0))


def _with_curve(kind: type[Law], phase_deg: np.ndarray, albedo: np.ndarray, **parameters) -> Law:
    # The table carries what exceeds an albedo of 1.
    normal = min(float(albedo[0]), 1.0)
    curve = Table(phase_deg=tuple(phase_deg), value=tuple(albedo / normal))
    return kind(**{_ALBEDO[kind]: normal}, phase_function=curve, **parameters)


def _fit_lunar_lambert(truth: Law, phase_deg: np.ndarray) -> LunarLambert:
    albedo, weight = [], []
    for phase in np.radians(phase_deg):
        disc = Disc.at(phase, _N_NODES)
        wanted = disc.radf(truth)
        cos_emission = disc.normal[:, 2]
        terms = np.stack([2.0 * disc.cos_incidence / (disc.cos_incidence + cos_emission), disc.cos_incidence])
        # Two unknowns: flux, and the centre of brightness or, where that is 0 by symmetry, the disc.
        first = disc.weight
        second = disc.weight * (disc.x if phase > np.radians(1.0) else terms[1] - terms[0])
        a, b = np.linalg.solve([[first @ terms[0], first @ terms[1]], [second @ terms[0], second @ terms[1]]],
                               [first @ wanted, second @ wanted])
        albedo.append(a + b)
        weight.append(a / (a + b))
    table = Table(phase_deg=tuple(phase_deg), value=tuple(weight))
    return _with_curve(LunarLambert, phase_deg, np.array(albedo), weight=table)
