"""Camera models by name: plain tables as a scene file would hold them, with their sources."""

from __future__ import annotations

from types import MappingProxyType

PRESETS = MappingProxyType({
    # No instrument's data sheet: round numbers of the size that small-body navigation cameras
    # have, and the optics of photometry.md's worked example (15.1 mm, 80 %, 450-950 nm), so that
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
})
"""Name -> table of `CameraModel.from_dict`; a table's `preset` key starts from one of these."""
