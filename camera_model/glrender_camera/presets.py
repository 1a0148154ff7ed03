"""Camera models by name: plain tables as a scene file would hold them, with their sources.

A field that no source at hand gives is left out, and asked for by name where it has no default.
"""

from __future__ import annotations

from types import MappingProxyType

PRESETS = MappingProxyType({
    # No instrument's data sheet: round numbers of the size that small-body navigation cameras
    # have, and optics (15.1 mm, 80 %, 450-950 nm) with which
    # I/F = 0.02 at 1.2 au on pixels of 1e-4 rad fills 7.5e5 e- in 0.1 s. Meant for 1024 x 1024.
    "generic_navigation_camera": {
        "optics": {"aperture_diameter_m": 0.0151, "transmission": 0.8, "band_nm": (450.0, 950.0),
                   "psf_sigma_px": 0.7},
        "detector": {"quantum_efficiency": 0.5, "full_well_electrons": 1e5, "gain_DN_per_electron": 0.04,
                     "bit_depth": 12, "offset_DN": 50.0, "read_noise_electrons": 10.0,
                     "dark_current_electrons_per_s": 5.0, "photo_response_nonuniformity": 0.01,
                     "dark_signal_nonuniformity_electrons": 3.0},
        "exposure_s": "auto",
    },
    # PDS4 context product urn:nasa:pds:context:instrument:fc2.dawn, "Detectors" and "Optics", after
    # Sierks et al. (2011), doi 10.1007/s11214-011-9745-4. Clear filter F1: 400-1100 nm. 150.0 mm over
    # 14 um: focal_length_px 10714, 1024 x 1024, 93.3 urad/px. The efficiency is the detector's peak,
    # fill factor included; the transfer takes 1.32 ms for 1024 rows; "about 18 electrons/DN".
    "dawn_framing_camera": {
        "optics": {"aperture_diameter_m": 0.0199, "band_nm": (400.0, 1100.0)},
        "detector": {"quantum_efficiency": 0.20, "gain_DN_per_electron": 1.0 / 18.0, "bit_depth": 14,
                     "frame_transfer_row_s": 1.32e-3 / 1024.0},
        "exposure_s": "auto",
    },
    # Ishiguro et al. (2010), doi 10.1016/j.icarus.2009.12.035, arXiv 0912.4797: focal length 120.80 mm
    # (abstract); effective aperture 15 mm, pixels 12 um, 12 bit, full well 70,000 e-, 17 e-/DN, readout
    # noise 60 e- as quoted from it by the visnav-py project. focal_length_px 10067, 1024 x 1000. No source at
    # hand gives the bias: 20 DN are ours, 5.7 sigma of the read noise of 3.5 DN, which 0 would cut in half.
    "hayabusa_amica": {
        "optics": {"aperture_diameter_m": 0.015},
        "detector": {"full_well_electrons": 7e4, "gain_DN_per_electron": 1.0 / 17.0, "bit_depth": 12,
                     "offset_DN": 20.0, "read_noise_electrons": 60.0},
        "exposure_s": "auto",
    },
    # NSSDC 2004-006A-17: 152.5 mm, 13 um, aperture 70 mm, 12 bit: focal_length_px 11731, 1024 x 1024. The
    # two PSFs are Gaussians that put into a star's central pixel what ESA's NAVCAM description gives:
    # 50-55 % defocused (no attenuation), 65-70 % focused. The attenuated mode passes 1/580 of the light
    # through 30 mm, so the coating 1/580 x (70/30)^2. CCD47-20: 100,000 e- and 80 % from e2v's data sheet,
    # as quoted by the visnav-py project.
    "rosetta_navcam": {
        "optics": {"aperture_diameter_m": 0.070, "psf_sigma_px": 0.458},
        "detector": {"quantum_efficiency": 0.80, "full_well_electrons": 1e5, "bit_depth": 12},
        "exposure_s": "auto",
    },
    "rosetta_navcam_attenuated": {
        "optics": {"aperture_diameter_m": 0.030, "psf_sigma_px": 0.371, "transmission": (70.0 / 30.0) ** 2 / 580.0},
        "detector": {"quantum_efficiency": 0.80, "full_well_electrons": 1e5, "bit_depth": 12},
        "exposure_s": "auto",
    },
})
"""Name -> table of `CameraModel.from_dict`; a table's `preset` key starts from one of these."""
