"""From the Sun's spectrum to watts and photons: bands, distance, radiance, an unresolved body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources

import numpy as np
from glrender_camera.validate import finite, positive

from ..base.constants import AU_M, PLANCK_J_S, SPEED_OF_LIGHT_M_S, TOTAL_SOLAR_IRRADIANCE_W_M2
from ..base.errors import ConfigError
from ..brdf import Law
from ..brdf.integrals import disc_albedo

__all__ = ["Band", "radiance", "solar_irradiance", "solar_spectrum", "sphere_irradiance"]


@cache
def solar_spectrum() -> tuple[np.ndarray, np.ndarray]:
    """Spectral irradiance of the Sun at 1 au.

    Returns
    -------
    wavelength_nm : (1697,) float64 [nm], 119.5 .. 1e6
    irradiance_W_m2_nm : (1697,) float64 [W m-2 nm-1]
        Its integral is 1366.1 W/m2, 0.39 % more than the total of today's radiometers
        (`constants.TOTAL_SOLAR_IRRADIANCE_W_M2`): bands are not rescaled.

    Source: ASTM E490-00a, Table 3; see the file's head.
    """
    file = resources.files("glrender").joinpath("data", "solar_spectrum_e490.csv")
    table = np.loadtxt(file.read_text(encoding="utf-8").splitlines(), delimiter=",")
    wavelength_nm, irradiance = table[:, 0] * 1e3, table[:, 1] * 1e-3
    for array in (wavelength_nm, irradiance):
        array.setflags(write=False)
    return wavelength_nm, irradiance


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """A filter curve: which part of sunlight counts.

    Parameters
    ----------
    wavelength_nm : (N >= 2,) float [nm], increasing, within the solar spectrum
    transmission : (N,) float [1], 0..1
        Straight lines between; 0 outside.

    Raises
    ------
    ConfigError
    """

    wavelength_nm: np.ndarray
    transmission: np.ndarray

    def __post_init__(self):
        for name in ("wavelength_nm", "transmission"):
            try:
                array = np.array(getattr(self, name), dtype=np.float64)
            except (TypeError, ValueError, OverflowError):
                raise ConfigError(name, "must be a list of numbers", getattr(self, name)) from None
            if array.ndim != 1 or len(array) < 2 or not np.isfinite(array).all():
                raise ConfigError(name, "must be 2 finite numbers or more", getattr(self, name))
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        low, high = solar_spectrum()[0][[0, -1]]
        if not ((np.diff(self.wavelength_nm) > 0).all() and low <= self.wavelength_nm[0]
                and self.wavelength_nm[-1] <= high):
            raise ConfigError("wavelength_nm", f"must increase within {low:g}..{high:g}",
                              self.wavelength_nm.tolist())
        if self.transmission.shape != self.wavelength_nm.shape:
            raise ConfigError("transmission", f"must be as many as wavelength_nm, {len(self.wavelength_nm)}",
                              self.transmission.tolist())
        if not ((self.transmission >= 0.0) & (self.transmission <= 1.0)).all():
            raise ConfigError("transmission", "must be within 0..1", self.transmission.tolist(),
                              "per cent? divide by 100")

    @classmethod
    def box(cls, low_nm: float, high_nm: float) -> Band:
        """A band that passes all light between two wavelengths [nm]."""
        return cls(wavelength_nm=np.array([low_nm, high_nm]), transmission=np.ones(2))

    def _integral(self, power: int) -> float:
        """Integral of irradiance x transmission x wavelength_nm^power over wavelength [nm]."""
        wavelength, irradiance = solar_spectrum()
        low, high = self.wavelength_nm[[0, -1]]
        inside = wavelength[(wavelength > low) & (wavelength < high)]
        x = np.union1d(inside, self.wavelength_nm)
        middle = 0.5 * (x[1:] + x[:-1])

        def integrand(at):
            transmission = np.interp(at, self.wavelength_nm, self.transmission)
            return np.interp(at, wavelength, irradiance) * transmission * at**power

        # Simpson: exact for products of three straight lines.
        ends = integrand(x)
        return float(np.sum(np.diff(x) / 6.0 * (ends[1:] + 4.0 * integrand(middle) + ends[:-1])))

    @cached_property
    def irradiance_1au_W_m2(self) -> float:
        """Irradiance of the Sun through the filter at 1 au [W/m2]: a scene's `solar_irradiance_1au_W_m2`."""
        return self._integral(0)

    @cached_property
    def photon_irradiance_1au_m2_s(self) -> float:
        """Photons through the filter at 1 au [1/(m2 s)], by the integral, not a mean wavelength."""
        return self._integral(1) * 1e-9 / (PLANCK_J_S * SPEED_OF_LIGHT_M_S)

    @property
    def photons_per_joule(self) -> float:
        """Photons [1/J] of sunlight reflected by a grey body: what turns an irradiance image into photons."""
        return self.photon_irradiance_1au_m2_s / self.irradiance_1au_W_m2


@cache
def box_irradiance_1au_W_m2(band_nm: tuple[float, float]) -> float:
    """Solar irradiance at 1 au [W/m2] between two wavelengths [nm]."""
    return Band.box(*band_nm).irradiance_1au_W_m2


def solar_irradiance(distance_m: float, irradiance_1au_W_m2: float = TOTAL_SOLAR_IRRADIANCE_W_M2) -> float:
    """Solar irradiance [W/m2] at a distance from the Sun.

    Parameters
    ----------
    distance_m : float [m], > 0
    irradiance_1au_W_m2 : float [W/m2]
        The band's; all wavelengths by default.
    """
    irradiance = finite("irradiance_1au_W_m2", irradiance_1au_W_m2)
    return irradiance * (AU_M / positive("distance_m", distance_m)) ** 2


def radiance(radf: np.ndarray, irradiance_W_m2: float) -> np.ndarray:
    """Radiance [W m-2 sr-1] of I/F [1] under a solar irradiance [W/m2]: I/F is 1 for a white Lambert disc."""
    return np.asarray(radf) * (irradiance_W_m2 / np.pi)


def sphere_irradiance(law: Law, phase: float, radius_m: float, range_m: float,
                      irradiance_W_m2: float) -> float:
    """Irradiance [W/m2] at the camera of a sphere, resolved or not: F (R / range)^2 p Phi(g).

    Parameters
    ----------
    law : Law
    phase : float [rad], 0..pi
    radius_m, range_m : float [m], > 0
    irradiance_W_m2 : float [W/m2]
        Of the Sun at the body.
    """
    solid_angle = (positive("radius_m", radius_m) / positive("range_m", range_m)) ** 2
    return irradiance_W_m2 * solid_angle * disc_albedo(law, phase)
