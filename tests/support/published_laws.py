"""Hapke's laws of bodies as published, for the tests of photometry."""

from __future__ import annotations

from glrender.brdf import Hapke

ISOTROPIC = {"b": 0.0, "c": 0.0}
EROS = Hapke.one_term(single_scattering_albedo=0.33, asymmetry=-0.25, shoe_amplitude=1.4, shoe_width=0.01,
                      roughness_deg=28.0)
MOON = Hapke(single_scattering_albedo=0.3955, b=0.2279, c=0.4242, shoe_amplitude=1.6595, shoe_width=0.0505,
             roughness_deg=23.6566)
COMET = Hapke.one_term(single_scattering_albedo=0.034, asymmetry=-0.42, shoe_amplitude=2.25, shoe_width=0.061,
                       roughness_deg=28.0)
BODIES = {"comet": COMET, "eros": EROS, "moon": MOON}


def hapke(**parameters):
    return Hapke(**{"single_scattering_albedo": 0.3, **ISOTROPIC, **parameters})
