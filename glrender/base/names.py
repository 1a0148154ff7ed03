"""What a frame may have, by name, for who draws none too: nothing is imported."""

from __future__ import annotations

OUTPUTS = {"irradiance": "W/m2", "dn": "DN", "compressed": "byte"}
"""Outputs and their units: irradiance per pixel, digital numbers, and the stream that the camera sends, from which
they are decoded."""
PRODUCTS = {"irradiance": "W/m2", "range": "m", "body_id": "1", "facet_id": "1", "incidence": "rad", "emission": "rad",
            "phase": "rad", "r_body": "m", "sunlit": "1"}
"""Images that are drawn together, and their units."""
MAX_DIRECTIONS = 10_000
"""Most laser ranges that are asked for at once."""
NOTES = ("exposure",)
"""Codes of notes, which are no warnings."""
