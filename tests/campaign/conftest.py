"""A small approach of five frames, and campaigns of it."""

from __future__ import annotations

import pytest
from missing import needed_module

APPROACH = """
[[bodies]]
name = "rock"
generated = { kind = "contact_binary", radius_m = 100.0, seed = 3, subdivisions = 4 }
brdf = { law = "lambert", normal_albedo = 0.2 }
[[cameras]]
name = "navcam"
width_px = 96
height_px = 96
focal_length_px = 300.0
[cameras.model]
exposure_s = "auto"
optics = { aperture_diameter_m = 0.0006, psf_sigma_px = 0.6 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.008, bit_depth = 8, \
read_noise_electrons = 20.0, offset_DN = 5.0 }
[trajectory]
kind = "at_rest"
r_m = [900.0, 300.0, 100.0]
[time]
times_s = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0]
[sun]
r_m = [1.5e11, -0.3e11, 0.1e11]
"""
CAMPAIGN = """
scenario = "approach.toml"
handover = 0.03
[axes]
seed = [1, 2]
estimator = ["model"]
max_error = [0.3]
belief.cameras.navcam.focal_length_factor = [1.0, 1.05]
"""


@pytest.fixture
def campaign_file(tmp_path):
    """Writes a campaign beside its scenario: texts for the campaign, and for the scenario's end."""
    needed_module("fast_simplification", "pip install -e '.[test]'")

    def write(campaign=CAMPAIGN, more=""):
        (tmp_path / "approach.toml").write_text(APPROACH + more)
        (tmp_path / "campaign.toml").write_text(campaign)
        return tmp_path / "campaign.toml"

    return write
