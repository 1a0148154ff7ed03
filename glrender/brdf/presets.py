"""Published parameter sets of real bodies, each with its source, and tables of Lunar-Lambert weights.

A set is here only if a sphere with it has the geometric albedo that was published with it, within
4 % (a test integrates each). Sets in the literature that do not close, or whose parameters nobody
on this project could read in the source, are not shipped: see docs/photometry.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from .curve import Table
from .hapke import Hapke


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A parameter set.

    Attributes
    ----------
    body : str
    law : Hapke
    wavelength_nm : float [nm]
    geometric_albedo : float [1]
        As published, not computed.
    source : str
    verification : str
        Which numbers were read in the source; the others are quoted from memory: read the paper
        before citing them.
    """

    body: str
    law: Hapke
    wavelength_nm: float
    geometric_albedo: float
    source: str
    verification: str


def _hapke_1986(w: float, asymmetry: float, shoe_amplitude: float, shoe_width: float,
                roughness_deg: float) -> Hapke:
    """The authors fitted the 1986 form, with H of 1981."""
    return Hapke.one_term(single_scattering_albedo=w, asymmetry=asymmetry, shoe_amplitude=shoe_amplitude,
                          shoe_width=shoe_width, roughness_deg=roughness_deg, h_function="1981")


PRESETS: dict[str, Preset] = {
    "eros_550nm": Preset(
        body="433 Eros", law=_hapke_1986(0.33, -0.25, 1.4, 0.01, 28.0), wavelength_nm=550.0,
        geometric_albedo=0.23,
        source="Li, A'Hearn and McFadden (2004), Icarus 172, 415; Li (2005), dissertation",
        verification="w, asymmetry, roughness and geometric albedo read in the dissertation's abstract; "
                     "opposition effect from memory"),
    "tempel1_550nm": Preset(
        body="9P/Tempel 1", law=_hapke_1986(0.039, -0.49, 1.0, 0.01, 16.0), wavelength_nm=550.0,
        geometric_albedo=0.056, source="Li et al. (2007), Icarus 187, 41",
        verification="w, asymmetry and roughness read; opposition effect (assumed by the authors, not "
                     "fitted) and geometric albedo from memory"),
    "hartley2_550nm": Preset(
        body="103P/Hartley 2", law=_hapke_1986(0.04, -0.47, 1.0, 0.01, 20.0), wavelength_nm=550.0,
        geometric_albedo=0.054, source="Li et al. (2011), EPSC-DPS 2011-634",
        verification="w, asymmetry, roughness and geometric albedo read; opposition effect from memory"),
    "ryugu_550nm": Preset(
        body="162173 Ryugu", law=_hapke_1986(0.044, -0.388, 0.98, 0.075, 28.0), wavelength_nm=550.0,
        geometric_albedo=0.040, source="Tatsumi et al. (2020), A&A 639, A83",
        verification="geometric albedo (0.040 +- 0.005) read; Hapke's parameters from memory"),
}
"""Name -> parameter set."""


def _every_10_deg(*weights: float) -> Table:
    return Table(phase_deg=tuple(10.0 * k for k in range(len(weights))), value=weights)


LUNAR_LAMBERT_WEIGHTS: dict[str, Table] = {
    "mars": _every_10_deg(0.946, 0.748, 0.616, 0.522, 0.435, 0.350, 0.266, 0.187, 0.118, 0.062, 0.018, -0.012,
                          -0.027, -0.035, -0.036, -0.037, -0.031, -0.012, 0.010),
    "io": _every_10_deg(0.830, 0.662, 0.544, 0.457, 0.373, 0.290, 0.206, 0.129, 0.062, 0.009, -0.029, -0.053,
                        -0.061, -0.061, -0.055, -0.049, -0.037, -0.013, 0.010),
    "europa": _every_10_deg(0.636, 0.616, 0.567, 0.505, 0.433, 0.361, 0.295, 0.237, 0.185, 0.140, 0.094,
                            0.049, 0.003, -0.038, -0.064, -0.070, -0.057, -0.023, 0.000),
    "ganymede": _every_10_deg(0.866, 0.697, 0.580, 0.493, 0.410, 0.326, 0.241, 0.161, 0.090, 0.032, -0.012,
                              -0.040, -0.052, -0.055, -0.052, -0.047, -0.037, -0.014, 0.000),
    "callisto": _every_10_deg(1.008, 0.687, 0.501, 0.384, 0.302, 0.245, 0.205, 0.180, 0.163, 0.147, 0.131,
                              0.117, 0.104, 0.088, 0.067, 0.047, 0.026, 0.007, -0.010),
}
"""Name -> `weight` of LunarLambert; read in ISIS's appdata photometry files (<body>.pvl)."""
