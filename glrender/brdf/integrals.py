"""Integrals of a law over a whole sphere, by quadrature in float64: albedos, phase curve, centre of light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import within

from ..base.errors import ConfigError
from .law import Law

N_NODES = 96
"""Gauss-Legendre nodes along the photometric longitude; half as many in latitude. 1e-8 for smooth laws,
1e-5 with a mean slope of some degrees."""
# Ends of the pieces of a phase integral [rad]: an opposition surge is narrow.
_PHASE_PIECES = (0.0, 1e-4, 1e-3, 1e-2, 0.05, 0.2, 0.8, 2.0, np.pi)
# Incidences [rad] and nodes by which a law's greatest albedo is found: a bound that is read, to a percent.
_INCIDENCES, _FEW_NODES = (0.0, 0.5, 1.0, 1.3, 1.5), 32


@dataclass(frozen=True, kw_only=True)
class Disc:
    """Points of a unit sphere that are lit and seen from afar at one phase angle.

    The camera is along +z and the Sun in the x-z plane, towards +x.

    Attributes
    ----------
    to_sun, to_camera : (3,) float64 [1]
    normal : (N, 3) float64 [1]
    cos_incidence : (N,) float64 [1]
    weight : (N,) float64
        Projected area over that of the disc; sums to the lit fraction (1 + cos g) / 2.
    x : (N,) float64 [1]
        Place on the disc towards the Sun, in radii.
    """

    to_sun: np.ndarray
    to_camera: np.ndarray
    normal: np.ndarray
    cos_incidence: np.ndarray
    weight: np.ndarray
    x: np.ndarray

    @classmethod
    def at(cls, phase: float, n_nodes: int = N_NODES) -> Disc:
        """The disc at a phase angle [rad], 0..pi; at pi it is dark and every weight is 0.

        Raises
        ------
        ConfigError
            Another phase, such as one in degrees.
        """
        phase = within("phase", phase, 0.0, np.pi)
        u, du = np.polynomial.legendre.leggauss(n_nodes)
        v, dv = np.polynomial.legendre.leggauss(n_nodes // 2)
        half_width = 0.5 * (np.pi - phase)
        longitude = (0.5 * phase + half_width * u)[:, None]
        latitude = 0.25 * np.pi * (v + 1.0)[None, :]
        cos_latitude = np.cos(latitude)
        # Both hemispheres are alike.
        area = 2.0 * half_width * 0.25 * np.pi * du[:, None] * dv[None, :] * cos_latitude
        cos_emission = cos_latitude * np.cos(longitude)
        cos_incidence = cos_latitude * np.cos(longitude - phase)
        x = cos_latitude * np.sin(longitude)
        normal = np.stack(np.broadcast_arrays(x, np.sin(latitude), cos_emission), axis=-1)
        return cls(to_sun=np.array([np.sin(phase), 0.0, np.cos(phase)]), to_camera=np.array([0.0, 0.0, 1.0]),
                   normal=normal.reshape(-1, 3), cos_incidence=cos_incidence.ravel(),
                   weight=(area * cos_emission / np.pi).ravel(), x=x.ravel())

    def radf(self, law: Law) -> np.ndarray:
        """I/F (N,) [1] of a law at the points."""
        return np.pi * law.brdf(self.to_sun, self.to_camera, self.normal) * self.cos_incidence


def disc_albedo(law: Law, phase: float, n_nodes: int = N_NODES) -> float:
    """Disc-averaged I/F of a sphere: p Phi(g), geometric albedo times phase function.

    Parameters
    ----------
    law : Law
    phase : float [rad], 0..pi
    n_nodes : int

    Returns
    -------
    float [1]
        The irradiance of an unresolved sphere is this times F(d) (R / range)^2.

    Source: Hapke (2012), integrated reflectances of a sphere.
    """
    disc = Disc.at(phase, n_nodes)
    return float(disc.weight @ disc.radf(law))


def centre_of_brightness(law: Law, phase: float, n_nodes: int = N_NODES) -> float:
    """Offset of a sphere's centre of brightness from its centre towards the Sun, in radii.

    Parameters
    ----------
    law : Law
    phase : float [rad], 0 <= phase < pi
    n_nodes : int

    Raises
    ------
    ConfigError
        Another phase, or a law without light there.
    """
    disc = Disc.at(phase, n_nodes)
    light = disc.weight * disc.radf(law)
    if not light.sum() > 0.0:
        raise ConfigError("phase", "must be one at which the law returns light", phase)
    return float(light @ disc.x / light.sum())


def geometric_albedo(law: Law) -> float:
    """p [1]: brightness of a sphere at zero phase over that of a white Lambert disc facing the Sun."""
    return disc_albedo(law, 0.0)


def phase_function(law: Law, phase: float) -> float:
    """Phi(g) [1] of a sphere; 1 at zero phase."""
    return disc_albedo(law, phase) / geometric_albedo(law)


def phase_integral(law: Law) -> float:
    """q [1] = 2 int Phi(g) sin(g) dg."""
    return bond_albedo(law) / geometric_albedo(law)


def bond_albedo(law: Law) -> float:
    """A_B = p q [1]: share of the sunlight on a sphere that leaves it."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    total = 0.0
    for low, high in zip(_PHASE_PIECES, _PHASE_PIECES[1:], strict=False):
        for node, weight in zip(nodes, weights, strict=True):
            phase = low + 0.5 * (high - low) * (node + 1.0)
            total += (high - low) * weight * np.sin(phase) * disc_albedo(law, phase, 64)
    return float(total)


def hemispherical_albedo(law: Law, incidence: float, n_nodes: int = N_NODES) -> float:
    """Share of the light falling on a plane at an incidence [rad] that leaves it; 1 at most in nature."""
    u, du = np.polynomial.legendre.leggauss(n_nodes)
    emission = 0.25 * np.pi * (u + 1.0)[:, None]
    azimuth = 0.5 * np.pi * (u + 1.0)[None, :]
    to_camera = np.stack(np.broadcast_arrays(
        np.sin(emission) * np.cos(azimuth), np.sin(emission) * np.sin(azimuth), np.cos(emission)), axis=-1)
    to_sun = np.array([np.sin(incidence), 0.0, np.cos(incidence)])
    solid_angle = (0.25 * np.pi * du * np.sin(emission.ravel()) * np.cos(emission.ravel()))[:, None]
    value = law.brdf(to_sun, to_camera, np.array([0.0, 0.0, 1.0]))
    # Both sides of the principal plane are alike.
    return float(2.0 * np.sum(value * solid_angle * (0.5 * np.pi * du)[None, :]))


def greatest_albedo(law: Law) -> float:
    """Largest share of the light falling on a plane that leaves it, at any incidence."""
    return max(hemispherical_albedo(law, incidence, _FEW_NODES) for incidence in _INCIDENCES)
